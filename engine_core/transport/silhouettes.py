# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels in which one thing ends before another, found without a look at any light.

Over a plane 1 / depth is an affine function of the picture, so its second differences are 0; across an
outline they are not. What a camera ray brings through fog jumps there, and no polynomial follows.
"""

from __future__ import annotations

import numpy as np

from ..geometry.surfaces import Surfaces
from ..integration.mapping import Map
from .camera_rays import CameraRays

BEND = 0.03
"""Second difference of 1 / depth, relative to it, that is an outline."""

ROWS = 32
"""Of the picture, traced at once."""


def silhouettes(
    rays: CameraRays,
    surfaces: Surfaces,
    region: tuple[int, int, int, int],
    map_: Map,
) -> np.ndarray:
    """(W, H) bool, pixels of ``region`` (x0, y0, x1, y1) that an outline crosses.

    map_ : runs a function over items on the workers, and returns the results in order.
    """
    x0, y0, x1, y1 = region
    # Corners, and one more beyond each side for the differences.
    x = np.arange(x0 - 1, x1 + 2)

    def trace(low: int) -> np.ndarray:
        y = np.arange(low, min(low + ROWS, y1 + 2))
        column, row = (a.ravel() for a in np.meshgrid(x, y))
        corner = np.zeros((rays.dimensions, len(column), 1), np.float32)
        corner[2:] = 0.5  # the lens' middle
        origins, directions = rays.rays(column, row, corner)
        distance = surfaces.distance(origins, directions, rays.reach)
        with np.errstate(divide="ignore"):
            return (1 / (distance + np.float32(rays.clip_start))).reshape(len(y), len(x)).T

    inverse = np.concatenate(map_(trace, range(y0 - 1, y1 + 2, ROWS)), axis=1)
    found = np.zeros((x1 - x0, y1 - y0), bool)
    for axis in range(2):
        q = np.moveaxis(inverse, axis, 0)
        bend = np.abs(q[:-2] - 2 * q[1:-1] + q[2:])
        sharp = bend > BEND * np.maximum(np.maximum(q[:-2], q[2:]), q[1:-1])
        # An edge between two corners bends the line at both.
        crossed = np.moveaxis(sharp[:-1] & sharp[1:], 0, axis)
        other = [slice(None)] * 2
        other[1 - axis] = slice(1, -1)
        crossed = crossed[tuple(other)]
        first, last = [slice(None)] * 2, [slice(None)] * 2
        first[1 - axis], last[1 - axis] = slice(None, -1), slice(1, None)
        found |= crossed[tuple(first)] | crossed[tuple(last)]
    return found


class Silhouettes:
    """The same of one picture, traced once for whoever asks."""

    def __init__(self, rays: CameraRays, surfaces: Surfaces) -> None:
        self._rays, self._surfaces = rays, surfaces
        self._found: dict[tuple[int, int, int, int], np.ndarray] = {}

    def __call__(self, region: tuple[int, int, int, int], map_: Map) -> np.ndarray:
        """As `silhouettes`; the caller's own copy."""
        if region not in self._found:
            self._found[region] = silhouettes(self._rays, self._surfaces, region, map_)
        return self._found[region].copy()
