# SPDX-License-Identifier: GPL-3.0-or-later
"""How a node of the control variate integrates the dimensions that the polynomial does not cover.

Any rule will do: an error of the rule is an error of the control variate, which the residual makes
right. What counts is that the values are smooth from node to node, and cheap.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from .integrand import FirstStage, StagedIntegrand, values_at
from .point_sets import RandomPoints, SobolPoints
from .rules import SIMPSON, gauss, tensor_points, tensor_weights


@dataclass(frozen=True, eq=False)
class Nodes:
    """N nodes at which the rest of an integrand is to be integrated.

    stage : a first stage of ``points`` points. lanes : (N,) of which of them each node is.
    u : (D', N) the rest's first dimensions, which the polynomial covers. keys : (N,) uint32, a node's own.
    """

    integrand: StagedIntegrand
    stage: FirstStage
    points: int
    lanes: np.ndarray
    u: np.ndarray
    keys: np.ndarray
    seed: int

    @property
    def dimensions(self) -> int:
        """How many are left to integrate."""
        return self.integrand.rest_dimensions - len(self.u)


class InnerRule(ABC):
    """A rule for the inner dimensions; a caller's own may adapt to each node.

    batch : evaluations at once, about, that it is quick with.
    """

    batch = 1 << 14

    @abstractmethod
    def cost(self, dimensions: int) -> int:
        """Evaluations that a node takes, about."""

    @abstractmethod
    def integrate(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        """The integrals over the inner dimensions (C, N), the standard deviation (N,), summed over channels,
        that a single point of them would have, and how many evaluations that took.
        """


class FixedPoints(InnerRule):
    """As many points, with the same weights, at every node."""

    @abstractmethod
    def points(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
        """u (dimensions, 1 or N, Q) and weights (Q,)."""

    def integrate(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        inner, weights = self.points(nodes)
        covered, (count, each) = len(nodes.u), (len(nodes.keys), len(weights))
        rest = np.empty((covered + len(inner), count, each))
        rest[:covered] = nodes.u[:, :, None]
        rest[covered:] = inner
        lane = np.repeat(nodes.lanes, each)
        values = values_at(nodes.integrand, nodes.stage, nodes.points, lane, rest.reshape(len(rest), -1))
        values = values.reshape(len(values), count, each)
        mean = values @ weights
        square = np.square(values, dtype=np.float64) @ np.abs(weights)
        spread = np.sqrt(np.maximum(square - mean * mean, 0)).sum(axis=0)
        return mean, spread, count * each


@dataclass(frozen=True)
class Net(FixedPoints):
    """One randomised Sobol net for all nodes: unbiased over seeds, and as smooth as the integrand."""

    count: int = 64

    def cost(self, dimensions: int) -> int:
        return self.count

    def points(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
        net = SobolPoints(range(nodes.dimensions), nodes.seed, 101)
        net.prepare(self.count)
        return net.points(np.zeros(1, np.uint32), 0, self.count), np.full(self.count, 1 / self.count)


@dataclass(frozen=True)
class MonteCarloPoints(FixedPoints):
    """Pseudo-random points, others at every node: no common error, but noise from node to node."""

    count: int = 16

    def cost(self, dimensions: int) -> int:
        return self.count

    def points(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
        points = RandomPoints(nodes.dimensions, nodes.seed, 102).points(nodes.keys, 0, self.count)
        return points, np.full(self.count, 1 / self.count)


@dataclass(frozen=True)
class GaussTensor(FixedPoints):
    """Gauss-Legendre with ``order`` points in each inner dimension: for smooth integrands."""

    order: int = 8

    def cost(self, dimensions: int) -> int:
        return self.order**dimensions

    def points(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
        return _tensor(*gauss(self.order), nodes.dimensions)


@dataclass(frozen=True)
class SimpsonTensor(FixedPoints):
    """Composite Simpson in each inner dimension, ``intervals`` of three nodes."""

    intervals: int = 4

    def cost(self, dimensions: int) -> int:
        return (2 * self.intervals + 1) ** dimensions

    def points(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
        weights = np.zeros(2 * self.intervals + 1)
        for i in range(self.intervals):
            weights[2 * i : 2 * i + 3] += SIMPSON / self.intervals
        return _tensor(np.linspace(0, 1, len(weights)), weights, nodes.dimensions)


def _tensor(x: np.ndarray, w: np.ndarray, dimensions: int) -> tuple[np.ndarray, np.ndarray]:
    return tensor_points([x] * dimensions)[:, None], tensor_weights([w] * dimensions)
