# SPDX-License-Identifier: GPL-3.0-or-later
"""Triangles in world space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .linking import Linking
from .validation import fail, set_array, set_integer, set_number

MOST_SETS = 1 << 15
"""Sets that meshes may be of."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles that share everything but their material; one object, or all instances of one.

    vertices : (V, 3) float32, world positions less `Scene.origin`. Vertices may be non-finite:
        the triangles that use them are left out and reported.
    triangles : (T, 3) int32, indices into ``vertices``.
    normals : None for flat shading, else (T, 3, 3) float32: a unit world-space normal for each corner.
    materials : one index into `Scene.materials`, or (T,) of them.
    visible_to_camera, casts_shadow : ray visibility.
    holdout : cuts a hole of alpha 0 into the picture, and still casts shadows.
    terminator_offset : Cycles' "shadow terminator geometry offset" for smooth triangles, in [0, 1].
    volume : index into `Scene.volumes` of the medium that the mesh, which should be closed, encloses; -1 for
        none. Media that overlap add up.
    surface : False has the mesh bound its volume only: its triangles are not drawn and cast no shadow.
    light_set, shadow_set : which set it is of that `Linking` names, as a receiver and as a blocker; of meshes
        that no light is linked to, 0.
    linking : what its emission lights, and what casts shadows in it.
    attributes : for each name (T, 3, C) float32 of each triangle's corners, or (T, 1, C) of triangles.
    """

    vertices: Any
    triangles: Any
    normals: Any = None
    materials: Any = 0
    visible_to_camera: bool = True
    casts_shadow: bool = True
    holdout: bool = False
    terminator_offset: float = 0.1
    name: str = "Mesh"
    attributes: Mapping[str, Any] = field(default_factory=dict)
    volume: int = -1
    surface: bool = True
    light_set: int = 0
    shadow_set: int = 0
    linking: Linking = Linking()

    def __post_init__(self) -> None:
        vertices = set_array(self, "vertices", (None, 3), np.float32, finite=False)
        triangles = set_array(self, "triangles", (None, 3), np.int32)
        if triangles.size and not (triangles.min() >= 0 and triangles.max() < len(vertices)):
            raise fail(
                self,
                "triangles",
                f"has indices {triangles.min()} to {triangles.max()}, there are {len(vertices)} vertices",
            )
        if self.normals is not None:
            set_array(self, "normals", (len(triangles), 3, 3), np.float32, finite=False)
        if np.ndim(self.materials) == 0:
            object.__setattr__(self, "materials", int(self.materials))
        else:
            set_array(self, "materials", (len(triangles),), np.int32)
        set_number(self, "terminator_offset", 0.0, 1.0)
        set_integer(self, "light_set", 0, MOST_SETS - 1)
        set_integer(self, "shadow_set", 0, MOST_SETS - 1)
        object.__setattr__(self, "attributes", {k: self._attribute(k, v) for k, v in self.attributes.items()})

    def _attribute(self, name: str, values: Any) -> np.ndarray:
        array = np.asarray(values, np.float32)
        if array.ndim != 3 or len(array) != len(self.triangles) or array.shape[1] not in (1, 3):
            wanted = f"({len(self.triangles)}, 3 or 1, width)"
            raise fail(self, "attributes", f'has "{name}" of shape {array.shape}, wanted {wanted}')
        return array
