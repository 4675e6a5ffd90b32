# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain sampling, the same number of points in every bin: pseudo-random, or a Sobol net."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from .point_sets import staged_points
from .problem import Problem
from .result import Result
from .sample_mean import sum_samples
from .standard_error import Spread, standard_error

_BINS = 1 << 14
"""Bins that a worker takes at a time."""


@dataclass(frozen=True)
class MonteCarlo:
    """The mean over independent pseudo-random points. Unbiased; the error falls as n^-1/2."""

    def estimate(self, problem: Problem) -> Result:
        return sampled(problem, "monte_carlo", problem.samples)


@dataclass(frozen=True)
class Sobol:
    """The mean over an Owen-scrambled Sobol net, shifted in each bin. Unbiased; best for powers of two."""

    def estimate(self, problem: Problem) -> Result:
        return sampled(problem, "sobol", problem.samples)


def sampled(problem: Problem, kind: str, samples: float) -> Result:
    """The mean over ``samples`` points in every bin, rounded down to a whole number, and 1 at least."""
    begin = perf_counter()
    n = max(1, int(samples))
    index = problem.all_bins()
    count = index.shape[1]
    screen = len(problem.bins)
    points = staged_points(kind, screen, problem.ndim - screen, 1, problem.seed, np.float64)
    for group in points:
        group.prepare(n)
    # Equal parts of the samples tell how far the mean may be off: `standard_error`.
    parts = 4 if n % 4 == 0 else 2 if n % 2 == 0 else 1

    def work(low: int) -> np.ndarray:
        part = index[:, low : low + _BINS]
        cells, keys = problem.cells(part), problem.keys(part)
        sums = [
            sum_samples(problem.integrand, cells, keys, points, i * n // parts, n // parts).values
            for i in range(parts)
        ]
        return np.stack(sums, axis=2) * (parts / n)

    means = np.concatenate(problem.pool.map(work, range(0, count, _BINS)), axis=1)
    spread = Spread.zeros(means.shape[0], count)
    spread.put(slice(None), means)
    value = means.mean(axis=2).reshape(-1, *problem.bins)
    counts = np.full(count, n)
    error = standard_error(spread, counts, problem.bins, independent=kind == "monte_carlo")
    return Result(
        value,
        error.reshape(value.shape),
        np.zeros_like(value),
        value.copy(),
        counts.reshape(problem.bins),
        problem.integrand.evaluations,
        problem.integrand.non_finite,
        statistics={"seconds sampling": perf_counter() - begin},
    )
