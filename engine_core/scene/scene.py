# SPDX-License-Identifier: GPL-3.0-or-later
"""All that is rendered, in one frozen object."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .camera import Camera
from .lights import Light, World
from .material import Material
from .mesh import Mesh
from .validation import fail, set_array, set_integer
from .volume import Volume


@dataclass(frozen=True, eq=False)
class Scene:
    """A camera and what it looks at; checked when made.

    origin : (3,) float64, added to every position of the scene it gives world positions. An
        exporter puts it near the camera, so that float32 is fine wherever the scene lies.
    """

    camera: Camera
    meshes: tuple[Mesh, ...] = ()
    materials: tuple[Material, ...] = (Material(),)
    lights: tuple[Light, ...] = ()
    world: World = World()
    origin: Any = (0.0, 0.0, 0.0)
    volumes: tuple[Volume, ...] = ()

    def __post_init__(self) -> None:
        for field, kind in (("camera", Camera), ("world", World)):
            if not isinstance(getattr(self, field), kind):
                raise fail(self, field, f"is {getattr(self, field)!r}, wanted a {kind.__name__}")
        kinds = (("meshes", Mesh), ("materials", Material), ("lights", Light), ("volumes", Volume))
        for field, kind in kinds:
            items = tuple(getattr(self, field))
            for i, item in enumerate(items):
                if not isinstance(item, kind):
                    raise fail(self, f"{field}[{i}]", f"is {item!r}, wanted a {kind.__name__}")
            object.__setattr__(self, field, items)
        for mesh in self.meshes:
            used = np.asarray(mesh.materials)
            if used.size and not (used.min() >= 0 and used.max() < len(self.materials)):
                asked = f"has indices {used.min()} to {used.max()}"
                raise fail(mesh, "materials", f"{asked}, the scene has {len(self.materials)} materials")
        for owner in (self.world, *self.meshes):
            set_integer(owner, "volume", -1, len(self.volumes) - 1)
        set_array(self, "origin", (3,))
