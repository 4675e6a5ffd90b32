# SPDX-License-Identifier: GPL-3.0-or-later
"""The plain estimator: the mean of an integrand over points, for many bins at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .integrand import FirstStage, StagedIntegrand
from .point_sets import PointSet


@dataclass
class Sums:
    """Sums of an integrand's values, (C, B) float64, over ``count`` first-stage points of each bin."""

    values: np.ndarray
    count: int


def sum_samples(
    integrand: StagedIntegrand,
    bins: Any,
    keys: np.ndarray,
    points: tuple[PointSet, PointSet],
    start: int,
    count: int,
    split: int = 1,
    batch: int = 32768,
    after_first: Callable[[slice, int, FirstStage], None] | None = None,
) -> Sums:
    """Sum of samples ``start`` to ``start + count`` of every bin.

    bins : B bins, sliceable, handed to the integrand as they are. keys : (B,) uint32.
    points : the point sets of the first and of the rest dimensions.
    split : points of the rest for each of the first.
    batch : points of the rest evaluated at once, about.
    after_first : called with (bins' slice, first sample, stage) of every batch.
    """
    # Long runs of a bin's samples, since they share its shift; whole bins where they are short.
    run = min(count, max(1, batch // split))
    width = max(1, batch // (run * split))
    total = None
    for low in range(0, len(keys), width):
        part = slice(low, min(low + width, len(keys)))
        for first in range(start, start + count, run):
            n = min(run, start + count - first)
            stage = integrand.first(bins[part], points[0].points(keys[part], first, n))
            if after_first is not None:
                after_first(part, first, stage)
            bins_here = part.stop - part.start
            if stage.values is not None:
                total = _zeros(total, len(stage.values), len(keys))
                # Not reduced along the axis: einsum is several times faster for short runs.
                values = stage.values.reshape(len(stage.values), bins_here, n)
                total[:, part] += np.einsum("cbn->cb", values)
            if not integrand.rest_dimensions:
                continue
            u = points[1].points(keys[part], first * split, n * split)
            u = u.reshape(len(u), bins_here * n, split)
            lane = stage.lane
            if lane is not None:
                u = u.take(lane, axis=1)
            found, values = integrand.rest(stage, None, u)
            total = _zeros(total, len(values), len(keys))
            if found is None and lane is None:
                values = values.reshape(len(values), bins_here, n * split)
                total[: len(values), part] += np.einsum("cbn->cb", values, dtype=np.float64) / split
                continue
            row = np.arange(u.shape[1] * split) if found is None else found
            if split > 1:
                row = row // split
            if n > 1 or lane is not None:
                bin_of_row = (np.arange(bins_here * n) if lane is None else lane) // n
                row = bin_of_row.take(row)
            for channel, value in zip(total, values, strict=False):
                sums = np.bincount(row, value, minlength=bins_here)
                channel[part] += sums if split == 1 else sums / split
    return Sums(total, count)


def _zeros(total: np.ndarray | None, channels: int, bins: int) -> np.ndarray:
    return np.zeros((channels, bins)) if total is None else total
