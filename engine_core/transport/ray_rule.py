# SPDX-License-Identifier: GPL-3.0-or-later
"""All light that fog scatters along a camera ray, of lights without size and small ones: points, spots, suns.

Each lane of a ray is integrated by `line_integrals`. Of many lights most bring little of what a ray brings in
all: these have but a few points, whose errors even out.

A small light is a pair of points for each ray, opposite ones, and two more dimensions say which.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..geometry.vectors import dot, take
from ..integration.inner_rules import InnerRule, Nodes
from .around_light import Tamed
from .bare_lights import BARE, POINT, SPOT, SUN, BareLights
from .direct_light import CROSSING, SHADOW
from .fog_lanes import FogSegments, Lanes
from .fog_rays import FogRays
from .line_integrals import LineIntegrals, Looks, wrapped
from .single_scattering import Scattered, SingleScattering
from .soft_lanes import LANES

NODES, NODES_OF_SPOTS = 33, 17
"""Where visibility is asked for in a lane, which of spots is in their cones: what is thinner than a step may
be missed."""

CHECKS = 32
"""Of what the nodes say of a lane, in an unbiased estimate: rays that compare it with the truth."""

FEW_LIGHTS = 2
"""Of more, each has half of the nodes and checks: of what may be missed of one there is less in all."""

RAY_POINTS = 8
"""Of a ray that is not followed, but asked at a few points: other rays of its pixel differ more than that."""

ALL = 16
"""Lights up to which each has all of its rays. Of more, one that brings less than a part in so many of what a
ray brings has few."""

FEW, FEWER = 8, 2
"""Points of its lane, of a ray that is followed and of one that is asked at a few points. Their errors even
out, and most of a lane's cost is not of its rays."""

NODES_OF_MANY = 9
"""`NODES`, of more lights than these."""

POINTS, POINTS_OF_PEAKS = 10, 16
"""Of the quadrature of what is smooth, in each piece of a lane; more where a phase function has a peak."""

_PEAK = 0.6
"""Anisotropy from which on it has one."""

_BATCH = 1 << 17
"""Shadow rays at once, about."""

_LANES = 1 << 16
"""Lanes at once, about, of rays that need all of theirs."""

FEW_OF_SEVERAL = 4
"""How many times fewer checks each of so many pairs of lanes of one ray and light has."""

_GOLDEN = (5**0.5 - 1) / 2

_MIDDLE = np.full((1, 1), 0.5)
"""A place of a lane that tells how much it brings, about."""


def nodes_and_checks(lights: int) -> tuple[int, int]:
    """Of each of so many lights, along a ray."""
    fewer = 1 if lights <= FEW_LIGHTS else 2
    return (NODES - 1) // fewer + 1, CHECKS // fewer


