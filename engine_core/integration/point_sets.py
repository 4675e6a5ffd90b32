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

from .sobol import MAX_DIMENSIONS, hash_combine, mix, owen_scramble, sobol, unit_float

SCRAMBLINGS = 16


class PointSet(Protocol):
    """Points of one group of dimensions."""

    def prepare(self, count: int) -> None:
        """Make ready for the first ``count`` points of every bin; from one thread, before ``points``."""

    def points(self, keys: np.ndarray, start: int, count: int) -> np.ndarray:
        """Points ``start`` to ``start + count`` of each bin: (D, B, count) in the open (0, 1).

        keys : (B,) uint32, one for each bin.
        """
        ...


class SobolPoints:
    """Owen-scrambled Sobol nets, moved by a digital (XOR) shift in every bin.

    Each bin sees a (t, m, s)-net for any power of two of samples. There are `SCRAMBLINGS` of each
    dimension, of which a bin takes one by chance: with a single one, neighbours would be wrong together.
    Groups that take one point each together are one net of all their dimensions; a group that is split
    is decorrelated from the others by scrambling the *order* of its points too, since padding an order
    with itself correlates it with the others.
    """

    def __init__(
        self,
        dimensions: Sequence[int],
        seed: int,
        group: int,
        shuffled: bool = False,
        dtype: type = np.float32,
    ) -> None:
        """dimensions : which of the Sobol sequence's; those beyond its last are pseudo-random.

        group : another number, another scrambling. dtype : float32 or float64.
        """
        dimensions = tuple(dimensions)
        self._dimensions = tuple(d for d in dimensions if d < MAX_DIMENSIONS)
        self._random = RandomPoints(len(dimensions) - len(self._dimensions), seed, group + 1000, dtype)
        self._dtype = dtype
        # Of its 32 bits, what a float of 23 holds.
        self._bits = 32 if dtype == np.float64 else 23
        self._shuffled = shuffled
        self._seeds = [int(hash_combine(seed, group, d)[0]) for d in range(len(self._dimensions) + 1)]
        self._nets = np.empty((len(self._dimensions), SCRAMBLINGS, 0), np.uint32)

    def prepare(self, count: int) -> None:
        if self._nets.shape[2] >= count:
            return
        index = np.arange(1 << (count - 1).bit_length(), dtype=np.uint32)
        if self._shuffled:
            index = owen_scramble(index, self._seeds[-1])
        self._nets = np.empty((len(self._dimensions), SCRAMBLINGS, len(index)), np.uint32)
        for nets, d, seed in zip(self._nets, self._dimensions, self._seeds, strict=False):
            seeds = hash_combine(seed, np.arange(SCRAMBLINGS))
            nets[:] = owen_scramble(sobol(index, d), seeds[:, None], self._bits)

    def points(self, keys: np.ndarray, start: int, count: int) -> np.ndarray:
        others = self._random.points(keys, start, count)
        out = np.empty((len(self._nets) + len(others), len(keys), count), self._dtype)
        for row, nets, seed in zip(out, self._nets, self._seeds, strict=False):
            shift = mix(keys ^ np.uint32(seed))
            which = mix(shift ^ np.uint32(0x9E3779B9)) % np.uint32(SCRAMBLINGS)
            net = nets[:, start : start + count].take(which, axis=0)
            net ^= shift[:, None]
            row[:] = unit_float(net, self._dtype)
        out[len(self._nets) :] = others
        return out


class RandomPoints:
    """Independent pseudo-random points, from a hash of bin, dimension and sample number."""

    def __init__(self, dimensions: int, seed: int, group: int, dtype: type = np.float32) -> None:
        """dimensions : how many. group : another number, other points. dtype : float32 or float64."""
        self._dtype = dtype
        self._seeds = [int(hash_combine(seed, group, d, 1)[0]) for d in range(dimensions)]

    def prepare(self, count: int) -> None:
        pass

    def points(self, keys: np.ndarray, start: int, count: int) -> np.ndarray:
        out = np.empty((len(self._seeds), len(keys), count), self._dtype)
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
            out[d] = unit_float(x, self._dtype)
        return out


def staged_points(
    integrator: str, screen: int, rest: int, split: int, seed: int, dtype: type = np.float32
) -> tuple[PointSet, PointSet]:
    """Points for ``screen`` dimensions and for ``rest`` ones, of which a screen point gets ``split``.

    The sequence's first dimensions are its best, so an integrand's come in the order of the variance
    that they carry: a point on a light before the choice of the light.
    """
    if integrator == "monte_carlo":
        return RandomPoints(screen, seed, 0, dtype), RandomPoints(rest, seed, 1, dtype)
    first = SobolPoints(range(screen), seed, 0, dtype=dtype)
    if split == 1:
        return first, SobolPoints(range(screen, screen + rest), seed, 1, dtype=dtype)
    return first, SobolPoints(range(rest), seed, 1, shuffled=True, dtype=dtype)
