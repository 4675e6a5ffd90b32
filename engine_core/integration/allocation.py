# SPDX-License-Identifier: GPL-3.0-or-later
"""Where residual samples go: to the bins, and to the regions in a bin, where f - h is large.

Everything here follows from the control variate's own nodes and from other bins' samples, never from
the samples that it directs: so the estimate stays unbiased.
"""

from __future__ import annotations

import numpy as np

from .mapping import Map, in_order
from .standard_error import box_sums

NEIGHBOURHOODS = ((8, 0.5), (3, 4.0))
"""Bins to either side whose pilot samples tell of a bin, and how many bins' worth those further off, or the
whole picture, weigh beside them."""

PLACE = 1 / 64
"""Part of what the neighbours' samples show that is believed of a bin whatever the nodes say of it."""

STRIP = 64
"""Bins along the first dimension that are looked at together: with those around, what the cache holds."""

PART = 1 << 16
"""Bins whose samples are counted together."""

_OCTAVE, _LEAST = 64, -100
"""Steps an octave in which the scale of a budget is sought, and the binary logarithm of the least share."""

_MOST = 1e37
"""What single precision holds, with room for sums of a few."""

_GOLDEN, _PLASTIC = 0.6180339887498949, 0.7548776662466927


def learned_deviation(
    square: np.ndarray, pilot: np.ndarray, predicted: np.ndarray, map_: Map = in_order
) -> np.ndarray:
    """(*bins) float32 deviation of a sample: what the nodes predicted, as right as it was around.

    square : (*bins) f - h squared of a sample in each bin of a pilot. pilot : (*bins) bool, which those are.
    predicted : (*bins) the nodes' deviation. A bin's own sample has no say, so that it may be kept.
    map_ : runs a function over items on workers.
    """
    strips, margin = range(0, len(predicted), STRIP), NEIGHBOURHOODS[0][0]
    out = np.empty(predicted.shape, np.float32)

    def squares(low: int) -> float:
        return float(np.square(predicted[low : low + STRIP], dtype=np.float64).sum())

    least = 1e-4 * sum(map_(squares, strips)) / max(predicted.size, 1) + 1e-300

    def known(strip: slice) -> tuple[np.ndarray, np.ndarray]:
        """Of a strip, the variance that nodes predict; which are pilots, their squares, and that there."""
        variance = np.square(predicted[strip], dtype=np.float64) + least
        pilots = pilot[strip]
        return variance, np.stack([pilots, *(np.where(pilots, a, 0) for a in (square[strip], variance))])

    of_strips = map_(lambda low: [a.sum() for a in known(slice(low, low + STRIP))[1]], strips)
    pilots, all_found, all_said = np.sum(of_strips, axis=0) if of_strips else np.zeros(3)

    def learn(low: int) -> None:
        """Of a strip, which the cache holds, by what lies around it."""
        first, last = max(0, low - margin), low + STRIP + margin
        variance, values = known(slice(first, last))
        ratio, mean = all_found / max(all_said, 1e-300), all_found / max(pilots, 1)
        for reach, faith in NEIGHBOURHOODS:
            count, seen, hoped = np.maximum(box_sums(values, reach) - values, 0)
            prior = faith * np.where(count > 0, hoped / np.maximum(count, 1), variance)
            ratio = (seen + prior * ratio) / (hoped + prior)
            mean = (seen + faith * mean) / (count + faith)
        here = slice(low - first, low - first + STRIP)
        out[low : low + STRIP] = np.minimum(np.sqrt(variance * ratio + PLACE * mean), _MOST)[here]

    map_(learn, strips)
    return out


def evenly_spread(bins: tuple[int, ...], one_in: float, seed: int) -> np.ndarray:
    """(*bins) bool: one bin in so many, as a lattice of two generators of low discrepancy has it."""
    place = np.uint32(int(seed % 1009 * _GOLDEN * 2**32) % 2**32)
    for axis, n in enumerate(bins):
        step = _PLASTIC ** (axis + 1) if len(bins) > 1 else _GOLDEN
        along = np.arange(n, dtype=np.uint32) * np.uint32(step * 2**32)
        place = place + along.reshape([-1 if a == axis else 1 for a in range(len(bins))])
    return place <= np.uint32(2**32 / one_in - 1)


