# SPDX-License-Identifier: GPL-3.0-or-later
"""Where along rays fog is lit, and by which part of lights fog and surfaces are: learned by pilots, all over
the picture.

Of a ray through a nave the sun's shafts light but a few pieces, and of the sky few directions come in by its
windows, which are others at each distance, and at each place of a wall. So dimensions of primary space are
stretched: each has a grid of cells that points take equally often, for each cell of the dimensions before,
and what pilots found of f^2 says how wide they are,

    density ~ sqrt(mean of f^2 in a cell of all),   f becomes f / density

as in G. P. Lepage, "A new algorithm for adaptive multidimensional integration", 1978, but of one step, of
dimensions that depend on each other, and by light. Cells that few points tell of are taken for the product of
what their dimensions are, each by itself. Grids of tiles are interpolated over the picture, so that what a
point of a net finds still changes smoothly from pixel to pixel. Where little would be gained, dimensions stay
as they are; and lights, with a few pilots spent on them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..integration.integrand import StagedIntegrand, values_at
from ..integration.mapping import Map, even_parts, in_order
from ..integration.point_sets import SobolPoints
from .camera_hits import Pixels

DIMENSIONS = 3
"""The first so many of the rest, in fog: distance, and place on a light. On surfaces, the place alone."""

CELLS = 12
"""Of a grid."""

GRIDS = 1 + CELLS + CELLS**2
"""Of a light, in each tile, in fog; on surfaces those of two dimensions."""

TILES, EDGE = 12, 16
"""Along the picture's shorter edge, about; and pixels along that of a tile, at least."""

PILOTS = 2
"""Along a tile's edge."""

POINTS = 64, 1024
"""Of a pilot at least and at most, powers of two."""

BATCH = 1 << 15
"""Points that a worker takes at once."""

INSIDE = np.float32(2.0**-24)
"""Of the open unit interval, how far from its ends places are."""

EVERYWHERE = 0.2
"""Part of the density that is the same everywhere."""

SURE = 0.5
"""Points in a cell that tell as much of it as its dimensions do, each by itself; of so many points in all as
there were if all that f^2 comes from were equally bright (square of the sum over the sum of squares)."""

WORTH = 1.5, 2.0
"""By how much less f^2 is in the mean, from where on grids do what they learned, and at which all of it."""


