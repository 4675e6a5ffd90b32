# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive control variates: approximate by polynomials, integrate these exactly, sample the difference.

    I_b = H_b + E[f - h]

(thesis eq. 2.14; M. Crespo, A. Jarabo, A. Munoz et al., "Primary-Space Adaptive Control Variates using
Piecewise-Polynomial Approximations", ACM TOG 40(3), 2021). docs/method.md tells what is ours.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter

import numpy as np

from .allocation import drawn, sample_counts
from .build import NodeEvaluator, grow, root_edge
from .control_variate import ControlVariate
from .inner_rules import InnerRule, Net
from .integrand import values_at
from .monte_carlo import sampled
from .point_sets import staged_points
from .problem import Problem
from .regions import RegionTree
from .residual import ResidualSampler
from .result import Result
from .standard_error import Spread, sampled_twice, standard_error

TWICE_ONE_IN = 16
"""One bin in so many is sampled by two nets, to know the error of all: 3 % of the error."""

BEYOND_HOPE = 0.5
"""Part of a bin's variance that h may leave over: where it is more, f itself is sampled."""

PILOT = 8
"""Points, thrown away, that tell how often a bin without nodes is to be sampled."""

MOST_DIMENSIONS = 5
"""Dimensions that the polynomial covers unless told otherwise: 3^5 nodes a region."""


@dataclass(frozen=True)
class ControlVariates:
    """The default method. Unbiased, but for ``residual=False``.

    cv_dims : dimensions of the polynomial, from the bins' own to all; None for all, up to five.
    inner : how a node integrates the other dimensions; None for a net of 16 points.
    residual : False leaves H alone, all samples spent on it: biased by what the polynomials miss, which
        docs/method.md measures; for previews and for study.
    share : of the samples, spent on the polynomials.
    defensive : of the residual samples, spread evenly over the bins.
    chance : the smallest probability to sample a bin at all, where less than one sample is due.
    split : points of the rest for each point of the first stage in the residual, a power of two: for an
        expensive first stage. Regions are no shorter than a bin then.
    rough : (*bins) bool, bins that no polynomial is known to serve: no node lies inside, f itself is
        sampled there, as often as a pilot of 8 points, thrown away, says.
    max_regions, max_overlaps : limits of memory. A region takes 4 * 3^m + 17 m + 26 bytes, and each node
        that it added, at most 2 * 3^(m - 1), 8 C + 24 to 48: measured, in four dimensions 2.2 kB a region. An
        overlap of a region with a bin takes 60 bytes, in the tiles at work only; a bin 8 (7 C + 8).
    """

    cv_dims: int | None = None
    inner: InnerRule | None = None
    residual: bool = True
    share: float = 1 / 3
    defensive: float = 0.1
    chance: float = 1 / 16
    split: int = 1
    rough: np.ndarray | None = None
    max_regions: int = 1_000_000
    max_overlaps: int = 4_000_000

    def estimate(self, problem: Problem) -> Result:
        bins, ndim = problem.bins, problem.ndim
        covered = self.cv_dims or max(len(bins), min(ndim, MOST_DIMENSIONS))
        if not len(bins) <= covered <= ndim:
            raise ValueError(f"cv_dims is {self.cv_dims}, wanted {len(bins)} to {ndim}")
        if self.split < 1 or self.split & (self.split - 1):
            raise ValueError(f"split is {self.split}, wanted a power of two")
        if self.rough is not None and np.shape(self.rough) != bins:
            raise ValueError(f"rough has shape {np.shape(self.rough)}, wanted that of bins, {bins}")
        inner = None if covered == ndim else self.inner or Net(16)
        begin = perf_counter()
        evaluator = NodeEvaluator(
            problem.integrand, bins, problem.cells, covered, inner, problem.seed, problem.pool.map
        )
        total = problem.samples * float(np.prod(bins))
        budget = total * (self.share if self.residual else 1.0)
        log_edge = root_edge(bins, covered, budget / evaluator.cost)
        rough = None if self.rough is None else np.asarray(self.rough, bool)
        helps = log_edge is not None and not (rough is not None and rough.all())
        if helps:
            expected = int(budget / evaluator.cost)
            tree = RegionTree(
                bins, covered, log_edge, evaluator, self.split == 1, rough, problem.pool.map, expected
            )
            helps = grow(tree, evaluator, budget, total, self.max_regions) or not self.residual
        if not helps:
            if not self.residual:
                raise ValueError(f"{problem.samples} samples a bin are too few for a single region of nodes")
            left = problem.samples - evaluator.evaluations / float(np.prod(bins))
            result = sampled(problem, "sobol", left)
            result.statistics["nodes"] = evaluator.evaluations
            return result
        built = perf_counter()
        return self._integrate(problem, tree, log_edge, covered, total - evaluator.evaluations, begin, built)

    def _integrate(self, problem, tree, log_edge, covered, samples, begin, built) -> Result:
        bins = problem.bins
        variate = ControlVariate(tree, log_edge, self.max_overlaps, problem.pool.map)
        shape = (len(tree.store.values), *bins)
        h, error, plain = np.zeros(shape), np.zeros(bins), np.zeros(bins, bool)

        def prepare(number: int) -> None:
            tile = variate.tile(number)
            where = tuple(tile.index)
            mean, error[where], unexplained = tile.means(variate.spread)
            if self.residual:
                plain[where] = unexplained > BEYOND_HOPE
                mean[:, plain[where]] = 0
            h[(slice(None), *where)] = mean

        problem.pool.map(prepare, range(len(variate)))
        if self.rough is not None and np.any(self.rough):
            plain |= np.asarray(self.rough, bool)
            where = np.nonzero(plain & (error == 0))
            error[where] = _pilot(problem, np.stack(where))
            samples -= PILOT * len(where[0])
        integrated = perf_counter()
        residual, count = np.zeros(shape), np.zeros(bins, np.int64)
        spread = Spread.empty(shape[0], error.size)
        if self.residual:
            twice = sampled_twice(error.size, TWICE_ONE_IN, problem.seed)
            due, chance = sample_counts(
                error.ravel(),
                samples / (self.split * (1 + twice.mean())),
                self.defensive,
                self.chance,
            )
            # One sample that may be left out tells its worth by itself: none is drawn twice.
            twice &= chance >= 1
            due, chance, twice = (a.reshape(bins) for a in (due * drawn(chance, problem.seed), chance, twice))
            points = staged_points(
                "sobol", len(bins), problem.ndim - len(bins), self.split, problem.seed + 1, np.float64
            )
            longest = max(int(due.max()), 1)
            points[0].prepare(longest)
            points[1].prepare(longest * self.split)
            sampler = ResidualSampler(points, covered, self.split)
            numbers = np.arange(error.size).reshape(bins)

            def sample(number: int) -> None:
                tile = variate.tile(number)
                where = tuple(tile.index)
                mean, noise = sampler.sample(
                    problem.integrand,
                    problem.cells(tile.index),
                    problem.keys(tile.index),
                    tile,
                    tile.density(variate.spread),
                    error[where],
                    due[where],
                    chance[where],
                    twice[where],
                    plain=plain[where],
                )
                residual[(slice(None), *where)] = mean
                spread.store(numbers[where], noise)

            problem.pool.map(sample, range(len(variate)))
            known = standard_error(spread, due.ravel(), bins, error.ravel(), chance.ravel()).reshape(shape)
            count = due * (1 + twice)
        else:
            known = np.broadcast_to(error, shape).copy()
        end = perf_counter()
        return Result(
            h + residual,
            known,
            h,
            residual,
            count,
            problem.integrand.evaluations,
            problem.integrand.non_finite,
            len(tree),
            {
                "seconds building": built - begin,
                "seconds integrating": integrated - built,
                "seconds sampling": end - integrated,
                "nodes": tree.store.count,
                "splits": tree.splits,
                "sweeps": tree.sweeps,
                "tiles": len(variate),
                "plain bins": int(plain.sum()),
            },
        )


def _pilot(problem: Problem, index: np.ndarray) -> np.ndarray:
    """(B,) the deviation of f in the bins at index (K, B), half their own and half that of all of them."""
    cells, keys = problem.cells(index), problem.keys(index)
    screen = len(problem.bins)
    points = staged_points("monte_carlo", screen, problem.ndim - screen, 1, problem.seed + 2, np.float64)
    stage = problem.integrand.first(cells, points[0].points(keys, 0, PILOT))
    rest = points[1].points(keys, 0, PILOT).reshape(problem.ndim - screen, len(keys) * PILOT)
    f = values_at(problem.integrand, stage, len(keys) * PILOT, None, rest)
    variance = f.reshape(len(f), len(keys), PILOT).var(axis=2, ddof=1).sum(axis=0)
    return np.sqrt((variance + variance.mean()) / 2)
