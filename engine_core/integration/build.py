# SPDX-License-Identifier: GPL-3.0-or-later
"""Spending the control variate's part of the budget: which roots, which splits, and when to give up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from .inner_rules import InnerRule, Nodes
from .integrand import StagedIntegrand, values_at
from .mapping import Map, even_parts
from .regions import BIN, NODE_KEYS, WHOLE, RegionTree, root_edges
from .rules import face_weights, weighted
from .sobol import hash_combine

LARGEST_ROOT = 6
"""log2 of the longest root edge in bins."""

SWEEP = 0.5
"""The part of the regions, the worst, that one batch halves: no worse than a tenth of them."""

HOPELESS = ((1 / 8, 0.4), (1 / 4, 0.2))
"""After what part of the budget a polynomial is given up if so much of the variance is unexplained. White
noise shows 0.6; thin occluders show 0.3, then 0.2, and lose; what gains shows less than 0.1."""

EVERYWHERE = 0.6
"""Only if regions of this part of the volume say so too: an edge, a peak or noise in a corner may be all of
the variance, but they are left to the samples' allocation."""

FEWEST_REGIONS = 64
"""Below which nothing is given up before the budget is spent, since little is known."""

BATCH = 1 << 15
"""Evaluations at once, about. Of fewer, threads spend their time on waiting for one another; more leave the
cache."""


