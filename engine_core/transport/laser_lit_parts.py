# SPDX-License-Identifier: GPL-3.0-or-later
"""What nodes of a control variate over the screen know of lasers in fog: no samples, but what is lit.

From Gauss-Legendre points of the beam to a segment of a camera ray, and from surface points to the beam,
each integral along a line is as in `ray_rule`: visibility at nodes, edges of shadows bisected between two
that differ, and a polynomial through what is smooth. The variable is w = tan(angle / 2) about the point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..integration.inner_rules import InnerRule, Nodes
from ..integration.rules import gauss
from .laser_in_fog import LaserInFog, Segments, between, shortened
from .laser_maps import Passage, along_beam, at_half_angle, foot_and_gap, half_angles
from .laser_on_surfaces import Sights, of_each
from .lasers import Stretch

NEAR_END = 1e-3
"""Part of a camera ray, at both ends, that is as visible as what is next to it: a surface is no shadow."""


@dataclass(frozen=True)
class _Lit(InnerRule):
    """smooth : points of what is smooth, on each line. visible : where it is asked what is lit.

    bisections : of each edge.
    """

    smooth: int = 8
    visible: int = 9
    bisections: int = 3

    def integrals(
        self,
        smooth: Callable[[float], np.ndarray],
        lit: Callable[[np.ndarray, np.ndarray], np.ndarray] | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """(3, L) integrals of L lines, and about those of the integrand's square.

        smooth : at s in [0, 1] the integrand (3, L) as if nothing blocked it. lit : whether light gets to
        s (N,) of lines (N,); None: everywhere.
        """
        at, weights = gauss(self.smooth)
        values = np.stack([smooth(s) for s in at]).astype(np.float64)
        whole = np.tensordot(weights, values, 1)
        square = np.tensordot(weights, values * values, 1)
        if lit is None:
            return whole, square
        n = values.shape[2]
        places = NEAR_END + (1 - 2 * NEAR_END) * np.linspace(0, 1, self.visible)
        seen = lit(np.tile(np.arange(n), self.visible), np.repeat(places, n)).reshape(self.visible, n)
        whole *= seen[-1]
        square *= seen.mean(axis=0)
        cell, rows = np.nonzero(seen[1:] != seen[:-1])
        left, right, before = places[cell], places[cell + 1], seen[cell, rows]
        for _ in range(self.bisections if rows.size else 0):
            middle = (left + right) / 2
            same = lit(rows, middle) == before
            left, right = np.where(same, middle, left), np.where(same, right, middle)
        part = np.einsum("qx,qcx->cx", antiderivative(self.smooth, (left + right) / 2), values[:, :, rows])
        part *= np.where(before, 1, -1)
        for row, channel in zip(whole, part, strict=True):
            row += np.bincount(rows, channel, n)
        return whole, square


def _of_nodes(nodes: Nodes) -> tuple[np.ndarray, np.ndarray]:
    """Which nodes have a ray that the first stage keeps, and its number there."""
    lane, kept = nodes.lanes, nodes.stage.lane
    if kept is None:
        return np.arange(len(lane)), lane
    number = np.full(nodes.points, -1)
    number[kept] = np.arange(len(kept))
    lane = number.take(lane)
    which = np.flatnonzero(lane >= 0)
    return which, lane.take(which)


def _mean_and_spread(mean: np.ndarray, square: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean, square = (np.nan_to_num(a, posinf=0, neginf=0) for a in (mean, square))
    return mean, np.sqrt(np.maximum(square - mean * mean, 0)).sum(axis=0)


def _add(total: np.ndarray, of: np.ndarray, part: np.ndarray) -> None:
    for row, channel in zip(total, part, strict=True):
        row += np.bincount(of, channel, len(row))


@dataclass(frozen=True)
class LitParts(_Lit):
    """Of `LaserInFog`: ``beam`` points of each stretch of a beam, and a line along the ray for each."""

    beam: int = 8

    def cost(self, dimensions: int) -> int:
        return self.beam * self.visible

    def integrate(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        integrand, rays, count = nodes.integrand, nodes.stage, len(nodes.lanes)
        which, lane = _of_nodes(nodes)
        rows, of = rays.segments(lane)
        of = which.take(of)
        segments, n = Segments.of(rays, integrand.media).take(rows), len(of)
        u, weights = gauss(self.beam)
        lanes = np.tile(np.arange(n), self.beam)
        each = segments.take(lanes)
        totals = np.zeros((2, 3, count))
        for stretch in integrand.stretches:
            lines = Lines(integrand, each, stretch, segments.passage(stretch).take(lanes), np.repeat(u, n))
            lit = lines.lit if stretch.casts_shadow else None
            for total, part in zip(totals, self.integrals(lines.smooth, lit), strict=True):
                _add(total, of, np.tensordot(weights, part.reshape(3, self.beam, n), (0, 1)))
        return *_mean_and_spread(*totals), n * self.cost(2) * len(integrand.stretches)


@dataclass(frozen=True)
class LitBeams(_Lit):
    """Of `LaserOnSurfaces`: a line along each stretch of a beam, for each point."""

    visible: int = 17

    def cost(self, dimensions: int) -> int:
        return self.visible

    def integrate(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        integrand, hits, count = nodes.integrand, nodes.stage, len(nodes.lanes)
        which, lane = _of_nodes(nodes)
        of, at = of_each(hits, lane, len(lane))
        of = which.take(of)
        totals = np.zeros((2, 3, count))
        for stretch in integrand.stretches if len(of) else ():
            sights = Sights(hits, at, stretch, above=True)

            def smooth(s: float, sights: Sights = sights, stretch: Stretch = stretch) -> np.ndarray:
                value, v, to_beam = sights.reflected(integrand.reflection, s)
                return value * np.exp(-integrand.depth_between(stretch, v, to_beam))

            def lit(rows: np.ndarray, s: np.ndarray, sights: Sights = sights) -> np.ndarray:
                to_beam = sights.points(rows, s)[1].astype(np.float32)
                seen = np.zeros(len(rows), bool)
                seen[integrand.arrivals(hits, at.take(rows), to_beam)[0]] = True
                return seen

            for total, part in zip(
                totals, self.integrals(smooth, lit if stretch.casts_shadow else None), strict=True
            ):
                _add(total, of, part)
        return *_mean_and_spread(*totals), len(of) * self.cost(1) * len(integrand.stretches)


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

    def smooth(self, s: float) -> np.ndarray:
        """(3, L) the integrand at s of all lines, as if nothing blocked it."""
        x, r, weight = at_half_angle(self._low + s * self._dw, self._dw, self._gap)
        value = self._segments.unshadowed(self._stretch, self._p, self._v, x, r)
        value *= weight * self._dv
        rays = between(self._segments, self._stretch, np.arange(len(x)), self._v, self._foot + x)
        value *= np.exp(-self._integrand.depth_between(self._stretch, *rays))
        return value

    def lit(self, rows: np.ndarray, s: np.ndarray) -> np.ndarray:
        """(N,) bool, whether light gets to s (N,) of lines ``rows`` (N,)."""
        low, dw, gap = self._low.take(rows), self._dw.take(rows), self._gap.take(rows)
        t = self._foot.take(rows) + at_half_angle(low + s * dw, dw, gap)[0]
        rays = between(self._segments, self._stretch, rows, self._v.take(rows), t)
        seen = np.zeros(len(rows), bool)
        seen[self._integrand.arrivals(*shortened(*rays))[0]] = True
        return seen


def antiderivative(points: int, s: np.ndarray) -> np.ndarray:
    """(points, X) weights of values at Gauss-Legendre points: the polynomial's integral from 0 to s (X,)."""
    at, weights = gauss(points)
    order = np.arange(points)
    series = np.polynomial.legendre.legvander(2 * at - 1, points - 1) * weights[:, None] * (2 * order + 1)
    high = np.polynomial.legendre.legvander(2 * s - 1, points)
    integrals = np.empty((len(s), points))
    integrals[:, 0] = s
    integrals[:, 1:] = (high[:, 2:] - high[:, :-2]) / (2 * (2 * order[1:] + 1))
    return series @ integrals.T
