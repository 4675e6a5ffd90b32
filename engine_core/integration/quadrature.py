# SPDX-License-Identifier: GPL-3.0-or-later
"""Nested adaptive quadrature: no noise along the rest dimensions, no promise of being right either.

After A. Munoz, "Higher Order Ray Marching", Computer Graphics Forum 33(8), 2014: Simpson's rule and
the trapezoidal rule on the same nodes, whose difference decides what is bisected. Here for all lanes
(a camera hit, a point of a bin) at once, with boxes instead of intervals for several dimensions.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from .integrand import FirstStage, StagedIntegrand
from .point_sets import PointSet, SobolPoints
from .result import Result
from .rules import grid_nodes, halves, nested_rules, new_nodes
from .sample_mean import Sums
from .standard_error import Spread, standard_error

if TYPE_CHECKING:
    from .problem import Problem


MOST_DIMENSIONS = 5
"""Dimensions that it integrates over: more take more points than any picture is worth."""

_BATCH = 32768  # points evaluated at once: larger ones leave the cache
_LIMIT = 1 << 21  # node values held of one set of boxes, beyond which its lanes are done in halves


@dataclass
class _Boxes:
    """N boxes of the rest dimensions' cube, each of one lane.

    lane (N,); low, size (D, N) exact binary fractions; nodes (C, 3^D, N) values;
    value (C, N), error (N,) of their integrals; worst (N,) the dimension of the largest nested error.
    """

    lane: np.ndarray
    low: np.ndarray
    size: np.ndarray
    nodes: np.ndarray
    value: np.ndarray
    error: np.ndarray
    worst: np.ndarray

    @classmethod
    def of(cls, lane: np.ndarray, low: np.ndarray, size: np.ndarray, nodes: np.ndarray) -> _Boxes:
        integrals = nested_rules(len(size)) @ nodes * size.prod(axis=0)
        value = integrals[:, 0]
        errors = np.abs(integrals[:, 1:] - integrals[:, :1]).max(axis=0)
        # Rounding is no error to bisect for: a constant would be, without end, at tolerance 0.
        errors[errors <= 1e-14 * np.abs(value).max(axis=0)] = 0
        return cls(lane, low, size, nodes, value, errors.max(axis=0), errors.argmax(axis=0))

    def __getitem__(self, keep: np.ndarray) -> _Boxes:
        return _Boxes(*(getattr(self, name)[..., keep] for name in self.__dataclass_fields__))


def _values(integrand: StagedIntegrand, stage: FirstStage, lane: np.ndarray, u: np.ndarray) -> np.ndarray:
    """(C, N) float64 values of the rest alone at u (D, N) of lanes (N,), in batches."""
    parts = []
    for start in range(0, max(1, u.shape[1]), _BATCH):
        at = lane[start : start + _BATCH]
        which, found = integrand.rest(stage, at, u[:, start : start + _BATCH])
        values = found
        if which is not None:
            values = np.stack([np.bincount(which, row, len(at)) for row in found])
        parts.append(values)
    return np.concatenate(parts, axis=1) if len(parts) > 1 else parts[0]


def _bisect(integrand: StagedIntegrand, stage: FirstStage, boxes: _Boxes, split: np.ndarray) -> _Boxes:
    """Both halves of every box, in dimension ``split`` (N,); 2 * 3^(D-1) evaluations each."""
    dimensions = len(boxes.size)
    lane, low, size, nodes = [], [], [], []
    for d in range(dimensions):
        here = np.flatnonzero(split == d)
        if not len(here):
            continue
        at = new_nodes(dimensions, d)
        count = at.shape[1]
        u = boxes.low[:, None, here] + at[:, :, None] * boxes.size[:, None, here]
        lanes = np.broadcast_to(boxes.lane[here], (count, len(here))).ravel()
        new = _values(integrand, stage, lanes, u.reshape(dimensions, -1))
        nodes += halves(boxes.nodes[..., here], new.reshape(-1, count, len(here)), dimensions, d)
        half = boxes.size[:, here]
        half[d] /= 2
        above = boxes.low[:, here]
        low.append(above.copy())
        above[d] += half[d]
        low.append(above)
        size += [half, half]
        lane += [boxes.lane[here]] * 2
    return _Boxes.of(*(np.concatenate(part, axis=-1) for part in (lane, low, size, nodes)))


def integrate_rest(
    integrand: StagedIntegrand,
    stage: FirstStage,
    lanes: int,
    tolerance: float,
    min_levels: int = 3,
    max_levels: int = 12,
    limit: int = _LIMIT,
) -> tuple[np.ndarray, np.ndarray, int]:
    """The rest's integral over its unit cube in each of the stage's lanes: values, errors, evaluations.

    A lane is done when its boxes' nested errors |Simpson - trapezoid| (the largest over dimensions and
    channels) sum to ``tolerance`` or less; until then every box with more than an equal share of the
    tolerance is bisected in its worst dimension. What a lane gets does not depend on the others.

    lanes : M of the stage. tolerance : of each integral, absolute; 0 refines all that has an error.
    min_levels : bisections of the whole cube before the errors are believed, dimensions in turn.
    max_levels : bisections of the whole cube at most; what is left then is in the errors.
    limit : node values held at once; about ``limit`` * log2(M) * 16 bytes, but one lane's 2^max_levels
        boxes of 3^D nodes at the most.

    Returns (C, M) float64, (M,) float64, and how many points were evaluated. Biased: where the error
    is not seen by the nodes (detail between them) it is not reported either.
    """
    dimensions = integrand.rest_dimensions
    if dimensions == 0:
        raise ValueError("the integrand has no rest dimensions to integrate over")
    values, errors = None, np.zeros(lanes)
    evaluations = 0
    grid = grid_nodes(dimensions)
    width = max(1, limit // (grid.shape[1] << min_levels))
    for start in range(0, max(1, lanes), width):
        lane = np.arange(start, min(start + width, lanes))
        shape = (dimensions, len(lane))
        nodes = _values(integrand, stage, np.tile(lane, grid.shape[1]), np.repeat(grid, len(lane), axis=1))
        evaluations += nodes.shape[1]
        if values is None:
            values = np.zeros((len(nodes), lanes))
        nodes = nodes.reshape(-1, grid.shape[1], len(lane))
        # Depth first over sets of lanes, breadth first in each: (first lane, end, boxes, boxes ever).
        boxes = _Boxes.of(lane, np.zeros(shape), np.ones(shape), nodes)
        waiting = [(start, start + len(lane), boxes, np.ones(len(lane), np.int64))]
        while waiting:
            first, end, boxes, count = waiting.pop()
            if boxes.nodes.size > limit and end - first > 1:
                middle = (first + end) // 2
                low = boxes.lane < middle
                waiting.append((middle, end, boxes[~low], count[middle - first :]))
                waiting.append((first, middle, boxes[low], count[: middle - first]))
                continue
            own = boxes.lane - first
            level = -np.log2(boxes.size).sum(axis=0)
            total = errors[first:end] + np.bincount(own, boxes.error, minlength=end - first)
            needed = (total > tolerance)[own] & (boxes.error * count[own] > tolerance)
            early = level < min_levels
            split = early | (needed & (level < max_levels))
            for channel, value in zip(values, boxes.value, strict=True):
                channel[first:end] += np.bincount(own, np.where(split, 0, value), minlength=end - first)
            errors[first:end] += np.bincount(own, np.where(split, 0, boxes.error), minlength=end - first)
            if split.any():
                boxes, early, own = boxes[split], early[split], own[split]
                dimension = np.where(early, boxes.size.argmax(axis=0), boxes.worst)
                evaluations += len(own) * 2 * 3 ** (dimensions - 1)
                count = count + np.bincount(own, minlength=end - first)
                waiting.append((first, end, _bisect(integrand, stage, boxes, dimension), count))
    return values, errors, evaluations


@dataclass(frozen=True)
class Quadrature:
    """A few Sobol points of the bins' dimensions in each bin, and for each adaptive quadrature of the rest.

    With no rest dimension it is the mean over the Sobol points. ``samples`` sets the number of
    points alone: how many evaluations follow is the tolerance's business.

    Biased: as measured with the defaults, by 2e-6 of the mean on smooth integrands, at most 1e-4 with a
    ridge or a shadow (root mean square over bins up to 1e-3); ten times that at a tolerance of 0.1. Detail
    that falls between the first nodes (1/16 apart in one rest dimension, 1/4 in three) is lost.

    tolerance : of one point's integral, relative to the integrand's mean magnitude.
    points : of the bins' dimensions, in each bin; 0: samples / 16, but all samples with no rest dimension.
    min_levels, max_levels : see `integrate_rest`.
    """

    tolerance: float = 1e-2
    points: int = 0
    min_levels: int = 3
    max_levels: int = 12

    def __post_init__(self) -> None:
        if not self.tolerance > 0:
            raise ValueError(f"tolerance must be positive, not {self.tolerance}")
        if self.points < 0:
            raise ValueError(f"points must be 0 (automatic) or more, not {self.points}")
        if not 0 <= self.min_levels <= self.max_levels:
            raise ValueError(
                f"min_levels {self.min_levels} and max_levels {self.max_levels} are not in order"
            )

    def estimate(self, problem: Problem) -> Result:
        """Standard errors are upper bounds rather than estimates: the points of the net count as independent,
        and the mean nested error, the trapezoidal rule's, is added. Measured, the error is a half to a
        tenth of that; of an odd number of points nothing is known."""
        integrand, bins = problem.integrand, problem.bins
        rest = integrand.rest_dimensions
        if rest > MOST_DIMENSIONS:
            raise ValueError(
                f"quadrature over {rest} dimensions takes 3^{rest} points a box; at most {MOST_DIMENSIONS} "
                "beside those of bins: use another method"
            )
        points = self.points or max(1, round(problem.samples / 16 if rest else problem.samples))
        screen = SobolPoints(range(len(bins)), problem.seed, 0)
        screen.prepare(points)
        total = math.prod(bins)

        def integrals(which: np.ndarray, count: int, tolerance: float, **levels: int) -> Any:
            """(C, B, count) values, (B, count) errors and the evaluations, for bins of these numbers."""
            index = np.stack(np.unravel_index(which, bins))
            u = screen.points(problem.keys(index), 0, count)
            stage = integrand.first(problem.cells(index), u)
            lanes = len(which) * count
            if not rest:
                values, errors, evaluations = stage.values, np.zeros(lanes), lanes
            else:
                lane = slice(None) if stage.lane is None else stage.lane
                hits = lanes if stage.lane is None else len(stage.lane)
                inner, error, evaluations = integrate_rest(integrand, stage, hits, tolerance, **levels)
                values = np.zeros((len(inner) if stage.values is None else len(stage.values), lanes))
                errors = np.zeros(lanes)
                if stage.values is not None:
                    values += stage.values
                values[: len(inner), lane] += inner
                errors[lane] = error
            return values.reshape(-1, len(which), count), errors.reshape(len(which), count), evaluations

        width = max(1, _BATCH // points)
        parts = 2 if points % 2 == 0 else 1
        tolerance, pilot = math.inf, 0
        # Some bins tell the mean magnitude, unless all of them are dark: then every bin is asked.
        for some in (min(total, max(64, min(total // 16, 4096))), total) if rest else ():
            asked = np.arange(0, total, -(-total // some))

            def magnitude(start: int, asked: np.ndarray = asked) -> tuple[float, int]:
                which = asked[start : start + _BATCH]
                values, _, cost = integrals(which, 1, math.inf, min_levels=self.min_levels)
                return float(np.abs(values).max(axis=0).sum()), cost

            sums, costs = zip(*problem.pool.map(magnitude, range(0, len(asked), _BATCH)), strict=True)
            pilot += sum(costs)
            tolerance = self.tolerance * sum(sums) / len(asked)
            if tolerance > 0:
                break

        def part(start: int) -> tuple[np.ndarray, np.ndarray, int]:
            which = np.arange(start, min(start + width, total))
            values, errors, evaluations = integrals(
                which, points, tolerance, min_levels=self.min_levels, max_levels=self.max_levels
            )
            # Means of equal parts of the points tell how far theirs may be off.
            means = values.reshape(*values.shape[:2], parts, -1).mean(axis=3)
            return means, errors.mean(axis=1), evaluations

        means, nested, counts = zip(*problem.pool.map(part, range(0, total, width)), strict=True)
        means = np.concatenate(means, axis=1)
        value = means.mean(axis=2).reshape(-1, *bins)
        error = np.full(means.shape[:2], np.inf)
        if parts == 2:
            spread = Spread.empty(len(means), total)
            spread.half[:] = (means[:, :, 0] - means[:, :, 1]) / 2
            error = standard_error(spread, np.full(total, points), bins, independent=True)
        return Result(
            value=value,
            standard_error=np.hypot(error, np.concatenate(nested)).reshape(value.shape),
            control_variate=np.zeros_like(value),
            residual=value.copy(),
            sample_count=np.full(bins, points, np.int64),
            evaluations=pilot + sum(counts),
            non_finite=integrand.non_finite,
        )


def sum_quadrature(
    integrand: StagedIntegrand,
    bins: Any,
    keys: np.ndarray,
    points: PointSet,
    start: int,
    count: int,
    tolerance: float,
    after_first: Callable[[slice, int, FirstStage], None] | None = None,
) -> Sums:
    """As `sum_samples`, with the rest integrated by nested quadrature at every point of the first stage.

    tolerance : of each integral, absolute.
    """
    total = None
    step = max(1, _BATCH // (27 * count))
    for low in range(0, len(keys), step):
        part = slice(low, min(low + step, len(keys)))
        width = part.stop - part.start
        stage = integrand.first(bins[part], points.points(keys[part], start, count))
        if after_first is not None:
            after_first(part, start, stage)
        lane = np.arange(width * count) if stage.lane is None else stage.lane
        if len(lane):
            values = integrate_rest(integrand, stage, len(lane), tolerance)[0]
        else:  # how many channels there are is told all the same
            values = integrand.rest(stage, lane, np.zeros((integrand.rest_dimensions, 0)))[1]
        if total is None:
            total = np.zeros((len(values) if stage.values is None else len(stage.values), len(keys)))
        if stage.values is not None:
            total[:, part] += stage.values.reshape(-1, width, count).sum(axis=2)
        for channel, value in zip(total, values, strict=False):
            channel[part] += np.bincount(lane // count, value, width)
    return Sums(total, count)
