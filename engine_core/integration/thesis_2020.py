# SPDX-License-Identifier: GPL-3.0-or-later
"""Adaptive multidimensional control variates as in the thesis that began this, to compare with.

F. Bernal Sierra, "Rendering de iluminacion directa y single-scattering utilizando control variates
multidimensionales", Universidad de Zaragoza, 2020: the unit cube is halved region by region from a heap
until a sixteenth of the samples is spent; all others are pseudo-random, evenly over the bins, and each
bin weighs the control variate by an alpha of its own. Judged by its error per evaluation, not by time.
"""

from __future__ import annotations

import heapq
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .integrand import GridCells, StagedIntegrand, values_at
from .point_sets import RandomPoints
from .result import Result
from .rules import SIMPSON, grid_nodes, halves, lagrange, nested_rules, new_nodes

if TYPE_CHECKING:
    from .problem import Problem

MAX_LEVELS = 40
"""Halvings of one dimension at most; edges stay exact integers far beyond."""

_BATCH = 32768  # points, and overlaps of regions and bins, handled at once


def cells_at(problem: Problem, u: np.ndarray) -> tuple[GridCells, np.ndarray]:
    """The bins that u (D, N) in the unit cube lies in, and u with its bins' dimensions inside those."""
    shape = np.array(problem.bins)[:, None]
    inside = np.array(u, np.float64)
    scaled = inside[: len(shape)] * shape
    index = np.minimum(scaled.astype(np.int64), shape - 1)
    inside[: len(shape)] = scaled - index
    return problem.cells(index), inside


def _values(integrand: StagedIntegrand, bins: GridCells, u: np.ndarray) -> np.ndarray:
    """(C, B * S) float64 values of the integrand at u (D, B, S), inside B bins along their dimensions."""
    screen = len(u) - integrand.rest_dimensions
    count = u[0].size
    stage = integrand.first(bins, u[:screen])
    values = values_at(integrand, stage, count, None, u[screen:].reshape(len(u) - screen, count))
    return values.astype(np.float64, copy=False)


