# SPDX-License-Identifier: GPL-3.0-or-later
"""Where along rays, and in which part of lights, fog is lit: learned by pilots, all over the picture.

Of a ray through a nave the sun's shafts light but a few pieces, and of the sky few directions come in by its
windows. So dimensions of primary space are stretched: each has a grid of cells that points take equally
often, and what pilots found of f^2 says how wide they are,

    density ~ sqrt(mean of f^2 over all other dimensions),   f becomes f / density

as in G. P. Lepage, "A new algorithm for adaptive multidimensional integration", 1978, but of one step, and by
light. Grids of tiles are interpolated over the picture, so that what a point of a net finds still changes
smoothly from pixel to pixel. Where little would be gained, dimensions stay as they are.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..integration.integrand import StagedIntegrand, values_at
from ..integration.mapping import Map, in_order
from ..integration.point_sets import SobolPoints
from .camera_hits import Pixels

DIMENSIONS = 3
"""The first so many of the rest: distance, and place on a light."""

CELLS = 8
"""Of a grid."""

TILES, EDGE = 12, 16
"""Along the picture's shorter edge, about; and pixels along that of a tile, at least."""

PILOTS, POINTS = 2, 64
"""Along a tile's edge, and points of each."""

TOGETHER = 256
"""Pilots that a worker takes at once."""

EVERYWHERE = 0.2
"""Part of the density that is the same everywhere."""

WORTH = 1.25, 2.0
"""By how much less f^2 is in the mean, from where on grids do what they learned, and at which all of it."""


