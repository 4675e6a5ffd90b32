# SPDX-License-Identifier: GPL-3.0-or-later
"""Where an integrand is evaluated: points in primary space for every bin.

A bin (a pixel) is known to a point set by a 32-bit key alone; sample i of a bin is the same point
whoever asks for it, in whatever batch. Dimensions come in groups that the integrand names, such as
(2, 3): two for the screen, then three for the rest. A group may take several points for each
sample of the groups before it ("splitting").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from .sobol import hash_combine, mix, owen_scramble, sobol, unit_float


class PointSet(Protocol):
    """Points of one group of dimensions."""

    def prepare(self, count: int) -> None:
        """Make ready for the first ``count`` points of every bin; from one thread, before ``points``."""

    def points(self, keys: np.ndarray, start: int, count: int) -> np.ndarray:
        """Points ``start`` to ``start + count`` of each bin: (D, B, count) float32 in (0, 1).

        keys : (B,) uint32, one for each bin.
        """
        ...


class SobolPoints:
    """One Owen-scrambled Sobol net, moved by a digital (XOR) shift in every bin.

    Each bin sees a (t, m, s)-net for any power of two of samples. Groups that take one point each
    together are one net of all their dimensions; a group that is split is decorrelated from the
    others by scrambling the *order* of its points too, since padding an order with itself
    correlates it with the others.
    """

    def __init__(self, dimensions: Sequence[int], seed: int, group: int, shuffled: bool = False) -> None:
        """dimensions : which of the Sobol sequence's. group : another number, another scrambling."""
        self._dimensions = tuple(dimensions)
        self._shuffled = shuffled
        self._seeds = [int(hash_combine(seed, group, d)[0]) for d in range(len(self._dimensions) + 1)]
        self._net = np.empty((len(self._dimensions), 0), np.uint32)

    def prepare(self, count: int) -> None:
        if self._net.shape[1] < count:
            index = np.arange(1 << (count - 1).bit_length(), dtype=np.uint32)
            if self._shuffled:
                index = owen_scramble(index, self._seeds[-1])
            self._net = np.stack(
                [
                    owen_scramble(sobol(index, d), seed)
                    for d, seed in zip(self._dimensions, self._seeds, strict=False)
                ]
            )

    def points(self, keys: np.ndarray, start: int, count: int) -> np.ndarray:
        net = self._net[:, start : start + count]
        out = np.empty((len(net), len(keys), count), np.float32)
        for row, coordinates, seed in zip(out, net, self._seeds, strict=False):
            shift = mix(keys ^ np.uint32(seed))
            row[:] = unit_float(coordinates ^ shift[:, None])
        return out


class RandomPoints:
    """Independent pseudo-random points, from a hash of bin, dimension and sample number."""

    def __init__(self, dimensions: int, seed: int, group: int) -> None:
        """dimensions : how many. group : another number, other points."""
        self._seeds = [int(hash_combine(seed, group, d, 1)[0]) for d in range(dimensions)]

    def prepare(self, count: int) -> None:
        pass

    def points(self, keys: np.ndarray, start: int, count: int) -> np.ndarray:
        out = np.empty((len(self._seeds), len(keys), count), np.float32)
        weyl = np.arange(start, start + count, dtype=np.uint32) * np.uint32(0x9E3779B9)
        for d, seed in enumerate(self._seeds):
            first = mix(keys ^ np.uint32(seed))
            second = mix(first + np.uint32(seed))
            x = first[:, None] + weyl
            x ^= x >> np.uint32(16)
            x *= np.uint32(0x7FEB352D)
            x ^= second[:, None]
            x ^= x >> np.uint32(15)
            x *= np.uint32(0x846CA68B)
            x ^= x >> np.uint32(16)
            out[d] = unit_float(x)
        return out


def staged_points(
    integrator: str, screen: int, rest: int, split: int, seed: int
) -> tuple[PointSet, PointSet]:
    """Points for ``screen`` dimensions and for ``rest`` ones, of which a screen point gets ``split``.

    The rest's last two dimensions are where most of the variance is (a point on a light), so they
    get the pair of Sobol dimensions that measures best there.
    """
    if integrator == "monte_carlo":
        return RandomPoints(screen, seed, 0), RandomPoints(rest, seed, 1)
    first = range(screen)
    if split == 1:
        best, others = (screen, screen + 1), range(screen + 2, screen + rest)
        return SobolPoints(first, seed, 0), SobolPoints([*others, *best], seed, 1)
    return SobolPoints(first, seed, 0), SobolPoints([*range(2, rest), 0, 1], seed, 1, shuffled=True)
