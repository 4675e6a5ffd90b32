# SPDX-License-Identifier: GPL-3.0-or-later
"""What an expression may ask of the surface points that it is evaluated at."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(eq=False)
class ShadingPoints:
    """N points of one material; component first.

    position : (3, N) float32, world position less `Scene.origin`, in scene units.
    normal : (3, N) float32, unit shading normal, towards the viewer.
    geometric : (3, N) float32, unit normal of the triangle, towards the viewer.
    towards_viewer : (3, N) float32, unit.
    back : (N,) bool, seen from the back of the triangle.
    attributes : name, width -> (width, N) float32, interpolated over the triangle; zeros where a mesh has no
        attribute of this name.
    ray : what asks: a "camera" ray, a "shadow" ray, or one to a "light".
    """

    position: np.ndarray
    normal: np.ndarray
    geometric: np.ndarray
    towards_viewer: np.ndarray
    back: np.ndarray
    attributes: Callable[[str, int], np.ndarray]
    ray: str = "camera"
    _values: dict[Any, np.ndarray] = field(default_factory=dict)

    def __len__(self) -> int:
        return self.position.shape[1]

    def remembered(self, key: Any, compute: Callable[[], Any]) -> Any:
        """``compute()``, but only once for each ``key`` and batch of points."""
        if key not in self._values:
            self._values[key] = compute()
        return self._values[key]
