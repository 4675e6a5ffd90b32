# SPDX-License-Identifier: GPL-3.0-or-later
"""Where residual samples go: to the bins, and to the regions in a bin, where f - h is large.

Everything here follows from the control variate's own nodes, never from the samples that it directs:
so the estimate stays unbiased.
"""

from __future__ import annotations

import numpy as np

_OCTAVE = 64
"""Steps an octave in which the scale of a budget is sought."""

_GOLDEN = 0.6180339887498949


def sample_counts(
    error: np.ndarray, samples: float, defensive: float, chance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Residual samples of B bins: powers of two (B,) int64, and the chance (B,) to take them at all.

    error : (B,) predicted deviation of a sample. samples : in all.
    defensive : share that is spread evenly. chance : the least there is, where not even one sample is due.
    """
    mean = error.mean()
    due = np.full(len(error), float(defensive) if mean > 0 else 1.0)
    if mean > 0:
        due += (1 - defensive) * error / mean
    if samples <= 0 or not len(error):
        return np.zeros(len(error), np.int64), np.ones(len(error))
    # Where errors are alike, all bins would round the same way, and the budget be spent badly.
    dither = (np.arange(len(due)) * _GOLDEN) % 1.0 - 0.5
    log_due = np.log2(np.maximum(due, 1e-300)) + 0.5 * dither
    # The scale that spends the budget, found on a histogram.
    step = np.round(log_due * _OCTAVE).astype(np.int64)
    least = step.min()
    amount = np.bincount(step - least)
    level = (np.arange(len(amount)) + least) / _OCTAVE

    def spent(scale: float) -> float:
        counts, chances = _rounded(level + scale, chance)
        return float((amount * counts * chances).sum())

    low, high = -64.0, 64.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if spent(middle) <= samples else (low, middle)
    return _rounded(step / _OCTAVE + low, chance)


def _rounded(log_due: np.ndarray, chance: float) -> tuple[np.ndarray, np.ndarray]:
    counts = np.left_shift(1, np.clip(np.floor(log_due + 0.5), 0, 30).astype(np.int64))
    return counts, np.where(log_due < -0.5, np.clip(np.exp2(np.minimum(log_due, 0)), chance, 1.0), 1.0)