class NodeEvaluator:
    """Values of an integrand at nodes, on all workers.

    evaluations : so far, inner points counted.
    """

    def __init__(
        self,
        integrand: StagedIntegrand,
        bins: tuple[int, ...],
        bins_at: Callable[[np.ndarray], Any],
        dimensions: int,
        inner: InnerRule | None,
        seed: int,
        map_: Map,
        channels: int | None = None,
    ) -> None:
        """bins_at : index (K, N) -> the integrand's bins. dimensions : m, those of the tree.

        channels : how many of the integrand's are approximated, None for all.
        """
        self._integrand = integrand
        self._bins = bins
        self._bins_at = bins_at
        self._covered = dimensions
        self._inner = inner
        self._seed = seed
        self._map = map_
        self._channels = slice(channels)
        inside = integrand.rest_dimensions - (dimensions - len(bins))
        self.cost = inner.cost(inside) if inner else 1
        self.evaluations = 0

    def __call__(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Nodes at place (m, N), in lattice units: values (C, N), spread (N,) or None."""
        order = None
        if self._integrand.staged and self._covered > len(self._bins):
            # Nodes that differ in the rest alone share a first stage, if they are in one batch.
            key = np.einsum(
                "dn,d->n", place[: len(self._bins)].astype(np.uint64), NODE_KEYS[: len(self._bins)]
            )
            order = np.argsort(key, kind="stable")
        batch = self._inner.batch if self._inner else BATCH
        count = place.shape[1]
        parts = even_parts(count, max(1, batch // self.cost))

        def evaluate(part: slice) -> tuple[np.ndarray, np.ndarray | None, int]:
            return self._evaluate(place[:, part] if order is None else place.take(order[part], axis=1))

        results = self._map(evaluate, parts)
        values = np.concatenate([r[0] for r in results], axis=1)
        spread = np.concatenate([r[1] for r in results], axis=-1) if self._inner else None
        self.evaluations += sum(r[2] for r in results)
        if order is not None:
            back = np.empty_like(order)
            back[order] = np.arange(count)
            values = values.take(back, axis=-1)
            spread = None if spread is None else spread.take(back, axis=-1)
        return values, spread

    def _evaluate(self, place: np.ndarray) -> tuple[np.ndarray, np.ndarray | None, int]:
        k = len(self._bins)
        screen, lanes = place[:k], np.arange(place.shape[1])
        if self._integrand.staged and self._covered > k:
            first = np.flatnonzero(np.append(True, (np.diff(screen, axis=1) != 0).any(axis=0)))
            lanes = np.repeat(np.arange(len(first)), np.diff(np.append(first, place.shape[1])))
            screen = screen.take(first, axis=1)
        cell = np.minimum(screen >> BIN, np.array(self._bins)[:, None] - 1)
        u = np.ldexp((screen - (cell << BIN)).astype(np.float64), -BIN)
        stage = self._integrand.first(self._bins_at(cell), u[:, :, None])
        rest = np.ldexp(place[k:].astype(np.float64), -WHOLE)
        points, lane = screen.shape[1], None if len(lanes) == screen.shape[1] else lanes
        if self._inner is None:
            values = values_at(self._integrand, stage, points, lane, rest)
            return values[self._channels], None, place.shape[1]
        keys = hash_combine(*(place & 0xFFFFFFFF), *(place >> 32))
        nodes = Nodes(self._integrand, stage, points, lanes, rest, keys, self._seed)
        values, spread, cost = self._inner.integrate(nodes)
        return values[self._channels], spread, cost


def root_edge(bins: tuple[int, ...], dimensions: int, budget: float) -> int | None:
    """log2 of the roots' edge in bins: as short as a small part of ``budget`` nodes allows, or None."""

    def cost(log: int) -> float:
        return 3.0**dimensions * float(np.prod([len(root_edges(n, log)[0]) for n in bins]))

    fitting = [log for log in range(LARGEST_ROOT + 1) if cost(log) <= budget]
    if not fitting:
        return None
    cheap = [log for log in fitting if cost(log) <= budget / 64]
    return min(cheap) if cheap else min(fitting, key=lambda log: (cost(log), log))


def grow(
    tree: RegionTree,
    evaluator: NodeEvaluator,
    budget: float,
    samples: float,
    max_regions: int,
    enough: Callable[[], bool] = lambda: False,
    hopeless: Sequence[tuple[float, float]] = HOPELESS,
    everywhere: float = EVERYWHERE,
) -> bool:
    """Halve the worst regions until ``budget`` evaluations are spent; False if no polynomial helps.

    samples : residual samples to come, in all; no region is halved that would hold less than one.
    enough : asked before every batch; True ends it there. hopeless, everywhere : as `HOPELESS`, `EVERYWHERE`.
    """
    checks = list(hopeless)
    while evaluator.evaluations < budget and len(tree) < max_regions and not enough():
        left = (budget - evaluator.evaluations) / (evaluator.cost * tree.cost_of_split)
        splits = int(min(max(8, len(tree) * SWEEP), max(left, 1), max_regions - len(tree)))
        if not tree.sweep(splits, 1 / max(samples, 1)):
            break
        while checks and evaluator.evaluations > checks[0][0] * budget and len(tree) >= FEWEST_REGIONS:
            if _hopeless(tree, checks.pop(0)[1], everywhere):
                return False
    return not checks or not _hopeless(tree, checks[0][1], everywhere)


def _hopeless(tree: RegionTree, limit: float, everywhere: float) -> bool:
    left, where = unexplained(tree)
    return left > limit and where > everywhere


def unexplained(tree: RegionTree) -> tuple[float, float]:
    """The part of the integrand's variance that is left to the residual, as the nodes see it, and the part of
    the volume where more than a fifth of a region's own variance is.
    """
    regions, values = tree.leaves(), tree.store.values
    weights = face_weights(tree.dimensions)
    mean, square, where = np.zeros(len(values)), np.zeros(len(values)), 0.0
    step = max(1, (1 << 20) // len(weights))
    for low in range(0, len(regions), step):
        part = slice(low, low + step)
        # Deviations of the channels are summed, as in the nested error: grey is no worse than one channel.
        own = np.zeros(len(regions.volume[part]))
        for c, channel in enumerate(values):
            v = channel.take(regions.nodes[part]).astype(np.float64)
            first, second = weighted(v, weights), weighted(v * v, weights)
            mean[c] += regions.volume[part] @ first
            square[c] += regions.volume[part] @ second
            own += np.sqrt(np.maximum(second - first * first, 0))
        where += regions.volume[part] @ (regions.density[part] ** 2 > 0.2 * own * own)
    deviation = float(np.sqrt(np.maximum(square - mean * mean, 0)).sum())
    left = float(regions.volume @ regions.density**2)
    return (left / deviation**2 if deviation > 0 else 0.0), float(where)
