# SPDX-License-Identifier: GPL-3.0-or-later
"""The bodies of fog that glow, as what samples look for: directions to a ball around each."""

from __future__ import annotations

import numpy as np

from ..geometry.vectors import dot, take
from ..geometry.warps import basis, cap
from .media import Media


def brightest(media: Media) -> list[tuple[np.ndarray, float, float]]:
    """Balls as `Media.glowing` has them, the brightest first, but not of bodies that have no inside."""
    balls = [ball for ball in media.glowing()[0] if 0 < ball[2] < np.inf]
    return sorted(balls, key=lambda ball: -ball[2])


def chosen(chances: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which (N,) of K things that have ``chances`` (K, N) or (K, 1) u[0] chooses, and u (2, N) without it."""
    upper = np.cumsum(chances, axis=0)
    which = np.minimum((u[0] >= upper).sum(axis=0), len(chances) - 1)
    upper, own = (
        np.take_along_axis(np.broadcast_to(x, (len(x), u.shape[1])), which[None], 0)[0]
        for x in (upper, chances)
    )
    return which, np.stack([np.clip((u[0] - (upper - own)) / own, 0, 1), u[1]])


class Cap:
    """Directions to a ball, uniform; from inside of it to a cap that grows to the whole sphere.

    height : (N,) 1 - cos of the cap's half angle: its solid angle over 2 pi.
    """

    def __init__(self, centre: np.ndarray, radius: float, position: np.ndarray) -> None:
        """position : (3, N)."""
        vector = centre[:, None] - position
        square, ball = dot(vector, vector), radius * radius
        outside = square > ball
        with np.errstate(divide="ignore", invalid="ignore"):
            cos = np.sqrt(np.maximum(np.where(outside, 1 - ball / square, 1 - square / ball), 0))
            self.height = np.where(outside, ball / square / (1 + cos), 1 + cos)
            self._axis = vector / np.sqrt(square)
        nowhere = ~np.isfinite(self._axis).all(axis=0)
        self._axis[:, nowhere], self.height[nowhere] = np.eye(3)[:, 2:], 2.0

    def sample(self, rows: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, y, less = cap(*u, self.height.take(rows))
        axis = take(self._axis, rows)
        s, t = basis(axis)
        return x * s + y * t + (1 - less) * axis

    def pdf(self, towards: np.ndarray) -> np.ndarray:
        apart = towards - self._axis
        within = dot(apart, apart) <= 2 * self.height * (1 + 1e-6)
        return np.where(within, 1 / (2 * np.pi * self.height), 0)
