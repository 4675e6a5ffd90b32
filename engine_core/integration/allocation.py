# SPDX-License-Identifier: GPL-3.0-or-later
"""Where residual samples go: to the bins, and to the regions in a bin, where f - h is large.

Everything here follows from the control variate's own nodes, never from the samples that it directs:
so the estimate stays unbiased.
"""

from __future__ import annotations

import numpy as np

from .regions import Regions

_OCTAVE = 64
"""Steps an octave in which the scale of a budget is sought."""

_GOLDEN = 0.6180339887498949


def neighbourly(density: np.ndarray, regions: Regions, nodes: int) -> np.ndarray:
    """(R,) half of each region's own error, half the mean over its nodes of those of all who share them.

    An edge that crosses a region between its nodes is seen by its neighbours.
    """
    shared = regions.nodes.shape[1]
    total, count = np.zeros(nodes), np.zeros(nodes)
    step = max(1, (1 << 22) // shared)
    for low in range(0, len(density), step):
        part = slice(low, low + step)
        slots = regions.nodes[part].ravel().astype(np.int64)
        total += np.bincount(slots, np.repeat(density[part], shared), nodes)
        count += np.bincount(slots, minlength=nodes)
    total /= np.maximum(count, 1)
    out = np.empty(len(density))
    for low in range(0, len(density), step):
        part = slice(low, low + step)
        out[part] = total.take(regions.nodes[part]).mean(axis=1)
    return 0.5 * (density + out)


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
