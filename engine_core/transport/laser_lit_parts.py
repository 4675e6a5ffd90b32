# SPDX-License-Identifier: GPL-3.0-or-later
"""What nodes of a control variate over the screen know of lasers in fog: no samples, but what is lit of each ray.

From Gauss-Legendre points of the beam to a segment of a camera ray, each integral is as in `ray_rule`: visibility at
nodes along the ray, edges of shadows bisected between two that differ, and a polynomial through what is smooth.
The variable is w = tan(angle / 2) about the point, as in `laser_maps`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..integration.inner_rules import InnerRule, Nodes
from ..integration.rules import gauss
from .laser_in_fog import LaserInFog, Segments, between, shortened
from .laser_maps import Passage, along_beam, at_half_angle, foot_and_gap, half_angles
from .lasers import Stretch

NEAR_END = 1e-3
"""Part of a camera ray, at both ends, that is as visible as what is next to it: a surface is no shadow."""


@dataclass(frozen=True)
class LitParts(InnerRule):
    """beam : points of each stretch of a beam. smooth : of what is smooth, on each camera ray.

    visible : where a ray is asked whether it sees the beam's point. bisections : of each edge.
    """

    beam: int = 8
    smooth: int = 8
    visible: int = 9
    bisections: int = 3

    def cost(self, dimensions: int) -> int:
        return self.beam * self.visible

    def integrate(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        integrand, rays = nodes.integrand, nodes.stage
        count, lane, which = len(nodes.lanes), nodes.lanes, None
        if rays.lane is not None:
            number = np.full(nodes.points, -1)
            number[rays.lane] = np.arange(len(rays.lane))
            lane = number.take(lane)
            which = np.flatnonzero(lane >= 0)
            lane = lane.take(which)
        rows, of = rays.segments(lane)
        of = of if which is None else which.take(of)
        segments, n = Segments.of(rays, integrand.media).take(rows), len(of)
        u, weights = gauss(self.beam)
        lanes = np.tile(np.arange(n), self.beam)
        each = segments.take(lanes)
        mean, square = np.zeros((2, 3, count))
        for stretch in integrand.stretches:
            lines = Lines(integrand, each, stretch, segments.passage(stretch).take(lanes), np.repeat(u, n))
            for total, part in zip((mean, square), lines.integrals(self), strict=True):
                part = np.tensordot(weights, part.reshape(3, self.beam, n), (0, 1))
                for row, channel in zip(total, part, strict=True):
                    row += np.bincount(of, channel, count)
        mean, square = (np.nan_to_num(a, posinf=0, neginf=0) for a in (mean, square))
        spread = np.sqrt(np.maximum(square - mean * mean, 0)).sum(axis=0)
        return mean, spread, n * self.cost(2) * len(integrand.stretches)


class Lines:
    """L lines: points v (L,) of a stretch of a beam, and passages of segments (L,)."""

    def __init__(
        self, integrand: LaserInFog, segments: Segments, stretch: Stretch, p: Passage, u: np.ndarray
    ) -> None:
        """u : (L,) of the map along the beam."""
        self._integrand, self._segments, self._stretch, self._p = integrand, segments, stretch, p
        self._v, self._dv = along_beam(p, u)
        self._foot, self._gap = foot_and_gap(p, self._v)
        self._low, self._dw = half_angles(p.start - self._foot, p.end - self._foot, self._gap)

    def _smooth(self, s: float) -> np.ndarray:
        """(3, L) the integrand at s of all lines, as if nothing blocked it."""
        x, r, weight = at_half_angle(self._low + s * self._dw, self._dw, self._gap)
        value = self._segments.unshadowed(self._stretch, self._p, self._v, x, r)
        value *= weight * self._dv
        rays = between(self._segments, self._stretch, np.arange(len(x)), self._v, self._foot + x)
        value *= np.exp(-self._integrand.depth_between(self._stretch, *rays))
        return value

    def _lit(self, rows: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(N,) bool, whether light gets to s (N,) of lines ``rows`` (N,)."""
        low, dw, gap = self._low.take(rows), self._dw.take(rows), self._gap.take(rows)
        t = self._foot.take(rows) + at_half_angle(low + s * dw, dw, gap)[0]
        rays = between(self._segments, self._stretch, rows, self._v.take(rows), t)
        seen = np.zeros(len(rows), bool)
        seen[self._integrand.arrivals(*shortened(*rays))[0]] = True
        return seen

    def integrals(self, rule: LitParts) -> tuple[np.ndarray, np.ndarray]:
        """(3, L) integrals, and about those of the integrand's square."""
        at, weights = gauss(rule.smooth)
        values = np.stack([self._smooth(s) for s in at])
        whole = np.tensordot(weights, values, 1)
        square = np.tensordot(weights, values * values, 1)
        if not self._stretch.casts_shadow:
            return whole, square
        n = values.shape[2]
        places = NEAR_END + (1 - 2 * NEAR_END) * np.linspace(0, 1, rule.visible)
        seen = self._lit(np.tile(np.arange(n), rule.visible), np.repeat(places, n)).reshape(rule.visible, n)
        whole *= seen[-1]
        square *= seen.mean(axis=0)
        cell, rows = np.nonzero(seen[1:] != seen[:-1])
        left, right, before = places[cell], places[cell + 1], seen[cell, rows]
        for _ in range(rule.bisections if rows.size else 0):
            middle = (left + right) / 2
            same = self._lit(rows, middle) == before
            left, right = np.where(same, middle, left), np.where(same, right, middle)
        part = np.einsum("qx,qcx->cx", antiderivative(rule.smooth, (left + right) / 2), values[:, :, rows])
        part *= np.where(before, 1, -1)
        for row, channel in zip(whole, part, strict=True):
            row += np.bincount(rows, channel, n)
        return whole, square


def antiderivative(points: int, s: np.ndarray) -> np.ndarray:
    """(points, X) weights of values at Gauss-Legendre points that integrate their polynomial from 0 to s (X,)."""
    at, weights = gauss(points)
    order = np.arange(points)
    series = np.polynomial.legendre.legvander(2 * at - 1, points - 1) * weights[:, None] * (2 * order + 1)
    high = np.polynomial.legendre.legvander(2 * s - 1, points)
    integrals = np.empty((len(s), points))
    integrals[:, 0] = s
    integrals[:, 1:] = (high[:, 2:] - high[:, :-2]) / (2 * (2 * order[1:] + 1))
    return series @ integrals.T