class ScatteredAlongRay(Scattered):
    """The light of lights without size, and of small ones, that a whole camera ray brings.

    At u (D, N) it is an unbiased estimate; `along` is nearly so, and has no noise but of small lights.
    """

    rest_dimensions = 2

    def __init__(
        self,
        scattering: SingleScattering,
        lights: np.ndarray | None = None,
        check=lambda: None,
        nodes: int | None = None,
        nodes_of_spots: int = NODES_OF_SPOTS,
        tamed: Tamed | None = None,
        checks: int | None = None,
        samples_too: bool = False,
        several: bool = True,
    ) -> None:
        """lights : (L,) numbers of those meant, which cast shadows; None for all such without size.
        nodes, checks : along a ray for each of them, None for as many as so many lights have. Of a small one
            both lanes have half of these, but for the usual nodes, which are of each.

        tamed : what `along` leaves of the light next to where it comes from; None for all.
        samples_too : whether samples leave no more. several : as in `BareLights`.
        """
        super().__init__(scattering, scattering.sizeless if lights is None else lights, check)
        self._bare = BareLights.of(scattering.lights, self._lights, scattering.media)
        self._bare.several, self._bare.ahead = several, scattering.surfaces.any_transparent
        self._small = bool((self._bare.shape != BARE).any())
        if self._small:
            self.rest_dimensions += 2
        self._tamed = self._bare
        if tamed is not None:
            self._tamed = self._taming(tamed)
        if samples_too:
            self._bare = self._tamed
        # A pair of points shares most of the work.
        usual, pair = nodes_and_checks(len(self._lights)), 1 + self._small
        nodes = _fewer_nodes(nodes, pair) if nodes else usual[0]
        nodes_of_spots = _fewer_nodes(nodes_of_spots, pair)
        self._checks = max(1, (checks or usual[1]) // pair)
        if len(self._lights) > ALL:
            nodes, nodes_of_spots = (min(n, NODES_OF_MANY) for n in (nodes, nodes_of_spots))
        self._nodes = {POINT: nodes, SPOT: nodes_of_spots, SUN: nodes}
        self._few = FEW
        peaked = np.abs(scattering.media.anisotropy).max(initial=0) > _PEAK
        # To follow peaks in bodies would take two dozen ways through them for each lane.
        follow = bool(peaked) and scattering.media.bodies == 0
        self._integrals = LineIntegrals(POINTS_OF_PEAKS if peaked else POINTS, follow)
        kinds = self._bare.kind
        # To each light.
        self.nodes, self.checks = nodes * pair, self._checks * pair
        self.shadow_rays = sum(int((kinds == kind).sum()) * n for kind, n in self._nodes.items())

    def _taming(self, tamed: Tamed) -> BareLights:
        nearest, whole = (x[self._bare.number] for x in (tamed.nearest, tamed.whole))
        return replace(self._bare, nearest=nearest, whole=whole)

    def rest(
        self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        self._check()
        u = u.astype(np.float32)
        if lane is None and u.ndim == 3 and u.shape[2] > 1:
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        u = u.reshape(len(u), -1)
        if len(self._lights) <= ALL:
            values, _ = self._estimate(rays, lane, u, self._bare)
            return None, values
        lane = np.arange(u.shape[1]) if lane is None else lane
        step = max(1, _LANES // len(self._lights))
        parts = [slice(low, low + step) for low in range(0, len(lane), step)]
        values = [self._of_many(rays, lane[part], u[:, part]) for part in parts]
        return None, np.concatenate([np.zeros((3, 0)), *values], axis=1)

    def along(self, rays: FogRays, lane: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Radiance (3, N) that rays ``lane`` (N,) bring, None for all; (2, N) its likely error, and how many
        edges shadows have along the ray.
        """
        self._check()
        return self._estimate(rays, lane, None, self._tamed)

    def _estimate(
        self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray | None, lights: BareLights
    ) -> tuple[np.ndarray, np.ndarray]:
        """Radiance (3, N) of lights; without a u also (2, N) the deviation that u would give it, summed over
        channels, and how many edges shadows have.
        """
        count = len(rays) if lane is None else len(lane)
        radiance, told = np.zeros((3, count)), np.zeros((2, count))
        if count == 0:
            return radiance, told
        segments = FogSegments.of(rays, lane, self._scattering.media, self._lamp(u))
        edged = []
        for looks, lanes in self._lanes(segments, lights, rays.lit_of(lane)):
            if len(lanes) == 0:
                continue
            ray = segments.ray.take(lanes.segment)
            value, error, edges = self._integral(lanes, looks, None if u is None else u.take(ray, axis=1))
            whole = lanes.radiance(value)
            # Of several lights and rays that see none, there may be as many.
            if len(ray) == count and (ray == np.arange(count)).all():
                radiance += whole
            else:
                radiance += [np.bincount(ray, channel, count) for channel in whole]
            if error is not None:
                told[0] += np.bincount(ray, np.square(lanes.radiance(error).sum(axis=0)), count)
                edged.append((edges > 0, ray, edges, whole.sum(axis=0)))
        # A shadow of one of many lights is no outline to speak of.
        least = radiance.sum(axis=0) / ALL if len(self._lights) > ALL else np.zeros(count)
        for some, ray, edges, bright in edged:
            some &= bright >= least.take(ray)
            told[1] += np.bincount(ray[some], edges[some], count)
        told[0] = np.sqrt(told[0])
        return self._bounded(radiance), told

    def _of_many(self, rays: FogRays, lane: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Radiance (3, N) of many lights at u (2, N): of each that brings little by a few points."""
        count = len(lane)
        segments = FogSegments.of(rays, lane, self._scattering.media, self._lamp(u))
        found = self._lanes(segments, self._bare, rays.lit_of(lane), True)
        every = [(looks, lanes) for looks, lanes in found if len(lanes)]
        of = [segments.ray.take(lanes.segment) for _, lanes in every]
        bright, total = [], np.zeros(count)
        for (_, lanes), ray in zip(every, of, strict=True):
            bright.append(lanes.radiance(lanes.smooth(_MIDDLE)[:, :, 0]).sum(axis=0))
            total += np.bincount(ray, bright[-1], count)
        total /= ALL
        radiance = np.zeros((3, count))
        for (looks, lanes), ray, unshadowed in zip(every, of, bright, strict=True):
            much = unshadowed > total.take(ray)
            for by_few, rows in ((True, np.flatnonzero(~much)), (False, np.flatnonzero(much))):
                if len(rows) == 0:
                    continue
                some, own = (lanes, ray) if len(rows) == len(lanes) else (lanes.take(rows), ray.take(rows))
                at = u.take(own, axis=1)
                value = self._by_few(some, at[0]) if by_few else self._integral(some, looks, at)[0]
                radiance += [np.bincount(own, channel, count) for channel in some.radiance(value)]
        return self._bounded(radiance)

    def _lamp(self, u: np.ndarray | None) -> np.ndarray | None:
        """Those of all dimensions of u (D, N) that are on lights; None for none."""
        return u[-2:] if self._small and u is not None else None

    def _by_few(self, lanes: Lanes, u: np.ndarray) -> np.ndarray:
        """(G, C, n) integrals of `Lanes.smooth` times visibility, by a point in each part, at u (n,)."""
        # Of many lights the errors of one place in all of their lanes would add up.
        u = (u + lanes.light * np.float32(_GOLDEN)) % 1
        return self._integrals.by_points(lanes, self._seen, self._few, u)

    def _lanes(
        self,
        segments: FogSegments,
        bare: BareLights,
        lit: dict[int, np.ndarray] | None = None,
        whole: bool = False,
    ) -> Iterator[tuple[Looks, Lanes]]:
        """Lanes of all kinds of lights, in batches, and how many rays these have; of a kind at once if
        ``whole``. lit : as of `FogRays`.
        """
        for (kind, shape), make in LANES.items():
            rows = np.flatnonzero((bare.kind == kind) & (bare.shape == shape))
            step = max(1, _BATCH // (self._nodes[kind] * max(len(segments), 1)))
            step = max(len(rows), 1) if whole else step
            for low in range(0, len(rows), step):
                lights = bare.take(rows[low : low + step])
                lanes = make(segments, lights, self._scattering.media)
                if lit:
                    own, ray = np.ones(len(lanes), bool), segments.ray.take(lanes.segment)
                    for number, some in lit.items():
                        own &= (lights.number != number).take(lanes.light) | some.take(ray)
                    lanes = lanes if own.all() else lanes.take(np.flatnonzero(own))
                looks = self._nodes[kind], self._checks
                if lanes.several is None:
                    yield looks, lanes
                    continue
                for count in np.unique(lanes.several):
                    # With fewer nodes each might miss the same shadow.
                    checks = max(1, looks[1] // min(count, FEW_OF_SEVERAL))
                    yield (looks[0], checks), lanes.take(np.flatnonzero(lanes.several == count))

    def _integral(
        self, lanes: Lanes, looks: Looks, u: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None]:
        """As `LineIntegrals.integral`."""
        return self._integrals.integral(lanes, self._seen, looks, u)

    def _seen(self, lanes: Lanes, s: np.ndarray) -> np.ndarray:
        """What of lights is seen from s (..., n) or (Q, 1): see `fog_lanes.Look`."""
        shape = np.broadcast_shapes(s.shape, (len(lanes),))
        self._count(SHADOW, int(np.prod(shape)))
        return lanes.seen(s, self._look)

    def _look(
        self, origins: np.ndarray, directions: np.ndarray, reach: float, blockers: np.ndarray | int
    ) -> np.ndarray:
        """As `fog_lanes.Look`."""
        surfaces = self._scattering.surfaces
        if not surfaces.any_transparent:
            return ~surfaces.occluded(origins, directions, reach, blockers)[None]
        arrive, part, crossings = self._scattering.shadows.passing(origins, directions, reach, blockers)
        self._count(CROSSING, crossings)
        seen = np.zeros((3, len(origins)), np.float32)
        seen[:, arrive] = 1 if part is None else part
        return seen


class PointsOfRay(ScatteredAlongRay):
    """The same light by points of each ray, one in each part of a lane (`LineIntegrals.by_points`): for
    pixels that an outline crosses.

    Their rays differ by more than what is left to chance here, and these take a third of the shadow rays.
    """

    rest_dimensions = 1

    def __init__(
        self,
        scattering: SingleScattering,
        lights: np.ndarray | None = None,
        check=lambda: None,
        points: int = RAY_POINTS,
        tamed: Tamed | None = None,
    ) -> None:
        """lights : as in `ScatteredAlongRay`. points : in each lane. tamed : what samples leave of lights."""
        super().__init__(scattering, lights, check, points, points, tamed, samples_too=tamed is not None)
        self._few = FEWER

    def _integral(self, lanes: Lanes, looks: Looks, u: np.ndarray | None) -> tuple[np.ndarray, None, None]:
        at = u[0] if lanes.turn is None else wrapped(u[0] + lanes.turn)
        return self._integrals.by_points(lanes, self._seen, looks[0], at), None, None


class NextToLight(PointsOfRay):
    """What a light brings more than the same, tamed: by rays that pass next to it."""

    def __init__(
        self,
        scattering: SingleScattering,
        light: int,
        tamed: Tamed,
        check=lambda: None,
        points: int = RAY_POINTS,
    ) -> None:
        """points : of each ray."""
        super().__init__(scattering, np.array([light]), check, points)
        self._tamed = self._taming(tamed)
        self._reach = max(tamed.nearest[light], tamed.whole[light])

    def rest(self, rays, lane, u):
        self._check()
        u, split = u.astype(np.float32), u.shape[2]
        lane = np.arange(len(rays)) if lane is None else lane
        if lane.size < u[0].size:
            lane = np.repeat(lane, split)
        away = self._bare.position[:, :1] - take(rays.origin, lane)
        direction = take(rays.direction, lane)
        away -= dot(away, direction) * direction
        which = np.flatnonzero(dot(away, away) < self._reach**2)
        lane, u = lane.take(which), u.reshape(len(u), -1).take(which, axis=1)
        values, less = (self._estimate(rays, lane, u, lights)[0] for lights in (self._bare, self._tamed))
        return which, values - less


class AlongRay(InnerRule):
    """The rule of a control variate over the screen alone: a node's whole ray, without noise."""

    batch = 1 << 16  # many short calls for a ray

    def __init__(self, cost: int) -> None:
        """cost : of a node, in evaluations."""
        self._cost = cost

    def cost(self, dimensions: int) -> int:
        return self._cost

    def integrate(self, nodes: Nodes) -> tuple[np.ndarray, np.ndarray, int]:
        count = len(nodes.lanes)
        rays, lane, which = nodes.stage, nodes.lanes, None
        if rays.lane is not None:
            number = np.full(nodes.points, -1)
            number[rays.lane] = np.arange(len(rays))
            lane = number.take(lane)
            which = np.flatnonzero(lane >= 0)
            lane = lane.take(which)
        everything = len(lane) == len(rays) and (lane == np.arange(len(rays))).all()
        values, told = nodes.integrand.along(rays, None if everything else lane)
        if which is not None:
            dense, of_all = np.zeros((3, count), np.float32), np.zeros((2, count))
            dense[:, which], of_all[:, which] = values, told
            values, told = dense, of_all
        return values, told, count * self._cost


def _fewer_nodes(nodes: int, times: int) -> int:
    return max(2, (nodes - 1) // times + 1)