class Guide:
    """Grids of tiles (rows, columns), for L lights.

    knots : (rows + 2, columns + 2, L, DIMENSIONS, CELLS + 1) float32, with tiles beyond the edges.
    """

    def __init__(self, knots: np.ndarray, edge: int, corner: tuple[int, int]) -> None:
        """edge : of a tile, in pixels. corner : of the first."""
        self._knots, self._edge, self._corner = knots, edge, corner

    @staticmethod
    def of(
        lights: Sequence[StagedIntegrand],
        pixels: Callable[[np.ndarray, np.ndarray], Pixels],
        region: tuple[int, int, int, int],
        seed: int,
        map_: Map = in_order,
    ) -> Guide:
        """lights : what each of L brings. pixels : in columns and rows (B,) of the whole frame.
        region : x0, y0, x1, y1. map_ : runs a function over items on workers.
        """
        size = np.array([region[2] - region[0], region[3] - region[1]])
        edge = max(EDGE, -(-int(size.min()) // TILES))
        columns, rows = -(-size // edge)
        x, y = (
            np.minimum(((np.arange(n * PILOTS) + 0.5) * (edge / PILOTS)).astype(np.int32), end - 1)
            for n, end in zip((columns, rows), size, strict=True)
        )
        x, y = (a.ravel() for a in np.meshgrid(x, y))
        tile = y // edge * columns + x // edge
        some = pixels(x + region[0], y + region[1])
        points = SobolPoints(range(max(light.rest_dimensions for light in lights)), seed, 107)
        points.prepare(POINTS)
        net = points.points(some.key(), 0, POINTS)
        cell = (net[:DIMENSIONS] * CELLS).astype(np.intp) + tile[:, None] * CELLS
        found = np.zeros((len(lights), DIMENSIONS, columns * rows * CELLS))

        def look(work: tuple[int, slice]) -> np.ndarray:
            number, part = work
            light, few = lights[number], some[part]
            u = net[: light.rest_dimensions, part].reshape(light.rest_dimensions, -1)
            middle = np.full((2, len(few), 1), 0.5, np.float32)
            f = values_at(light, light.first(few, middle), len(few), None, u)[:3]
            return np.square(f.sum(axis=0, dtype=np.float64))

        parts = [slice(low, low + TOGETHER) for low in range(0, len(some), TOGETHER)]
        work = [(number, part) for number in range(len(lights)) for part in parts]
        squares = np.concatenate(map_(look, work)).reshape(len(lights), -1)
        for of_light, square in zip(found, squares, strict=True):
            for row, at in zip(of_light, cell, strict=True):
                row += np.bincount(at.ravel(), square, len(row))
        found = found.reshape(len(lights), DIMENSIONS, rows, columns, CELLS).transpose(2, 3, 0, 1, 4)
        for axis in range(2):
            found = _with_neighbours(found, axis)
        return Guide(np.pad(_grids(found), [(1, 1)] * 2 + [(0, 0)] * 3, mode="edge"), edge, region[:2])

    def knots(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(N, L, DIMENSIONS, CELLS + 1) of places (N,) in the whole frame, in pixels."""
        rows, columns = self._knots.shape[:2]
        at = [
            np.clip((place - start) / self._edge + 0.5, 0, n - 1.001)
            for place, start, n in zip((x, y), self._corner, (columns, rows), strict=True)
        ]
        first = [a.astype(np.intp) for a in at]
        right, up = ((a - i).astype(np.float32)[:, None] for a, i in zip(at, first, strict=True))
        flat = self._knots.reshape(rows * columns, -1)
        row = first[1] * columns + first[0]
        out = flat.take(row, axis=0) * ((1 - right) * (1 - up))
        for step, weight in ((1, right * (1 - up)), (columns, (1 - right) * up), (columns + 1, right * up)):
            out += flat.take(row + step, axis=0) * weight
        return out.reshape(len(x), *self._knots.shape[2:])


def stretched(knots: np.ndarray, ray: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places (DIMENSIONS, L, N) at u (DIMENSIONS, N), and 1 / density (L, N), for rays (N,) of ``knots``."""
    lights, of_ray = knots.shape[1], knots[0].size
    knots = knots.reshape(-1)
    place = np.empty((len(u), lights, u.shape[1]), np.float32)
    weight = np.ones(place.shape[1:], np.float32)
    first = ray * of_ray
    for d, at in enumerate(u):
        inside = at * np.float32(CELLS)
        cell = np.minimum(inside.astype(np.intp), CELLS - 1)
        inside -= cell
        cell += first
        for light in range(lights):
            grid = cell + (light * DIMENSIONS + d) * (CELLS + 1)
            low = knots.take(grid)
            grid += 1
            wide = knots.take(grid)
            wide -= low
            np.multiply(wide, inside, out=place[d, light])
            place[d, light] += low
            wide *= np.float32(CELLS)
            weight[light] *= wide
    return place, weight


def _with_neighbours(a: np.ndarray, axis: int) -> np.ndarray:
    """Sums over 1, 2, 1 of neighbours along an axis."""
    before, after = (np.roll(a, shift, axis) for shift in (1, -1))
    np.moveaxis(before, axis, 0)[0] = np.moveaxis(after, axis, 0)[-1] = 0
    return before + 2 * a + after


def _grids(square: np.ndarray) -> np.ndarray:
    """(..., CELLS + 1) float32 knots of grids, for sums (..., CELLS) of f^2 in equal intervals."""
    density = np.sqrt(square)
    total = density.sum(axis=-1, keepdims=True)
    density = np.where(total > 0, density / np.where(total > 0, total, 1), 1 / CELLS)
    # The mean of f^2 over what it is by the best density.
    gain = CELLS * np.square(density).sum(axis=-1, keepdims=True)
    part = (1 - EVERYWHERE) * np.clip((gain - WORTH[0]) / (WORTH[1] - WORTH[0]), 0, 1)
    density = part * density + (1 - part) / CELLS
    below = np.concatenate([np.zeros_like(total), np.cumsum(density, axis=-1)], axis=-1)
    below[..., -1] = 1
    # Where the distribution reaches each eighth.
    wanted = np.arange(1, CELLS) / CELLS
    cell = (below[..., 1:, None] < wanted).sum(axis=-2).clip(0, CELLS - 1)
    low, own = (np.take_along_axis(a, cell, axis=-1) for a in (below, density))
    knots = np.empty((*square.shape[:-1], CELLS + 1), np.float32)
    knots[..., 0], knots[..., -1] = 0, 1
    knots[..., 1:-1] = (cell + np.clip((wanted - low) / own, 0, 1)) / CELLS
    return knots
