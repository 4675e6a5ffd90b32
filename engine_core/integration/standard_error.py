# SPDX-License-Identifier: GPL-3.0-or-later
"""How far an estimate may be off, told from the halves of its own samples.

The two halves of n independent samples differ by twice the standard error of their mean. The points
of a net are better than independent: their variance falls as n^-p, 1 <= p <= 3, so that the halves,
which are nets themselves, overstate it by 2^p - 1. The quarters tell p: they differ 2^p times as much
again. Both are pooled over neighbouring bins, since a bin's own few are too few.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RATE_REACH, REACH = 8, 2
"""Bins to either side over which the rate p, and the variance, are pooled."""


@dataclass(eq=False)
class Spread:
    """What B bins' samples say of their own noise.

    half : (C, B) squared difference of the two halves' means, over 4; of 1 sample, 0.
    quarter : (C, B) the same of the quarters in a half, mean of both halves; of less than 4 samples, 0.
    single : (C, B) the sample where there is only 1.
    """

    half: np.ndarray
    quarter: np.ndarray
    single: np.ndarray

    @classmethod
    def zeros(cls, channels: int, bins: int) -> Spread:
        return cls(*(np.zeros((channels, bins)) for _ in range(3)))

    def store(self, where: np.ndarray, other: Spread) -> None:
        """Take over another's bins, all of them, as ``where`` (B',)."""
        self.half[:, where] = other.half
        self.quarter[:, where] = other.quarter
        self.single[:, where] = other.single

    def put(self, where: np.ndarray | slice, parts: np.ndarray) -> None:
        """Means of 1, 2 or 4 equal parts of the samples, (C, B', parts), of the bins ``where``."""
        if parts.shape[2] == 1:
            self.single[:, where] = parts[:, :, 0]
            return
        if parts.shape[2] == 4:
            self.quarter[:, where] = np.square(parts[:, :, ::2] - parts[:, :, 1::2]).mean(axis=2) / 4
            parts = (parts[:, :, ::2] + parts[:, :, 1::2]) / 2
        self.half[:, where] = np.square(parts[:, :, 0] - parts[:, :, 1]) / 4


def standard_error(
    spread: Spread,
    count: np.ndarray,
    bins: tuple[int, ...],
    predicted: np.ndarray | None = None,
    chance: np.ndarray | None = None,
    independent: bool = False,
) -> np.ndarray:
    """(C, B) standard errors of means of ``count`` (B,) samples.

    predicted : (B,) deviation of a sample, known beforehand but for a factor; None for the same everywhere.
    chance : (B,) that a bin is sampled at all, its estimate being divided by it.
    independent : whether samples are independent, and p is 1.
    """
    channels, total = spread.half.shape
    shape = (channels, *bins)
    rate = np.full(spread.half.shape, 2.0)
    if not independent:
        four = (count >= 4).astype(np.float64)
        half, quarter = (_box((a * four).reshape(shape), RATE_REACH) for a in (spread.half, spread.quarter))
        with np.errstate(divide="ignore", invalid="ignore"):
            told = np.clip(np.where(half > 0, quarter / half, 2.0), 2.0, 8.0)
        rate = told.reshape(channels, total)
    variance = spread.half / (rate - 1)
    known = np.broadcast_to(count >= 2, variance.shape).copy()
    one = count == 1
    if one.any():
        alone, pairs = _neighbour_differences(spread.single.reshape(shape), one.reshape(bins))
        alone, pairs = alone.reshape(channels, total), pairs.reshape(total)
        alone = np.where(pairs > 0, alone, np.square(spread.single))
        if chance is not None:
            rare = chance < 1
            alone = np.where(rare, np.square(spread.single / chance), alone)
        variance[:, one] = alone[:, one]
        known[:, one] = True
    if chance is not None:
        known |= chance < 1  # where nothing was drawn, the neighbours' luck counts for it
    expected = np.ones(variance.shape)
    if predicted is not None:
        square = np.square(predicted)
        square = square + 1e-6 * square.mean() + 1e-300
        expected = square * np.maximum(count, 1) ** -np.log2(rate)
        if chance is not None:
            expected = expected / chance
    expected = np.where(known, expected, 0)
    found = _box(np.where(known, variance, 0).reshape(shape), REACH)
    hoped = _box(expected.reshape(shape), REACH)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = np.where(hoped > 0, found / hoped, np.inf).reshape(channels, total)
        result = np.sqrt(np.where(np.isfinite(scale), expected * scale, np.inf))
    return result


def _box(values: np.ndarray, reach: int) -> np.ndarray:
    """Sums over the bins within ``reach`` along each axis but the first, and within the picture."""
    for axis in range(1, values.ndim):
        size = values.shape[axis]
        total = np.concatenate(
            [np.zeros_like(values.take([0], axis=axis)), np.cumsum(values, axis=axis)], axis=axis
        )
        at = np.arange(size)
        high, low = np.minimum(at + reach + 1, size), np.maximum(at - reach, 0)
        # A difference of running sums may fall a rounding below zero.
        values = np.maximum(total.take(high, axis=axis) - total.take(low, axis=axis), 0)
    return values


def _neighbour_differences(values: np.ndarray, one: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over a bin's neighbours of half their squared difference, and how many neighbours there are."""
    total, count = np.zeros(values.shape), np.zeros(one.shape)
    for axis in range(one.ndim):
        if one.shape[axis] < 2:
            continue
        low = (slice(None),) * axis + (slice(None, -1),)
        high = (slice(None),) * axis + (slice(1, None),)
        both = one[low] & one[high]
        square = np.where(both, 0.5 * np.square(values[(slice(None), *low)] - values[(slice(None), *high)]), 0)
        for side in (low, high):
            total[(slice(None), *side)] += square
            count[side] += both
    return total / np.maximum(count, 1), count