def black_of_chessboard(bins: tuple[int, ...]) -> np.ndarray:
    """(*bins) bool. What is decided of the black ones by samples of the white ones, and the reverse, lets all
    these samples be kept: counts that hang on a bin's own samples are biased.
    """
    return np.indices(bins).sum(axis=0) % 2 != 0


def sample_counts(
    error: np.ndarray, samples: float, defensive: float, chance: float, map_: Map = in_order
) -> tuple[np.ndarray, np.ndarray]:
    """Residual samples of B bins: powers of two (B,) int32, and the chance (B,) to take them at all.

    error : (B,) predicted deviation of a sample. samples : in all.
    defensive : share that is spread evenly. chance : the least there is, where not even one sample is due.
    map_ : runs a function over items on workers.
    """
    if samples <= 0 or not len(error):
        return np.zeros(len(error), np.int32), np.ones(len(error), np.float32)
    mean = float(error.mean(dtype=np.float64))
    step = np.empty(len(error), np.int32)
    counts, chances = np.empty(len(error), np.int32), np.empty(len(error), np.float32)
    parts = [slice(low, low + PART) for low in range(0, len(error), PART)]

    def find_steps(part: slice) -> np.ndarray:
        """How many of a part have each step."""
        log_due = np.ones(len(error[part]), np.float32)
        if mean > 0:
            scale = (1 - defensive) / mean
            # One over what is next to nothing would be too much for single precision.
            wide = np.float64 if scale > _MOST else None
            np.multiply(error[part], scale, out=log_due, casting="unsafe", dtype=wide)
            log_due += np.float32(defensive)
        np.maximum(log_due, np.float32(2.0**_LEAST), out=log_due)
        np.log2(log_due, out=log_due)
        log_due -= np.float32(_LEAST - 1)
        log_due *= _OCTAVE
        # Where errors are alike, all bins would round the same way, and the budget be spent badly.
        log_due += _dither(part.start, len(log_due)) * np.float32(0.5 * _OCTAVE)
        step[part] = np.rint(log_due, out=log_due)
        return np.bincount(step[part])

    found = map_(find_steps, parts)
    # The scale that spends the budget, found on a histogram.
    amount = np.zeros(max(map(len, found)), np.int64)
    for of_part in found:
        amount[: len(of_part)] += of_part
    taken = np.flatnonzero(amount)
    level, amount = taken / _OCTAVE + (_LEAST - 1), amount[taken]

    def spent(scale: float) -> float:
        count, chance_ = _rounded(level + scale, chance)
        return float((amount * count * chance_).sum())

    low, high = -64.0, 64.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spent(middle) <= samples else (low, middle)
    of_level = [np.zeros(taken[-1] + 1, a.dtype) for a in (counts, chances)]
    for of_all, of_taken in zip(of_level, _rounded(level + low, chance), strict=True):
        of_all[taken] = of_taken

    def look_up(part: slice) -> None:
        for of_all, out in zip(of_level, (counts, chances), strict=True):
            of_all.take(step[part], out=out[part], mode="clip")

    map_(look_up, parts)
    return counts, chances


def drawn(chance: np.ndarray, seed: int, part: int = 0) -> np.ndarray:
    """(B,) whether a bin is sampled: with its chance, and of their sum's bins to within one.

    part : number of these bins' part of all, each of which is drawn by itself.
    """
    if (chance >= 1).all():
        return np.ones(len(chance), bool)
    # In single precision, little chances would be lost in the sum of a million.
    running = np.cumsum(chance, dtype=np.float64)
    running += np.random.default_rng([seed & 0xFFFFFFFF, 7, part]).random()
    np.floor(running, out=running)
    return np.diff(running, prepend=0) > 0


def _dither(start: int, count: int) -> np.ndarray:
    """(count,) float32 in [-1/2, 1/2), from number ``start`` of a sequence of low discrepancy."""
    place = np.arange(start, start + count, dtype=np.uint32)
    place *= np.uint32(_GOLDEN * 2**32)
    place = place.astype(np.float32)
    place *= np.float32(2**-32)
    place -= np.float32(0.5)
    return place


def _rounded(log_due: np.ndarray, chance: float) -> tuple[np.ndarray, np.ndarray]:
    counts = np.left_shift(1, np.clip(np.floor(log_due + 0.5), 0, 30).astype(np.int64))
    return counts, np.where(log_due < -0.5, np.clip(np.exp2(np.minimum(log_due, 0)), chance, 1.0), 1.0)