class Guide:
    """Grids of tiles, of those lights that gain by it.

    gaining : their numbers, K of them. dimensions : D, the first so many, that are stretched.

    knots : (rows + 2, columns + 2, K, G, CELLS + 1) float32, with tiles beyond the edges. Of a light's G
        grids one is of the first dimension, the next are of the second where the first is in each of its
        cells, and so on.
    """

    def __init__(self, knots: np.ndarray, gaining: Sequence[int], edge: int, corner: tuple[int, int]) -> None:
        """gaining : numbers of K lights. edge : of a tile. corner : of the first, in pixels."""
        self._knots, self.gaining = knots, gaining
        self.dimensions = 1 + int(np.log(knots.shape[3]) / np.log(CELLS))
        self._edge, self._corner = edge, corner

    @staticmethod
    def of(
        lights: Sequence[StagedIntegrand],
        pixels: Callable[[np.ndarray, np.ndarray], Pixels],
        region: tuple[int, int, int, int],
        seed: int,
        evaluations: int,
        map_: Map = in_order,
        dimensions: int = DIMENSIONS,
        tiles: tuple[int, int] = (TILES, EDGE),
    ) -> Guide | None:
        """None where no light would gain much.

        lights : what each of L brings. pixels : in columns and rows (B,) of the whole frame.
        region : x0, y0, x1, y1. evaluations : of each light that gains, that may be spent, about.
        map_ : runs a function over items on workers. dimensions : so many, the first of the rest.
        tiles : along the picture's shorter edge, about; and pixels along that of one, at least.
        """
        size = np.array([region[2] - region[0], region[3] - region[1]])
        edge = max(tiles[1], -(-int(size.min()) // tiles[0]))
        columns, rows = -(-size // edge)
        x, y = (
            np.minimum(((np.arange(n * PILOTS) + 0.5) * (edge / PILOTS)).astype(np.int32), end - 1)
            for n, end in zip((columns, rows), size, strict=True)
        )
        x, y = (a.ravel() for a in np.meshgrid(x, y))
        tile = y // edge * columns + x // edge
        some = pixels(x + region[0], y + region[1])
        keys = some.key()
        few, most = POINTS
        most = 1 << int(np.log2(np.clip(evaluations / len(some), few, most)))
        points = SobolPoints(range(max(light.rest_dimensions for light in lights)), seed, 107)
        points.prepare(most)

        def look(work: tuple[int, slice, int, int]) -> tuple[np.ndarray, np.ndarray]:
            """Cells of points from ``start`` to ``end`` of some pilots, and f^2."""
            number, part, start, end = work
            light, pilots = lights[number], some[part]
            u = points.points(keys[part], start, end - start)
            middle = np.full((2, len(pilots), 1), 0.5, np.float32)
            at = u[: light.rest_dimensions].reshape(light.rest_dimensions, -1)
            f = values_at(light, light.first(pilots, middle), len(pilots), None, at)[:3]
            cell = tile[part, None]
            for place in u[:dimensions]:
                cell = cell * CELLS + (place * CELLS).astype(np.intp)
            return cell.ravel(), np.square(f.sum(axis=0, dtype=np.float64))

        def found(number: int, start: int, end: int) -> np.ndarray:
            """Sums (2, rows, columns, CELLS, ...) of f^2 and of f^4."""
            parts = even_parts(len(some), max(1, BATCH // (end - start)))
            cell, square = map(
                np.concatenate, zip(*map_(look, [(number, part, start, end) for part in parts]), strict=True)
            )
            size = rows * columns * CELLS**dimensions
            sums = np.stack([np.bincount(cell, a, size) for a in (square, square * square)])
            return sums.reshape(2, rows, columns, *[CELLS] * dimensions)

        grids, gaining = [], []
        for number in range(len(lights)):
            squares = found(number, 0, few)
            if _gain(_with_neighbours(squares[0])) < WORTH[0]:
                continue
            if most > few:
                squares += found(number, few, most)
            grids.append(_grids(_density(*map(_with_neighbours, squares)), dimensions))
            gaining.append(number)
        if not gaining:
            return None
        knots = np.pad(np.stack(grids, axis=2), [(1, 1)] * 2 + [(0, 0)] * 3, mode="edge")
        return Guide(knots, gaining, edge, region[:2])

    def tiles(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which four tiles (4, R) are around places (R,) in the whole frame, in pixels, and their weights."""
        rows, columns = self._knots.shape[:2]
        at = [
            np.clip((place - start) / self._edge + 0.5, 0, n - 1.001)
            for place, start, n in zip((x, y), self._corner, (columns, rows), strict=True)
        ]
        first = [a.astype(np.intp) for a in at]
        right, up = ((a - i).astype(np.float32) for a, i in zip(at, first, strict=True))
        row = first[1] * columns + first[0]
        return (
            np.stack([row, row + 1, row + columns, row + columns + 1]),
            np.stack([(1 - right) * (1 - up), right * (1 - up), (1 - right) * up, right * up]),
        )

    def stretched(
        self, light: int, tiles: tuple[np.ndarray, np.ndarray], ray: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Places (D, N) at u (D, N) of the grids' D dimensions of a light that gains, and 1 / density (N,).

        tiles : about R rays. ray : (N,), which of these.
        """
        knots = self._knots.reshape(-1)
        first = tiles[0].take(ray, axis=1) * self._knots[0, 0].size
        first += self.gaining.index(light) * self._knots.shape[3] * (CELLS + 1)
        part = tiles[1].take(ray, axis=1)
        place, weight = np.empty(u.shape, np.float32), np.ones(u.shape[1], np.float32)
        grid, before = 0, 0
        for d, at in enumerate(u):
            inside = at * np.float32(CELLS)
            cell = np.minimum(inside.astype(np.intp), CELLS - 1)
            inside -= cell
            knot = (grid + before) * (CELLS + 1) + cell
            grid, before = grid + CELLS**d, before * CELLS + cell
            low = wide = np.float32(0)
            for tile, of_tile in zip(first, part, strict=True):
                at_knot = tile + knot
                of_low = knots.take(at_knot)
                at_knot += 1
                of_wide = knots.take(at_knot)
                of_wide -= of_low
                of_low *= of_tile
                of_wide *= of_tile
                low, wide = of_low + low, of_wide + wide
            np.multiply(wide, inside, out=place[d])
            place[d] += low
            # Tiles' weights add up to 1 but for rounding, and lights take what is inside the open cube.
            np.clip(place[d], INSIDE, 1 - INSIDE, out=place[d])
            wide *= np.float32(CELLS)
            weight *= wide
        return place, weight


class GuidedPoints:
    """A guide at points on surfaces that rays hit.

    gaining : as of `Guide`.
    """

    def __init__(self, guide: Guide, tiles: tuple[np.ndarray, np.ndarray], lane: np.ndarray | None) -> None:
        """tiles : about rays. lane : (M,) of M points, the ray of each; None if every ray hit."""
        self._guide, self._tiles, self._lane = guide, tiles, lane
        self.gaining = guide.gaining

    def stretched(self, light: int, at: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As of `Guide`, at points ``at`` (N,), None for all in order."""
        ray = np.arange(u.shape[1]) if at is None else at
        return self._guide.stretched(
            light, self._tiles, ray if self._lane is None else self._lane.take(ray), u
        )


def _with_neighbours(a: np.ndarray) -> np.ndarray:
    """Sums of tiles (rows, columns, ...) over 1, 2, 1 of neighbours along both axes."""
    for axis in range(2):
        before, after = (np.roll(a, shift, axis) for shift in (1, -1))
        np.moveaxis(before, axis, 0)[0] = np.moveaxis(after, axis, 0)[-1] = 0
        a = before + 2 * a + after
    return a


def _gain(square: np.ndarray) -> float:
    """How many times less f^2 is in the mean if points are spread along each dimension by itself as its sums
    (rows, columns, CELLS, ...) say: these are surer than cells of all.
    """
    axes = tuple(range(2, square.ndim))
    total = square.sum(axis=axes)
    if not total.any():
        return 1.0
    less = np.ones_like(total)
    for own in axes:
        of_cell = square.sum(axis=tuple(a for a in axes if a != own))
        with np.errstate(invalid="ignore", divide="ignore"):
            less *= np.square(np.sqrt(of_cell).sum(axis=-1)) / (CELLS * total)
    return total.sum() / (total * np.where(total > 0, less, 0)).sum()


def _density(square: np.ndarray, fourth: np.ndarray) -> np.ndarray:
    """Part of points in each cell, for sums of f^2 and f^4 (rows, columns, CELLS, ...)."""
    axes = tuple(range(2, square.ndim))
    cells, total = square[0, 0].size, square.sum(axis=axes, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        count = total**2 / fourth.sum(axis=axes, keepdims=True) / cells
        alone = total
        for axis in axes:
            alone = alone * (square.sum(axis=tuple(a for a in axes if a != axis), keepdims=True) / total)
        density = np.sqrt((count * square + SURE * alone) / total)
        density /= density.sum(axis=axes, keepdims=True)
    density = np.where(total > 0, density, 1 / cells)
    # The mean of f^2 over what it is by the best density.
    gain = cells * np.square(density).sum(axis=axes, keepdims=True)
    part = (1 - EVERYWHERE) * np.clip((gain - WORTH[0]) / (WORTH[1] - WORTH[0]), 0, 1)
    return part * density + (1 - part) / cells


def _grids(density: np.ndarray, dimensions: int = DIMENSIONS) -> np.ndarray:
    """(..., G, CELLS + 1) float32 knots of grids, by parts (..., CELLS, ...) of points in cells."""
    leading = density.shape[:-dimensions]
    # What the grids so far have in each of their cells, of the dimensions that are left.
    density = density.reshape(*leading, 1, -1)
    grids = []
    for _ in range(dimensions):
        density = density.reshape(*density.shape[:-1], CELLS, -1)
        knots, taken = _knots(density.sum(axis=-1))
        grids.append(knots)
        density = (taken @ density).reshape(*leading, knots.shape[-2] * CELLS, -1)
    return np.concatenate(grids, axis=-2)


def _knots(density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., CELLS + 1) float32 between which equally many are of points (..., CELLS) in cells;
    and (..., CELLS, CELLS) what part of a cell lies between each two of them.
    """
    below = np.zeros((*density.shape[:-1], CELLS + 1))
    np.cumsum(density, axis=-1, out=below[..., 1:])
    # Where the distribution reaches each of the equal parts.
    wanted = np.arange(1, CELLS) / CELLS * below[..., -1:]
    cell = (below[..., 1:, None] < wanted[..., None, :]).sum(axis=-2).clip(0, CELLS - 1)
    low, own = (np.take_along_axis(a, cell, axis=-1) for a in (below, density))
    knots = np.empty(below.shape, np.float32)
    knots[..., 0], knots[..., -1] = 0, 1
    knots[..., 1:-1] = (cell + np.clip((wanted - low) / own, 0, 1)) / CELLS
    edges = np.arange(CELLS, dtype=np.float32)
    start, end = knots[..., :-1, None] * CELLS, knots[..., 1:, None] * CELLS
    return knots, np.clip(np.minimum(end, edges + 1) - np.maximum(start, edges), 0, None)