class _Trees:
    """T binary trees of regions over the unit cube, each with a heap of its leaves.

    Leaves sit in slots: level, index (D, slots) int64 with edges index / 2^level and (index + 1) / 2^level,
    nodes (slots, C, 3^D), integral (slots, C). Tree t begins as slot t and as node t of the trees:
    axis (-1 for a leaf), child (the lower one, the upper one comes next) and slot of each node.
    """

    def __init__(self, trees: int, dimensions: int, nodes: np.ndarray, size: int, epsilon: float) -> None:
        """nodes (T, C, 3^D) of the roots. size : leaves at most. epsilon : of eq. 4.8, for brightness 1."""
        self.dimensions, self.trees, self.epsilon = dimensions, trees, epsilon
        self._rules = nested_rules(dimensions)
        self.level = np.zeros((dimensions, size), np.int64)
        self.index = np.zeros((dimensions, size), np.int64)
        self.nodes = np.empty((size, *nodes.shape[1:]))
        self.integral = np.empty((size, nodes.shape[1]))
        self.tree = np.arange(size)
        self._node = np.arange(size)
        self._nested = np.empty((dimensions, size))
        self._worst = np.zeros(size, np.int64)
        self.axis = np.full(2 * size, -1, np.int64)
        self.child = np.zeros(2 * size, np.int64)
        self.slot = np.arange(2 * size)
        self.count = trees
        self._nodes_used = trees
        self.nodes[:trees] = nodes
        self._integrate(np.arange(trees))
        self._rebuild()

    def _integrate(self, slots: np.ndarray) -> None:
        volume = np.ldexp(1.0, -self.level[:, slots].sum(axis=0))
        integrals = self.nodes[slots] @ self._rules.T * volume[:, None, None]
        self.integral[slots] = integrals[..., 0]
        self._nested[:, slots] = np.abs(integrals[..., 1:] - integrals[..., :1]).max(axis=1).T

    def _error(self, slots: np.ndarray) -> np.ndarray:
        """(N,) errors of regions (eq. 4.8), the largest of their dimensions; -1 where none can be halved."""
        level = self.level[:, slots]
        size_term = np.ldexp(self.epsilon, -level) * self._brightness[self.tree[slots]]
        errors = np.where(level < MAX_LEVELS, self._nested[:, slots] + size_term, -1)
        largest = errors.max(axis=0)
        # Where all are equal (nothing seen yet), the longest edge: not slivers.
        self._worst[slots] = np.where(errors == largest, level, MAX_LEVELS + 1).argmin(axis=0)
        return largest

    def _entries(self, slots: np.ndarray) -> list[tuple[float, int, int]]:
        """Heap entries: of equal errors the largest region comes first, or nothing would be left to see."""
        depth = self.level[:, slots].sum(axis=0)
        return list(zip((-self._error(slots)).tolist(), depth.tolist(), slots.tolist(), strict=True))

    def _rebuild(self) -> None:
        """Heaps anew, with the mean brightness as all regions so far show it."""
        slots = np.arange(self.count)
        size = np.ldexp(1.0, -self.level[:, : self.count].sum(axis=0))
        magnitude = (np.abs(self.nodes[: self.count]) @ self._rules[0]).max(axis=1) * size
        self._brightness = np.bincount(self.tree[: self.count], magnitude, minlength=self.trees)
        self._heaps: list[list] = [[] for _ in range(self.trees)]
        for entry, tree in zip(self._entries(slots), self.tree[: self.count].tolist(), strict=True):
            self._heaps[tree].append(entry)
        for heap in self._heaps:
            heapq.heapify(heap)
        self._next_rebuild = 2 * self.count

    def worst(self) -> np.ndarray:
        """The slot of each tree's worst region, off the heap; only trees with one that can be halved."""
        if self.count >= self._next_rebuild:
            self._rebuild()
        slots = [heapq.heappop(heap)[2] for heap in self._heaps if heap and heap[0][0] <= 0]
        return np.array(slots, np.int64)

    def new_nodes(self, slots: np.ndarray) -> list[tuple[np.ndarray, int, np.ndarray]]:
        """For each dimension that regions are halved in: those (N,), it, and u (D, M, N) to evaluate."""
        out = []
        for d in range(self.dimensions):
            here = slots[self._worst[slots] == d]
            if len(here):
                at = new_nodes(self.dimensions, d)[:, :, None] + self.index[:, None, here]
                out.append((here, d, np.ldexp(at, -self.level[:, None, here])))
        return out

    def halve(self, slots: np.ndarray, d: int, new: np.ndarray) -> None:
        """Halve regions in dimension d with the values (C, M, N) at their new nodes."""
        upper = np.arange(self.count, self.count + len(slots))
        self.count += len(slots)
        parent = np.moveaxis(self.nodes[slots], 0, -1)
        low, high = halves(parent, new, self.dimensions, d)
        self.nodes[slots], self.nodes[upper] = np.moveaxis(low, -1, 0), np.moveaxis(high, -1, 0)
        self.level[d, slots] += 1
        self.index[d, slots] *= 2
        self.level[:, upper], self.index[:, upper] = self.level[:, slots], self.index[:, slots]
        self.index[d, upper] += 1
        self.tree[upper] = self.tree[slots]
        child = self._nodes_used + 2 * np.arange(len(slots))
        self._nodes_used += 2 * len(slots)
        self.axis[self._node[slots]], self.child[self._node[slots]] = d, child
        self._node[slots], self._node[upper] = child, child + 1
        self.slot[child], self.slot[child + 1] = slots, upper
        both = np.concatenate([slots, upper])
        self._integrate(both)
        for entry in self._entries(both):
            heapq.heappush(self._heaps[self.tree[entry[2]]], entry)

    def evaluate(self, tree: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(C, N) the control variate h at u (D, N) of trees (N,)."""
        # Each step down doubles one coordinate, exactly: at the leaf they are the region's own.
        node, at = tree.copy(), np.array(u, np.float64)
        active = np.flatnonzero(self.axis[node] >= 0)
        while len(active):
            here = node[active]
            axis = self.axis[here]
            twice = 2 * at[axis, active]
            upper = twice >= 1
            at[axis, active] = twice - upper
            node[active] = here = self.child[here] + upper
            active = active[self.axis[here] >= 0]
        h = self.nodes[self.slot[node]]
        for d in range(self.dimensions):
            h = h.reshape(len(h), h.shape[1], 3, -1)
            h = np.einsum("kn,nckr->ncr", lagrange(at[d]), h)
        return h[:, :, 0].T


def _integrals_over_bins(trees: _Trees, bins: tuple[int, ...]) -> np.ndarray:
    """(C, B) means of the one tree's polynomials over each bin, exact over every region-bin overlap."""
    regions, screen = trees.count, len(bins)
    level, index = trees.level[:screen, :regions], trees.index[:screen, :regions]
    counts = np.array(bins)[:, None]
    # A region reaches from bin floor(index * bins / 2^level) on: integers, so that no sliver is lost.
    first = (index * counts) >> level
    reach = -((-(index + 1) * counts) >> level) - first
    # The dimensions that no bin cuts, integrated at once: (R, C, 3^K).
    inner = nested_rules(trees.dimensions - screen)[0]
    nodes = trees.nodes[:regions].reshape(regions, -1, 3**screen, len(inner)) @ inner
    nodes *= np.ldexp(1.0, -trees.level[screen:, :regions].sum(axis=0))[:, None, None]
    overlaps = reach.prod(axis=0)
    ends = np.cumsum(overlaps)
    total = math.prod(bins)
    out = np.zeros((nodes.shape[1], total))
    step = max(_BATCH, total // 16)  # Each step walks over all bins once.
    for start in range(0, int(ends[-1]), step):
        pair = np.arange(start, min(start + step, int(ends[-1])))
        region = np.searchsorted(ends, pair, side="right")
        within = pair - (ends - overlaps)[region]
        flat, stride = np.zeros(len(pair), np.int64), total
        value = nodes[region]
        position = np.empty((screen, len(pair)), np.int64)
        for k in reversed(range(screen)):
            position[k] = first[k, region] + within % reach[k, region]
            within = within // reach[k, region]
        for k, count in enumerate(bins):
            stride //= count
            flat += position[k] * stride
            # The overlap in the region's own coordinates, from exact differences of integers.
            size = np.left_shift(1, level[k, region])
            shifted = position[k] * size - index[k, region] * count
            low = np.maximum(shifted, 0) / count
            high = np.minimum(shifted + size, count) / count
            quadratics = lagrange(np.stack([low, (low + high) / 2, high]))
            weights = np.einsum("e,ken->kn", SIMPSON, quadratics) * ((high - low) * count / size)
            value = np.einsum("kn,nckr->ncr", weights, value.reshape(len(pair), len(out), 3, -1))
        for channel, row in zip(out, value[:, :, 0].T, strict=True):
            channel += np.bincount(flat, row, minlength=total)
    return out


@dataclass(frozen=True)
class Thesis2020:
    """Control variates as in the thesis: a tensor of Simpson's rule over all dimensions, bisection by the
    nested error to the trapezoidal rule (eq. 4.8), an even pseudo-random residual, alpha by eq. 2.15.

    Biased, since alpha comes from the samples that it is applied to. Measured at 4 / 8 / 16 / 64 samples, as
    a fraction of the mean: a narrow ridge -31 / -6 / -0.4 / -0.001 %, a disk -0.9 / -0.4 / -0.14 / 0 %,
    occluded fog -3 / -0.3 / -0.13 / 0 %, a soft shadow 0.1 % and less; bin by bin (root mean square) the
    fog has 21 / 4 / 0.8 / 0.07 %. With two samples alpha is the slope between two points: where f jumps
    its variance is infinite. With one sample, or where h is constant in a bin, alpha is 1.

    Memory: about 8 (C 3^D + 6 D) bytes for each of share * samples * bins / (2 * 3^(D-1)) regions.

    per_bin : a control variate for each bin alone, instead of one that all bins share.
    share : of all samples, spent on the control variate; none is made if that is less than 3^D, and every
        bin gets at least one sample besides.
    epsilon : of eq. 4.8's size term (b_d - a_d) epsilon, for an integrand of mean magnitude 1.
    """

    per_bin: bool = False
    share: float = 1 / 16
    epsilon: float = 1e-5

    def __post_init__(self) -> None:
        if not 0 <= self.share < 1:
            raise ValueError(f"share must be in [0, 1), not {self.share}")
        if not self.epsilon >= 0:
            raise ValueError(f"epsilon must not be negative, but is {self.epsilon}")

    def estimate(self, problem: Problem) -> Result:
        """Standard errors: of each bin's own samples alone, as those of a regression line at H; inf for one
        sample or two. Too low by up to 2.3 where a bin's samples miss what h misses (a ridge, 16 samples)."""
        total = math.prod(problem.bins)
        budget = problem.samples * total
        trees, spent = self._build(problem, self.share * budget)
        if trees is None:
            approximation = None
        elif self.per_bin:
            approximation = np.stack(
                [
                    np.bincount(trees.tree[: trees.count], row, minlength=total)
                    for row in trees.integral[: trees.count].T
                ]
            )
        else:
            approximation = _integrals_over_bins(trees, problem.bins)
        left = max(total, int(budget - spent))
        # Evenly spread: bins get floor or ceil of the mean, those with one more evenly between the others.
        count = np.diff(np.arange(total + 1) * left // total)
        parts = []
        for n in np.unique(count).tolist():
            here = np.flatnonzero(count == n)
            width = max(1, _BATCH // n)
            parts += [(here[start : start + width], n) for start in range(0, len(here), width)]

        def part(item: tuple[np.ndarray, int]) -> tuple[np.ndarray, np.ndarray]:
            return self._residual(problem, trees, approximation, *item)

        found = problem.pool.map(part, parts)
        order = np.concatenate([which for which, _ in parts])
        value, variance = (np.empty((len(found[0][0]), total)) for _ in range(2))
        value[:, order] = np.concatenate([v for v, _ in found], axis=1)
        variance[:, order] = np.concatenate([v for _, v in found], axis=1)
        if approximation is None:
            approximation = np.zeros_like(value)
        shape = (len(value), *problem.bins)
        return Result(
            value=value.reshape(shape),
            standard_error=np.sqrt(variance).reshape(shape),
            control_variate=approximation.reshape(shape),
            residual=(value - approximation).reshape(shape),
            sample_count=count.reshape(problem.bins),
            evaluations=spent + left,
            non_finite=problem.integrand.non_finite,
            regions=0 if trees is None else trees.count,
        )

    def _build(self, problem: Problem, budget: float) -> tuple[_Trees | None, int]:
        """The control variate for so many evaluations, and how many it took; None if they do not suffice."""
        dimensions, bins = problem.ndim, problem.bins
        count = math.prod(bins) if self.per_bin else 1
        root, cost = 3**dimensions, 2 * 3 ** (dimensions - 1)
        splits = math.floor((budget / count - root) / cost)
        if splits < 0:
            return None, 0

        def evaluated(tree: np.ndarray, u: np.ndarray) -> np.ndarray:
            """(C, M, N) values at u (D, M, N), N points' tree."""
            flat = u.reshape(dimensions, -1)
            trees = np.broadcast_to(tree, u.shape[1:]).ravel()
            parts = []
            for start in range(0, flat.shape[1], _BATCH):
                at = flat[:, start : start + _BATCH]
                if self.per_bin:
                    cells = problem.cells(np.stack(np.unravel_index(trees[start : start + _BATCH], bins)))
                else:
                    cells, at = cells_at(problem, at)
                parts.append(_values(problem.integrand, cells, at[:, :, None]))
            return np.concatenate(parts, axis=1).reshape(-1, *u.shape[1:])

        every = np.arange(count)
        nodes = evaluated(every, np.repeat(grid_nodes(dimensions)[:, :, None], count, axis=2))
        trees = _Trees(count, dimensions, nodes.transpose(2, 0, 1), count * (splits + 1), self.epsilon)
        # One region at a time of every tree.
        for _ in range(splits):
            worst = trees.worst()
            for slots, d, u in trees.new_nodes(worst):
                trees.halve(slots, d, evaluated(trees.tree[slots], u))
        return trees, count * root + (trees.count - count) * cost

    def _residual(
        self,
        problem: Problem,
        trees: _Trees | None,
        approximation: np.ndarray | None,
        which: np.ndarray,
        count: int,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Estimates and their variances, (C, B) each, of the bins of these numbers from ``count`` samples."""
        index = np.stack(np.unravel_index(which, problem.bins))
        cells, keys = problem.cells(index), problem.keys(index)
        points = RandomPoints(problem.ndim, problem.seed, 0)
        f, h = [], []
        width = max(1, _BATCH // len(which))
        for start in range(0, count, width):
            u = points.points(keys, start, min(width, count - start)).astype(np.float64)
            f.append(_values(problem.integrand, cells, u).reshape(-1, *u.shape[1:]))
            if trees is None:
                continue
            if self.per_bin:
                tree, at = np.repeat(which, u.shape[2]), u
            else:
                tree, at = np.zeros(u[0].size, np.int64), u.copy()
                for k, bins in enumerate(problem.bins):  # As the integrand does it, to the last bit.
                    at[k] = (u[k] + index[k][:, None]) / bins
            h.append(trees.evaluate(tree, at.reshape(len(at), -1)).reshape(-1, *u.shape[1:]))
        f = np.concatenate(f, axis=2)
        if trees is None:
            variance = f.var(axis=2) / (count - 1) if count > 1 else np.full(f.shape[:2], np.inf)
            return f.mean(axis=2), variance
        h = np.concatenate(h, axis=2)
        f_mean, h_mean = f.mean(axis=2), h.mean(axis=2)
        f -= f_mean[:, :, None]
        h -= h_mean[:, :, None]
        spread = (h * h).mean(axis=2)
        # Nothing but rounding in h says nothing about alpha.
        usable = spread > (1e-14 * np.abs(h_mean)) ** 2
        alpha = np.where(usable, (f * h).mean(axis=2) / np.where(usable, spread, 1), 1)
        value = alpha * approximation[:, which] + (f_mean - alpha * h_mean)
        left = f - alpha[:, :, None] * h
        variance = np.full(value.shape, np.inf)
        if count > 2:
            # Of a regression line at H: its slope, alpha, is uncertain too.
            lever = (approximation[:, which] - h_mean) ** 2 / np.where(usable, spread, np.inf)
            variance = (left * left).mean(axis=2) * (1 + lever) / (count - 2)
        return value, variance
