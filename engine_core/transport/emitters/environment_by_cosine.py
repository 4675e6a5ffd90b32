# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions to an environment map, in proportion to its luminance times the cosine to a surface.

Of a few normals v_k, places of a grid on an octahedron, that product is tabulated. Between three of them, the
corners of its triangle of the grid, every normal n is linear, and so is its cosine:

    n = |n|_1 sum_k b_k v_k,        n . d = |n|_1 sum_k b_k (v_k . d)

One of the three tables is chosen, by its part of what they tell together. Tables are of blocks of the map's
cells; within one, directions follow luminance alone. What they have of a block is the mean over it of the
cosine, of parts below the horizon 0, and a bit more: no direction is left out that brings light, and few
next to the horizon have a weight far above others'. Where the three horizons differ, some samples are wasted.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from .environment_map import EnvironmentMap, first_beyond

LEVEL = 4
"""Parts into which edges of the octahedron are cut."""

BLOCKS = 32, 64
"""Rows and columns of a map, about."""

PARTS = 4
"""Of a block along either edge, by which its mean cosine is told."""

Place = tuple[np.ndarray, np.ndarray]
"""Vertices (3, N) of the grid about N normals, and their weights (3, N), which add up to 1."""


class EnvironmentByCosine:
    """An environment map, as surfaces are lit by it."""

    def __init__(self, environment: EnvironmentMap) -> None:
        """environment : of at least one cell in each of `BLOCKS`."""
        self._map = environment
        share = environment.shares()
        self._rows, self._columns = (_edges(n, most) for n, most in zip(share.shape, BLOCKS, strict=True))
        self._most = tuple(int(np.diff(edges).max()) for edges in (self._rows, self._columns))
        of_row = np.repeat(np.arange(BLOCKS[0]), np.diff(self._rows))
        self._row_of, self._column_of = of_row, np.repeat(np.arange(BLOCKS[1]), np.diff(self._columns))
        in_columns = np.add.reduceat(share, self._columns[:-1], axis=1)
        block = np.add.reduceat(in_columns, self._rows[:-1], axis=0)
        # Of each column of blocks, ascending over all of the map's rows: number of the block + share of it up
        # to the row's end.
        upto = np.cumsum(in_columns, axis=0)
        before = np.concatenate([np.zeros((1, BLOCKS[1])), upto])[self._rows[:-1]]
        part = (upto - before[of_row]) / np.maximum(block, 1e-300)[of_row]
        number = of_row[:, None] + BLOCKS[0] * np.arange(BLOCKS[1])
        self._row_table = (np.clip(part, 0, 1) + number).T.ravel()
        vertices, self._vertex = _grid()
        cosine = self._cosines(vertices)
        weight = cosine * block
        self._total = weight.sum(axis=(1, 2)).astype(np.float32)
        self._cosine = cosine.astype(np.float32).ravel()
        self._block_rows = _ascending(weight.sum(axis=2))
        self._block_columns = _ascending(weight.reshape(-1, BLOCKS[1]))

    def _cosines(self, vertices: np.ndarray) -> np.ndarray:
        """(K, *BLOCKS) means of the cosine to normals (K, 3), of each part as much as it has anywhere."""
        heights, angles = _refined(self._map.z[self._rows]), _refined(self._map.angle(self._columns))
        middle = _directions(*((a[1:] + a[:-1]) / 2 for a in (heights, angles)))
        reach = np.zeros(middle.shape[1:])
        for z, angle in product((heights[1:], heights[:-1]), (angles[1:], angles[:-1])):
            reach = np.maximum(reach, np.sqrt(np.square(middle - _directions(z, angle)).sum(axis=0)))
        found = np.maximum(np.tensordot(vertices, middle, 1) + 1.01 * reach, 0)
        return found.reshape(len(vertices), BLOCKS[0], PARTS, BLOCKS[1], PARTS).mean(axis=(2, 4))

    def _place(self, normal: np.ndarray) -> tuple[Place, np.ndarray]:
        """Of normals (3, N), and the sums of their parts (N,)."""
        local = self._map.local(normal)
        size = np.abs(local)
        total = size[0] + size[1] + size[2]
        a, b = size[:2] * (LEVEL / np.maximum(total, np.float32(1e-30)))
        i, j = np.floor(a), np.floor(b)
        a, b = a - i, b - j
        # Of a square of the grid, the triangle beyond its diagonal.
        over = a + b > 1
        first = np.where(over, a + b - 1, 1 - a - b)
        second, third = np.where(over, 1 - b, a), np.where(over, 1 - a, b)
        octant = (local[0] < 0) * 4 + (local[1] < 0) * 2 + (local[2] < 0)
        corner = ((octant * (LEVEL + 2) + i.astype(np.intp)) * (LEVEL + 2)) + j.astype(np.intp)
        corners = np.stack([corner + over * (LEVEL + 3), corner + (LEVEL + 2), corner + 1])
        # Whatever a normal is that is none.
        return (self._vertex.take(corners, mode="clip"), np.stack([first, second, third])), total

    def irradiance(self, normal: np.ndarray) -> np.ndarray:
        """(N,) that luminance of mean 1 over all directions makes on surfaces of normals (3, N)."""
        (vertex, weight), total = self._place(normal)
        return total * (weight * self._total.take(vertex)).sum(axis=0) * np.float32(4 * np.pi)

    def sample(self, normal: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (3, N) for u (2, N), and their densities per solid angle (N,), 0 where all light is
        behind.

        normal : (3, N) unit.
        """
        (rows, columns), (vertex, weight) = BLOCKS, self._place(normal)[0]
        first, second, third = weight * self._total.take(vertex)
        second += first
        third += second
        x = u[0] * third
        which = (x >= first).astype(np.intp) + (x >= second)
        lane = np.arange(len(x))
        bounds = np.stack([np.zeros_like(first), first, second, third])
        low, high = bounds[which, lane], bounds[which + 1, lane]
        v = (x - low) / np.maximum(high - low, np.float32(1e-37))
        table = vertex[which, lane]
        row, w = _find(self._block_rows, table, rows, u[1].astype(np.float64))
        column, v = _find(self._block_columns, table * rows + row, columns, v.astype(np.float64))
        # In the block, by luminance.
        number, low = column * rows + row, self._rows.take(row)
        of_column = column * len(self._row_of)
        last = of_column + self._rows.take(row + 1) - 1
        at = first_beyond(self._row_table, of_column + low, last, number + w, self._most[0])
        begin = np.where(at > of_column + low, self._row_table.take(at - 1, mode="wrap"), number)
        w = _part(number + w, begin, self._row_table.take(at))
        span = self._columns.take(column), self._columns.take(column + 1)
        direction, luminance = self._map.within(at - of_column, span, self._most[1], v, w)
        return direction, luminance * self._factor(number % rows * columns + column, vertex, weight)

    def pdf(self, normal: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(N,) density per solid angle with which `sample` returns ``directions`` (3, N)."""
        (vertex, weight), _ = self._place(normal)
        row, column, share = self._map.share_at(directions)
        return share * self._factor(
            self._row_of.take(row) * BLOCKS[1] + self._column_of.take(column), vertex, weight
        )

    def _factor(self, block: np.ndarray, vertex: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """(N,) density in blocks (N,) over that by luminance alone."""
        total = (weight * self._total.take(vertex)).sum(axis=0)
        cosine = (weight * self._cosine.take(vertex * (BLOCKS[0] * BLOCKS[1]) + block)).sum(axis=0)
        return np.where(total > 0, cosine / np.maximum(total, np.float32(1e-37)), 0)


def _grid() -> tuple[np.ndarray, np.ndarray]:
    """(K, 3) places of the grid on the octahedron |x| + |y| + |z| = 1, and which of these has a sign of the
    axes and steps along the first two, flat.
    """
    places: dict[tuple[int, ...], int] = {}
    vertex = np.zeros((8, LEVEL + 2, LEVEL + 2), np.intp)
    for octant, signs in enumerate(product((1, -1), repeat=3)):
        for i, j in product(range(LEVEL + 1), repeat=2):
            if i + j <= LEVEL:
                place = tuple(s * n for s, n in zip(signs, (i, j, LEVEL - i - j), strict=True))
                vertex[octant, i, j] = places.setdefault(place, len(places))
    return np.array(list(places)) / LEVEL, vertex.ravel()


def _edges(cells: int, blocks: int) -> np.ndarray:
    return np.arange(blocks + 1) * cells // blocks


def _refined(edges: np.ndarray) -> np.ndarray:
    """`PARTS` steps between each two."""
    return np.interp(np.arange((len(edges) - 1) * PARTS + 1) / PARTS, np.arange(len(edges)), edges)


def _directions(z: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(3, rows, columns) at heights z (rows,) and angles (columns,)."""
    z, angle = np.meshgrid(z, angle, indexing="ij")
    flat = np.sqrt(np.maximum(1 - z * z, 0))
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), z])


def _ascending(weight: np.ndarray) -> np.ndarray:
    """Flat table of rows of (M, n): number of the row + share of it up to each."""
    upto = np.cumsum(weight, axis=1)
    return (upto / np.maximum(upto[:, -1:], 1e-300) + np.arange(len(weight))[:, None]).ravel()


def _find(table: np.ndarray, row: np.ndarray, n: int, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where in rows (N,) of n of such a table u (N,) are, and u stretched."""
    first = row * n
    at = first_beyond(table, first, first + (n - 1), row + u, n)
    low = np.where(at > first, table.take(at - 1, mode="wrap"), row)
    return at - first, _part(row + u, low, table.take(at))


def _part(value: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(N,) of the way from ``low`` to ``high`` (N,), inside of it also where both are one."""
    return np.clip((value - low) / np.maximum(high - low, 1e-300), 0, 1)
