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

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)


class EnvironmentMap:
    """Radiance from all directions.

    Oriented as in Blender: row 0 looks down -Z, the middle of a row along +X, its first quarter along +Y.

    mean : (3,) float64, radiance over all directions.
    """

    def __init__(self, image: np.ndarray, rotation: np.ndarray) -> None:
        """image : (H, W, 3) float32, linear, at least 0. rotation : (3, 3), from world to picture."""
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
        self._z = -np.cos(angle)
        solid_angle = np.diff(self._z)[:, None] * (2 * np.pi / width)
        cell = 0.25 * (node[:-1, :-1] + node[1:, :-1] + node[:-1, 1:] + node[1:, 1:])
        self.mean = (cell * solid_angle[..., None]).sum(axis=(0, 1)) / (4 * np.pi)
        self._node = (node @ LUMINANCE.astype(np.float64)).astype(np.float32).reshape(-1)
        weight = np.maximum(cell @ LUMINANCE.astype(np.float64), 0) * solid_angle
        row = weight.sum(axis=1)
        self._inverse_total = np.float32(1 / max(row.sum(), 1e-37))
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

    def sample(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Unit directions (3, N) for u (2, N), and their densities per solid angle (N,)."""
        v = u[1].astype(np.float64)
        row = np.clip(np.searchsorted(self._row_table, v, side="right") - 1, 0, self._height)
        low, high = self._row_table.take(row), self._row_table.take(row + 1)
        t = ((v - low) / np.maximum(high - low, 1e-300)).astype(np.float32)
        v = u[0].astype(np.float64) + row
        cell = np.searchsorted(self._cell_table, v, side="right")
        first_of_row = row * self._width
        np.clip(cell, first_of_row, first_of_row + (self._width - 1), out=cell)
        column = cell - first_of_row
        low = np.where(column > 0, self._cell_table.take(cell - 1, mode="wrap"), row)
        s = ((v - low) / np.maximum(self._cell_table.take(cell) - low, 1e-300)).astype(np.float32)
        # The corners of the cell, from the lower left.
        corner = cell + row
        a, b, c, d = (self._node.take(corner + k) for k in (0, 1, self._width + 1, self._width + 2))
        t = linear(a + b, c + d, t)
        left, right = a + (c - a) * t, b + (d - b) * t
        s = linear(left, right, s)
        density = (left + (right - left) * s) * self._inverse_total
        low, high = self._z.take(row), self._z.take(row + 1)
        # Heights from the nearer pole keep their digits where the horizontal part is small.
        up = 1 + low + t * (high - low)
        horizontal = np.sqrt(np.maximum(up * (2 - up), 0)).astype(np.float32)
        angle = (column + s + np.float32(0.5)) * np.float32(-2 * np.pi / self._width) + np.float32(np.pi)
        local = np.stack(
            [horizontal * np.cos(angle), horizontal * np.sin(angle), (up - 1).astype(np.float32)]
        )
        return self._rotation.T @ local, density

    def pdf(self, directions: np.ndarray) -> np.ndarray:
        """(N,) density per solid angle with which `sample` returns ``directions`` (3, N)."""
        x, y, z = self._rotation @ directions
        z = (z / np.sqrt(np.maximum(dot(directions, directions), np.float32(1e-30)))).astype(np.float64)
        row = np.clip(np.searchsorted(self._z, z, side="right") - 1, 0, self._height)
        low, high = self._z.take(row), self._z.take(row + 1)
        t = np.clip((z - low) / (high - low), 0, 1).astype(np.float32)
        s = (0.5 - np.arctan2(y, x) * np.float32(0.5 / np.pi)) * self._width - np.float32(0.5)
        column = np.floor(s)
        s -= column
        corner = row * (self._width + 1) + column.astype(np.int32) % self._width
        a, b, c, d = (self._node.take(corner + k) for k in (0, 1, self._width + 1, self._width + 2))
        left, right = a + (c - a) * t, b + (d - b) * t
        return (left + (right - left) * s) * self._inverse_total
