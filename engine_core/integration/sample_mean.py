# SPDX-License-Identifier: GPL-3.0-or-later
"""The plain estimator: the mean of an integrand over points, for many bins at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .point_sets import PointSet


class FirstStage(Protocol):
    """What an integrand keeps of its first dimensions.

    values : (C, B * S) what needs no further dimension.
    lane : (M,) ascending, the points that the rest has to be evaluated at; None for all.
    """

    values: np.ndarray
    lane: np.ndarray | None


class StagedIntegrand(Protocol):
    """A function on the unit cube, split where an expensive first part serves many points of the rest."""

    def first(self, bins: Any, u: np.ndarray) -> FirstStage:
        """u : (D1, B, S) points of B bins."""
        ...

    def rest(self, stage: FirstStage, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values at u (D2, M, split), already divided by split, where they are not 0.

        Returns (K,) rows of the stage's M lanes, in any order and repeated, and (C', K), C' <= C.
        """
        ...


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
            if total is None:
                total = np.zeros((len(stage.values), len(keys)))
            bins_here = part.stop - part.start
            # Not reduced along the axis: einsum is several times faster for short runs.
            values = stage.values.reshape(len(stage.values), bins_here, n)
            total[:, part] += np.einsum("cbn->cb", values)
            u = points[1].points(keys[part], first * split, n * split)
            u = u.reshape(len(u), bins_here * n, split)
            lane = stage.lane
            if lane is not None:
                u = u.take(lane, axis=1)
            row, values = integrand.rest(stage, u)
            if n > 1 or lane is not None:
                bin_of_row = (np.arange(bins_here * n) if lane is None else lane) // n
                row = bin_of_row.take(row)
            for channel, value in zip(total, values, strict=False):
                channel[part] += np.bincount(row, value, minlength=bins_here)
    return Sums(total, count)
