# SPDX-License-Identifier: GPL-3.0-or-later
"""How far an estimate may be off, told from its own samples.

The two halves of n independent samples differ by twice the standard error of their mean. The points of
a net are better than independent, and by how much depends on the integrand and the net: the halves
overstate the variance 1 to 7 times. So a few bins are sampled twice, by independent nets. These tell the
truth about themselves, and how much the halves overstate in their neighbourhood.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

NEAR, FAR = 2, 8
"""Bins to either side over which a bin's own evidence, and that of the bins sampled twice, is pooled."""

FEWEST = 64
"""Bins of a picture below which none is sampled twice, and samples count as independent."""

TRUST_OF_ALL = 1.0
"""How many bins' worth the whole picture weighs beside a bin's neighbourhood."""

FEW, TYPICAL = 2.0, 0.5
"""How many bins' worth is believed without a witness, and by what the halves overstate the variance."""

SECOND = np.uint32(0x5BD1E995)
"""Another key of the same bin, for an independent net."""

_GOLDEN = 0.6180339887498949


def sampled_twice(bins: int, one_in: int, seed: int) -> np.ndarray:
    """(B,) which bins are: about one in so many, evenly spread; none of a tiny picture."""
    if bins < FEWEST:
        return np.zeros(bins, bool)
    place = (np.arange(bins) + seed % 1009) * _GOLDEN
    return place - np.floor(place) < 1.0 / one_in


@dataclass(eq=False)
class Spread:
    """What B bins' samples say of their own noise, (C, B) each.

    half : half the difference of the two halves' means; 0 of a single sample.
    twice : the difference of two independent means over sqrt(2); NaN where there is only one. Where a bin
        is sampled by chance, its estimate, which is 0 if it was not.
    """

    half: np.ndarray
    twice: np.ndarray

    @classmethod
    def empty(cls, channels: int, bins: int) -> Spread:
        return cls(np.zeros((channels, bins)), np.full((channels, bins), np.nan))

    def of(self, which: np.ndarray) -> Spread:
        """That of some bins, ``which`` (B,) bool or (B',)."""
        return Spread(self.half[:, which], self.twice[:, which])

    def store(self, where: np.ndarray, other: Spread) -> None:
        """Take over another's bins, all of them, as ``where`` (B',)."""
        self.half[:, where] = other.half
        self.twice[:, where] = other.twice


def standard_error(
    spread: Spread,
    count: np.ndarray,
    bins: tuple[int, ...],
    predicted: np.ndarray | None = None,
    chance: np.ndarray | None = None,
    independent: bool = False,
) -> np.ndarray:
    """(C, B) standard errors of means of ``count`` (B,) samples, the mean of two where sampled twice.

    predicted : (B,) deviation of a sample, known beforehand but for a factor; None for the same everywhere.
    chance : (B,) that a bin is sampled at all, its estimate being divided by it.
    independent : whether samples are independent.
    """
    channels, total = spread.half.shape
    shape = (channels, *bins)
    twice = ~np.isnan(spread.twice[0])
    chance = np.ones(total) if chance is None else chance
    square = np.ones(total) if predicted is None else np.square(predicted, dtype=np.float64)
    square = square + 1e-6 * square.mean() + 1e-300

    # Bins with halves: these, pooled over neighbours in proportion to what was predicted.
    halves = count >= 2
    expected = square * np.maximum(count, 1) ** -1.5
    evidence = (
        _pooled(np.where(halves, np.square(spread.half), 0), np.where(halves, expected, 0), shape, NEAR)
        * expected
    )
    # Of a single sample nothing is known but what was predicted, whether it was drawn or not.
    single = count < 2
    evidence[:, single] = (square / chance)[single]
    variance = np.empty((channels, total))
    for kind in (halves, single):
        seen = kind & twice
        truth = np.where(seen, np.square(spread.twice), 0)
        basis = np.where(seen, evidence, 0)
        if independent and kind is halves or not seen.any():
            # Without a witness, halves count as independent, which overstates, and a prediction is believed.
            known = kind is halves or predicted is not None
            scale = np.full((channels, total), 1.0 if known else np.inf)
        else:
            # Few witnesses may all have seen nothing.
            few = FEW * evidence[:, kind].mean(axis=1)
            whole = (truth.sum(axis=1) + TYPICAL * few) / np.maximum(basis.sum(axis=1) + few, 1e-300)
            prior = TRUST_OF_ALL * basis.sum(axis=1) / seen.sum()
            near = box_sums(truth.reshape(shape), FAR).reshape(channels, total) + (whole * prior)[:, None]
            scale = near / np.maximum(
                box_sums(basis.reshape(shape), FAR).reshape(channels, total) + prior[:, None], 1e-300
            )
        variance[:, kind] = (evidence * scale)[:, kind]
    variance[:, twice & (chance >= 1)] /= 2
    variance[np.isnan(variance)] = np.inf
    return np.sqrt(variance)


def _pooled(values: np.ndarray, weights: np.ndarray, shape: tuple[int, ...], reach: int) -> np.ndarray:
    """(C, B) sums of values over sums of weights (B,), both over the neighbourhood."""
    weights = np.broadcast_to(weights, values.shape)
    found, hoped = (box_sums(a.reshape(shape), reach).reshape(values.shape) for a in (values, weights))
    return np.where(hoped > 0, found / np.where(hoped > 0, hoped, 1), 0)


def box_sums(values: np.ndarray, reach: int) -> np.ndarray:
    """Sums over the bins within ``reach`` along each axis but the first, and within the picture."""
    for axis in range(1, values.ndim):
        size = values.shape[axis]
        # Sums of all before: nothing before the first, the same for all behind the last.
        shape = list(values.shape)
        shape[axis] += 2 * reach + 1
        running = np.moveaxis(np.zeros(shape), axis, 0)
        inside = running[reach + 1 : reach + 1 + size]
        np.cumsum(np.moveaxis(values, axis, 0), axis=0, out=inside)
        running[reach + 1 + size :] = inside[-1]
        sums = running[2 * reach + 1 :] - running[:size]
        # A difference of running sums may fall a rounding below zero.
        values = np.moveaxis(np.maximum(sums, 0, out=sums), 0, axis)
    return values


def sums_around(a: np.ndarray, axis: int, weights: np.ndarray) -> np.ndarray:
    """Sums of ``a`` and those around it along an axis, by weights."""
    reach, n = len(weights) // 2, a.shape[axis]
    sums = weights[reach] * a
    for shift in range(1, min(reach, n - 1) + 1):
        low, high = [slice(None)] * a.ndim, [slice(None)] * a.ndim
        low[axis], high[axis] = slice(None, -shift), slice(shift, None)
        sums[tuple(low)] += weights[reach + shift] * a[tuple(high)]
        sums[tuple(high)] += weights[reach - shift] * a[tuple(low)]
    return sums
