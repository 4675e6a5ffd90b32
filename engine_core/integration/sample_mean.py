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

    def rest(self, stage: FirstStage, index: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Samples (K,) that are not 0 and their values (C', K), C' <= C, at u (D2, N).

        index : (N,) ascending rows of the stage's M lanes, None for one sample each.
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
    batch: int = 16384,
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
            total[:, part] += stage.values.reshape(len(stage.values), -1, n).sum(axis=2)
            u = points[1].points(keys[part], first * split, n * split)
            lane = stage.lane
            u = u.reshape(len(u), -1, split)
            if lane is not None:
                u = u[:, lane]
            u = u.reshape(len(u), -1)
            index = None if split == 1 else np.repeat(np.arange(u.shape[1] // split), split)
            sample, values = integrand.rest(stage, index, u)
            if split > 1:
                sample = sample // split
            if lane is not None:
                sample = lane[sample]
            full = np.zeros((len(values), (part.stop - part.start) * n), np.float32)
            if split > 1:
                for channel, value in zip(full, values, strict=True):
                    channel += np.bincount(sample, value, minlength=full.shape[1])
                full /= split
            else:
                full[:, sample] = values
            total[: len(values), part] += full.reshape(len(values), -1, n).sum(axis=2)
    return Sums(total, count)
