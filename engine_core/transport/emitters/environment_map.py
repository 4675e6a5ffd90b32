# SPDX-License-Identifier: GPL-3.0-or-later
"""An equirectangular picture: radiance by direction, and directions in proportion to it.

Radiance is interpolated linearly between the centres of texels, so the cells of the distribution are
what lies between four centres: a row is chosen, in it a cell, and in the cell a point by the bilinear
function that luminance is there. Cells are mapped by the height z, to which solid angle is
proportional, so the density is the luminance over its integral; only next to the poles does
interpolating by z differ from interpolating by the angle.
"""

from __future__ import annotations

import numpy as np

from ...geometry.vectors import dot
from ...geometry.warps import linear

FEWEST = 32, 64
"""Rows and columns of texels at least."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


class EnvironmentMap:
    """Radiance from all directions.

    Oriented as in Blender: row 0 looks down -Z, the middle of a row along +X, its first quarter along +Y.

    mean : (3,) float64, radiance over all directions.
    z : (rows + 1,) ascending heights between rows of cells.
    """

    def __init__(self, image: np.ndarray, rotation: np.ndarray) -> None:
        """image : (H, W, 3) float32, linear, at least 0. rotation : (3, 3), from world to picture."""
        image = _enlarged(image)
        height, width = image.shape[:2]
        self._height, self._width = height, width
        self._rotation = rotation.astype(np.float32)
        # Columns close to a circle; beyond a pole Cycles goes on with the opposite row.
        texels = np.concatenate([image[-1:], image, image[:1]])
        texels = np.concatenate([texels, texels[:, :1]], axis=1)
        self._texels = texels.reshape(-1, 3)

        # Rows of nodes are the centres, and the poles half a texel further.
        node = texels.astype(np.float64)
        node[0] = 0.5 * (node[0] + node[1])
        node[-1] = 0.5 * (node[-2] + node[-1])
        angle = np.pi / height * np.clip(np.arange(height + 2) - 0.5, 0, height)
        self.z = -np.cos(angle)
        solid_angle = np.diff(self.z)[:, None] * (2 * np.pi / width)
        cell = 0.25 * (node[:-1, :-1] + node[1:, :-1] + node[:-1, 1:] + node[1:, 1:])
        self.mean = (cell * solid_angle[..., None]).sum(axis=(0, 1)) / (4 * np.pi)
        # Over the largest, as float32 has no squares of what is extreme.
        node = node @ LUMINANCE.astype(np.float64)
        largest = max(node.max(), 1e-300)
        self._node = (node / largest).astype(np.float32).reshape(-1)
        weight = np.maximum(cell @ LUMINANCE.astype(np.float64), 0) * solid_angle
        row = weight.sum(axis=1)
        self._inverse_total = np.float32(largest / max(row.sum(), 1e-300))
        self._row_table = np.concatenate([[0], np.cumsum(row)]) / max(row.sum(), 1e-300)
        # One ascending table of all rows: number of the row + share of it up to the cell's end. What is
        # black to the end of its row is never reached, as the share there is already 1.
        share = np.cumsum(weight, axis=1)
        share /= np.maximum(share[:, -1:], 1e-300)
        self._cell_table = (share + np.arange(height + 1)[:, None]).reshape(-1)

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """(3, N) towards the origin from ``directions`` (3, N) of any length but 0."""
        x, y, z = self._rotation @ directions
        s = (0.5 - np.arctan2(y, x) * np.float32(0.5 / np.pi)) * self._width - np.float32(0.5)
        # The angle to the pole, exact near both.
        t = np.arctan2(np.hypot(x, y), -z) * np.float32(self._height / np.pi) - np.float32(0.5)
        column, row = np.floor(s), np.floor(t)
        s, t = (s - column)[:, None], (t - row)[:, None]
        column = column.astype(np.int32) % self._width
        first = (np.clip(row, -1, self._height - 1).astype(np.int32) + 1) * (self._width + 1) + column
        below, above = (
            self._texels.take(at, axis=0) * (1 - s) + self._texels.take(at + 1, axis=0) * s
            for at in (first, first + self._width + 1)
        )
        return np.ascontiguousarray((below * (1 - t) + above * t).T)

    def shares(self) -> np.ndarray:
        """(rows, columns) float64 of all luminance in cells."""
        upto = self._cell_table.reshape(self._height + 1, self._width) - np.arange(self._height + 1)[:, None]
        return np.diff(upto, axis=1, prepend=0) * np.diff(self._row_table)[:, None]

    def angle(self, column: np.ndarray) -> np.ndarray:
        """About the axis, in the picture, at which cells in columns begin."""
        return (column + 0.5) * (-2 * np.pi / self._width) + np.pi

    def local(self, directions: np.ndarray) -> np.ndarray:
        """(3, N) in the picture."""
        return self._rotation @ directions

    def sample(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (3, N) for u (2, N), and their densities per solid angle (N,)."""
        v = u[1].astype(np.float64)
        row = self._row_at(self._row_table, v)
        low, high = self._row_table.take(row), self._row_table.take(row + 1)
        t = (v - low) / np.maximum(high - low, 1e-300)
        return self.within(row, (np.zeros_like(row), np.full_like(row, self._width)), self._width, u[0], t)

    def within(
        self,
        row: np.ndarray,
        columns: tuple[np.ndarray, np.ndarray],
        most: int,
        u: np.ndarray,
        t: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (3, N) in rows (N,) of cells, by luminance between columns (N,), the last excluded,
        ``most`` of them; and luminance there over its integral (N,). u, t : (N,) places along the row, and
        across it.
        """
        first, end = (row * self._width + column for column in columns)
        begin = np.where(columns[0] > 0, self._cell_table.take(first - 1, mode="wrap"), row)
        v = begin + u.astype(np.float64) * (self._cell_table.take(end - 1) - begin)
        cell = first_beyond(self._cell_table, first, end - 1, v, most)
        column = cell - row * self._width
        low = np.where(cell > first, self._cell_table.take(cell - 1, mode="wrap"), begin)
        s = ((v - low) / np.maximum(self._cell_table.take(cell) - low, 1e-300)).astype(np.float32)
        # The corners of the cell, from the lower left.
        corner = cell + row
        a, b, c, d = (self._node.take(corner + k) for k in (0, 1, self._width + 1, self._width + 2))
        t = linear(a + b, c + d, t.astype(np.float32))
        left, right = a + (c - a) * t, b + (d - b) * t
        s = linear(left, right, s)
        share = (left + (right - left) * s) * self._inverse_total
        low, high = self.z.take(row), self.z.take(row + 1)
        # Heights from the nearer pole keep their digits where the horizontal part is small.
        up = 1 + low + t * (high - low)
        horizontal = np.sqrt(np.maximum(up * (2 - up), 0)).astype(np.float32)
        angle = self.angle(column + s).astype(np.float32)
        local = np.stack(
            [horizontal * np.cos(angle), horizontal * np.sin(angle), (up - 1).astype(np.float32)]
        )
        return self._rotation.T @ local, share

    def pdf(self, directions: np.ndarray) -> np.ndarray:
        """(N,) density per solid angle with which `sample` returns ``directions`` (3, N)."""
        return self.share_at(directions)[2]

    def _row_at(self, table: np.ndarray, value: np.ndarray) -> np.ndarray:
        """(N,) rows of cells that values (N,) are in, by a ``table`` (rows + 1,) of where rows begin."""
        end = self._height + 1
        return first_beyond(table, np.ones(len(value), np.intp), end, value, end) - 1

    def share_at(self, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows and columns (N,) of the cells that ``directions`` (3, N) meet, and luminance there over its
        integral.
        """
        x, y, z = self._rotation @ directions
        z = (z / np.sqrt(np.maximum(dot(directions, directions), np.float32(1e-30)))).astype(np.float64)
        row = self._row_at(self.z, z)
        low, high = self.z.take(row), self.z.take(row + 1)
        t = np.clip((z - low) / (high - low), 0, 1).astype(np.float32)
        s = (0.5 - np.arctan2(y, x) * np.float32(0.5 / np.pi)) * self._width - np.float32(0.5)
        column = np.floor(s)
        s -= column
        column = column.astype(np.int32) % self._width
        corner = row * (self._width + 1) + column
        a, b, c, d = (self._node.take(corner + k) for k in (0, 1, self._width + 1, self._width + 2))
        left, right = a + (c - a) * t, b + (d - b) * t
        return row, column, (left + (right - left) * s) * self._inverse_total


def first_beyond(
    table: np.ndarray, first: np.ndarray, last: np.ndarray | int, value: np.ndarray, most: int
) -> np.ndarray:
    """(N,) where in an ascending ``table`` the first number is that exceeds ``value`` (N,), of those from
    ``first`` to ``last`` (N,), at most so many; ``last`` if no other does.

    Several times faster than `numpy.searchsorted` in a whole table, whose steps are mispredicted.
    """
    at, step = first.copy(), 1 << (most - 1).bit_length() >> 1
    while step:
        beyond = at + (step - 1)
        less = table.take(beyond, mode="clip") <= value
        less &= beyond < last
        at += step * less
        step >>= 1
    return at


def _enlarged(image: np.ndarray) -> np.ndarray:
    """The same function of the direction, by at least `FEWEST` texels."""
    for axis, fewest in enumerate(FEWEST):
        # By an odd number old centres of texels are new ones.
        times = -(-fewest // image.shape[axis]) | 1
        if times > 1 and fewest > image.shape[axis]:
            at = (np.arange(image.shape[axis] * times) + 0.5) / times - 0.5
            low = np.floor(at).astype(np.intp)
            part = np.expand_dims(at - low, tuple(n for n in range(3) if n != axis)).astype(np.float32)
            before, after = (image.take(number % image.shape[axis], axis=axis) for number in (low, low + 1))
            image = before * (1 - part) + after * part
    return image
