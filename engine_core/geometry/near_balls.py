# SPDX-License-Identifier: GPL-3.0-or-later
"""Which rays come near which of a few balls: all against all, at little cost for each."""

from __future__ import annotations

import numpy as np

from .vectors import dot, inverse_length

_MARGIN = np.float32(2.0**-17)
"""Of squared distances to the frame's centre: twice what the arithmetic can be wrong by."""

_BLOCK = 1 << 15
"""Pairs at once, so that what is known of them stays in a processor's cache."""


class NearBalls:
    """B balls, and rays that may meet them: no ray that does is missed, a few that do not are among them."""

    def __init__(self, balls: list[tuple[np.ndarray, float]]) -> None:
        """balls : centre (3,) and radius of each."""
        centre = np.array([centre for centre, _ in balls]).reshape(-1, 3)
        radius = np.array([radius for _, radius in balls])
        power = dot(centre.T, centre.T) * (1 - _MARGIN) - radius**2 * (1 + _MARGIN)
        one = np.ones((len(balls), 1))
        # Inner products with a ray's unit direction and minus how far along it its origin is; and with its
        # origin, 1 and the origin's square.
        self._foot = np.concatenate([centre, one], axis=1).astype(np.float32)
        self._square = np.concatenate([-2 * centre, power[:, None], one], axis=1).astype(np.float32)
        self._block = _BLOCK // max(1, len(balls))

    def pairs(
        self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Balls (P,), ascending, and rays (P,), ascending within a ball, that may meet before ``reach`` (N,).

        origins, directions : (N, 3) float32, of any length, in which reaches are measured.
        """
        n, balls = len(origins), len(self._foot)
        near = np.empty((balls, n), bool)
        for first in range(0, n, self._block):
            rows = slice(first, first + self._block)
            near[:, rows] = self._near(origins[rows].T, directions[rows].T, reach[rows])
        ball, ray = np.divmod(np.flatnonzero(near), max(1, n))
        return ball, ray

    def _near(self, origin: np.ndarray, direction: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """(B, n) bool of rays (3, n)."""
        inverse = inverse_length(direction)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            unit = direction * inverse
            end = (reach / inverse).astype(np.float32)
            # Where on the ray the foot of the perpendicular from the centre is.
            foot = _products(self._foot, *unit, -dot(origin, unit))
            # Squared distance of the ray's origin to the centre, less the squared radius.
            square = _products(self._square, *origin, np.ones_like(end), dot(origin, origin) * (1 - _MARGIN))
            # That of the nearest point before the end.
            other = np.maximum(foot, np.zeros_like(end))
            np.minimum(other, end, out=other)
            other -= foot
            other *= other
            square += other
            foot *= foot
            square -= foot
            # Where it is not a number, nothing is known.
            return ~(square > 0)


def _products(of_ball: np.ndarray, *of_ray: np.ndarray) -> np.ndarray:
    """(B, n) inner products of (B, k) and k arrays (n,). Not by ``@``, as `integration.rules.weighted`."""
    return np.einsum("bk,kn->bn", of_ball, np.stack(of_ray))
