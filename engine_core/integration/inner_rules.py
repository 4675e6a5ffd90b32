# SPDX-License-Identifier: GPL-3.0-or-later
"""How a node of the control variate integrates the dimensions that the polynomial does not cover.

Any rule will do: an error of the rule is an error of the control variate, which the residual makes
right. What counts is that the values are smooth from node to node, and cheap.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from .integrand import FirstStage, StagedIntegrand, values_at
from .point_sets import RandomPoints, SobolPoints
from .rules import SIMPSON, gauss


class InnerRule(Protocol):
    """Integrates the rest of an integrand at many nodes; a caller's own may adapt to each.

    count : evaluations a node costs, about.
    """

    @property
    def count(self) -> int: ...

    def integrate(
        self,
        integrand: StagedIntegrand,
        stage: FirstStage,
        points: int,
        lanes: np.ndarray,
        u: np.ndarray,
        seed: int,
    ) -> tuple[np.ndarray, np.ndarray, int]:
        """For N nodes, at ``lanes`` (N,) of the stage's points and u (D', N) of the rest's first dimensions.

        Returns the integrals over the other dimensions (C, N), the standard deviation (N,) that a
        single point of them would have, and how many evaluations that took.
        """
        ...


class _FixedPoints:
    """The same kind of points at every node."""

    def points(self, dimensions: int, nodes: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """u (dimensions, 1 or nodes, Q) and weights (Q,)."""
        raise NotImplementedError

    def integrate(
        self,
        integrand: StagedIntegrand,
        stage: FirstStage,
        points: int,
        lanes: np.ndarray,
        u: np.ndarray,
        seed: int,
    ) -> tuple[np.ndarray, np.ndarray, int]:
        covered, nodes = u.shape
        inner, weights = self.points(integrand.rest_dimensions - covered, nodes, seed)
        count = len(weights)
        rest = np.empty((integrand.rest_dimensions, nodes, count))
        rest[:covered] = u[:, :, None]
        rest[covered:] = inner
        lane = np.repeat(lanes, count)
        values = values_at(integrand, stage, points, lane, rest.reshape(len(rest), -1))
        values = values.reshape(len(values), nodes, count)
        mean = values @ weights
        square = np.square(values, dtype=np.float64) @ np.abs(weights)
        spread = np.sqrt(np.maximum(square - mean * mean, 0)).sum(axis=0)
        return mean, spread, nodes * count


@dataclass(frozen=True)
class Net(_FixedPoints):
    """One randomised Sobol net for all nodes: unbiased over seeds, and as smooth as the integrand."""

    count: int = 64

    def points(self, dimensions: int, nodes: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        net = SobolPoints(range(dimensions), seed, 101)
        net.prepare(self.count)
        return net.points(np.zeros(1, np.uint32), 0, self.count), np.full(self.count, 1 / self.count)


@dataclass(frozen=True)
class MonteCarloPoints(_FixedPoints):
    """Pseudo-random points, others at every node: no common error, but noise from node to node."""

    count: int = 16

    def points(self, dimensions: int, nodes: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        keys = np.arange(nodes, dtype=np.uint32)
        return RandomPoints(dimensions, seed, 102).points(keys, 0, self.count), np.full(
            self.count, 1 / self.count
        )


@dataclass(frozen=True)
class GaussTensor(_FixedPoints):
    """Gauss-Legendre with ``order`` points in each of ``dimensions``: for smooth integrands."""

    order: int = 8
    dimensions: int = 1

    @property
    def count(self) -> int:
        return self.order**self.dimensions

    def points(self, dimensions: int, nodes: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        return _tensor(*gauss(self.order), dimensions)


@dataclass(frozen=True)
class SimpsonTensor(_FixedPoints):
    """Composite Simpson in each of ``dimensions``, ``intervals`` of three nodes."""

    intervals: int = 4
    dimensions: int = 1

    @property
    def count(self) -> int:
        return (2 * self.intervals + 1) ** self.dimensions

    def points(self, dimensions: int, nodes: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
        weights = np.zeros(2 * self.intervals + 1)
        for i in range(self.intervals):
            weights[2 * i : 2 * i + 3] += SIMPSON / self.intervals
        return _tensor(np.linspace(0, 1, len(weights)), weights, dimensions)


def _tensor(x: np.ndarray, w: np.ndarray, dimensions: int) -> tuple[np.ndarray, np.ndarray]:
    u = np.stack(np.meshgrid(*[x] * dimensions, indexing="ij")).reshape(dimensions, 1, -1)
    weights = np.ones(1)
    for _ in range(dimensions):
        weights = np.multiply.outer(weights, w).ravel()
    return u, weights
