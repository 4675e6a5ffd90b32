# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera: which ray belongs to which point of which pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .validation import fail, set_array, set_integer, set_number

MAX_PIXELS = 1 << 20
"""The longest edge of a frame."""

PROJECTIONS = ("perspective", "orthographic")


@dataclass(frozen=True, eq=False)
class Camera:
    """A perspective or orthographic camera that looks along its own -Z, with +Y up.

    The frame has ``width`` x ``height`` pixels of which ``region`` is rendered; a pixel is known
    by its place in the whole frame, so that regions rendered apart join without a seam.

    camera_to_world : (4, 4), rigid; columns are the camera's axes and position (scene units).
    viewplane : (left, right, bottom, top) of the *whole* frame: at distance 1 for a perspective
        camera, in scene units for an orthographic one. Sensor, lens shift and pixel aspect are
        all in here.
    width, height : pixels of the whole frame.
    region : (x0, y0, x1, y1), the pixels rendered, row 0 at the bottom; None is the whole frame.
    projection : "perspective" or "orthographic".
    clip_start, clip_end : distances along the view axis between which anything is seen, but for the world's
        volume, which has no end.
    aperture : radius of the lens in scene units; 0 has all in focus.
    focus_distance : along the view axis, of the plane that is in focus.
    blades : of a polygonal aperture, from 3; less is round. blade_rotation : in radians.
    aperture_ratio : height of the aperture over its width; an anamorphic lens has one above 1.
    """

    camera_to_world: Any
    viewplane: Any
    width: int
    height: int
    region: Any = None
    projection: str = "perspective"
    clip_start: float = 0.0
    clip_end: float = np.inf
    aperture: float = 0.0
    focus_distance: float = 10.0
    blades: int = 0
    blade_rotation: float = 0.0
    aperture_ratio: float = 1.0
    name: str = "Camera"

    def __post_init__(self) -> None:
        matrix = set_array(self, "camera_to_world", (4, 4))
        axes = matrix[:3, :3]
        if not np.allclose(axes.T @ axes, np.eye(3), atol=1e-4):
            raise fail(self, "camera_to_world", f"must be rigid (no scale, no shear), is {matrix.tolist()}")
        left, right, bottom, top = set_array(self, "viewplane", (4,))
        if not (left != right and bottom != top):
            raise fail(self, "viewplane", f"is empty: {(left, right, bottom, top)}")
        for field in ("width", "height"):
            set_integer(self, field, 1, MAX_PIXELS)
        if self.region is None:
            object.__setattr__(self, "region", (0, 0, self.width, self.height))
        x0, y0, x1, y1 = (int(v) for v in set_array(self, "region", (4,), int))
        if not (0 <= x0 < x1 <= self.width and 0 <= y0 < y1 <= self.height):
            raise fail(
                self, "region", f"is {(x0, y0, x1, y1)}: empty, or outside {self.width} x {self.height}"
            )
        object.__setattr__(self, "region", (x0, y0, x1, y1))
        if self.projection not in PROJECTIONS:
            raise fail(self, "projection", f"is {self.projection!r}, wanted one of {PROJECTIONS}")
        # An orthographic camera may see what lies behind its own plane.
        set_number(self, "clip_start", low=0.0 if self.projection == "perspective" else -np.inf)
        set_number(self, "clip_end", low=self.clip_start, infinite=True)
        set_number(self, "aperture", low=0.0)
        if not set_number(self, "focus_distance") > 0 and self.aperture:
            raise fail(self, "focus_distance", f"is {self.focus_distance}, wanted more than 0")
        set_integer(self, "blades", 0, 1000)
        set_number(self, "blade_rotation")
        if not set_number(self, "aperture_ratio", low=0.0) > 0:
            raise fail(self, "aperture_ratio", "is 0, wanted more")

    @classmethod
    def look_at(
        cls,
        position: Any,
        target: Any,
        width: int,
        height: int,
        field_of_view: float = 0.7,
        up: Any = (0.0, 0.0, 1.0),
        **fields: Any,
    ) -> Camera:
        """A perspective camera at ``position`` that looks at ``target``.

        field_of_view : in radians, across the wider side.
        """
        position = np.asarray(position, float)
        back = position - np.asarray(target, float)
        back /= np.linalg.norm(back)
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, np.cross(back, right), back, position], axis=1)
        half = np.tan(field_of_view / 2) / max(width, height)
        viewplane = (-half * width, half * width, -half * height, half * height)
        return cls(matrix, viewplane, width, height, **fields)

    @property
    def region_size(self) -> tuple[int, int]:
        """(width, height) of the rendered region in pixels."""
        x0, y0, x1, y1 = self.region
        return x1 - x0, y1 - y0
