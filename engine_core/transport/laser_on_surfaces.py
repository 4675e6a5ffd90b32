# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of a laser's beam onto the surfaces that the camera sees.

    L = integral dv  power T_beam(v) s p(cos_v) T(r) V f cos / r^2

over the beam v, r from the surface point; f its BSDF. The map along the beam is by 1/r^2 about the point. As
a staged function of primary space:

    first : (screen 2, lens 2 if it has a size) -> camera hits
    rest  : (beam 1) -> radiance reflected at those hits, of all lasers at the same point, summed
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from ..geometry.vectors import dot, inverse_length, take
from ..integration.integrand import FirstStage
from .camera_hits import CameraHits, CameraStage, Pixels
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW, _inset
from .laser_maps import LEAST_DISTANCE, at_half_angle, half_angles
from .lasers import Lasers, Stretch, halves, scattered
from .media import Media
from .shadows import Shadows


@dataclass(eq=False)
class Towards:
    """Points of a beam, as `Shadows` wants them."""

    at: np.ndarray
    to_light: np.ndarray
    at_infinity: bool = False
    is_mesh: bool = True


class Reflection:
    """What the points of camera hits reflect."""

    def __init__(self, reflectance: np.ndarray, material: np.ndarray) -> None:
        """Where all are Lambertian: reflectance (3, number of materials), and each triangle's material."""
        self._lambert = (np.asarray(reflectance) / np.pi).astype(np.float32)
        self._material = material

    def of(self, hits: CameraHits, at: np.ndarray, direction: np.ndarray, value: np.ndarray) -> None:
        """Multiply ``value`` (3, N) with BSDF and cosine of points ``at`` (N,), for light from unit
        ``direction`` (3, N) float32, and with what fog leaves on the way to the camera.
        """
        if hits.slots is None:
            value *= take(self._lambert, self._material.take(hits.points.triangle.take(at)))
            value *= np.maximum(dot(take(hits.points.normal, at), direction), 0)
            if hits.throughput is not None:
                value *= take(hits.throughput, at)
            return
        reflected = np.zeros_like(value)
        for slot in hits.slots:
            lanes, row = slot.of(at)
            part, _ = slot.lobe.evaluate(row, direction if lanes is None else take(direction, lanes))
            if slot.sampled:
                # A mirror shows no light that has no size.
                part *= ~slot.lobe.is_mirror(row)
            if lanes is None:
                reflected += part
            else:
                reflected[:, lanes] += part
        value *= reflected


class LaserOnSurfaces:
    """The integrand, over `Pixels`; shared by all threads. Its first stage is `CameraHits` without values.

    counts : so far, rays by kind and what was not finite.
    """

    rest_dimensions = 1
    staged = True

    def __init__(
        self,
        lasers: Lasers,
        stage: CameraStage,
        reflection: Reflection,
        shadows: Shadows,
        media: Media,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """check : called before every batch; may raise, to give up."""
        self.stretches = [s for s in lasers.stretches if s.laser.on_surfaces]
        self._stage, self._shadows, self._media, self._check = stage, shadows, media, check
        self.reflection = reflection
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, CROSSING, NON_FINITE), 0))
        self.screen_dimensions = stage.dimensions

    def first(self, pixels: Pixels, u: np.ndarray) -> FirstStage:
        """Hits of camera rays through points (2 or 4, B, S) of pixels' unit squares, and of the lens."""
        self._check()
        hits = self._stage.hit(pixels, _inset(u))
        self._count(CAMERA, u[0].size)
        self._count(CROSSING, hits.crossings)
        return replace(hits, values=None)

    def rest(
        self, hits: CameraHits, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Radiance (3, N) at u (1, M, S) for M hits; at u (1, N) for hits ``lane`` (N,)."""
        self._check()
        u = np.asarray(u, np.float64).reshape(-1)
        which, at = of_each(hits, lane, len(u))
        out = np.zeros((3, len(u)), np.float32)
        if len(at) == 0:
            return None, out
        u = u.take(which)
        for stretch in self.stretches:
            value, v, to_beam = Sights(hits, at, stretch).reflected(self.reflection, u)
            lit = np.flatnonzero(value.any(axis=0))
            good = np.isfinite(value[:, lit]).all(axis=0)
            if not good.all():
                self._count(NON_FINITE, int(len(lit) - good.sum()))
                lit = lit[good]
            if stretch.casts_shadow:
                arrive, part = self.arrivals(hits, at.take(lit), take(to_beam, lit))
                lit = lit.take(arrive)
                value = take(value, lit) if part is None else take(value, lit) * part
            else:
                value = take(value, lit)
            value *= np.exp(-self.depth_between(stretch, v.take(lit), take(to_beam, lit)))
            for row, channel in zip(out, value, strict=True):
                row += np.bincount(which.take(lit), channel, len(row)).astype(np.float32)
        return None, out

    def arrivals(
        self, hits: CameraHits, at: np.ndarray, to_beam: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of points ``at`` (N,) see where ``to_beam`` (3, N) leads, and what part (3, J) of its
        light gets through; None for all.
        """
        cosine = dot(take(hits.points.normal, at), to_beam) * inverse_length(to_beam)
        arrive, part, crossings = self._shadows.arriving(hits.points, Towards(at, to_beam), cosine)
        self._count(SHADOW, len(at))
        self._count(CROSSING, crossings)
        return arrive, part

    def depth_between(self, stretch: Stretch, v: np.ndarray, to_beam: np.ndarray) -> np.ndarray:
        """(C, N) optical depth between points and v (N,) of a beam's stretch, ``to_beam`` (3, N) away."""
        # From the beam, where it is known what that is in.
        beam = stretch.start[:, None] + v * stretch.direction[:, None]
        origins, directions = (np.ascontiguousarray(a.T, np.float32) for a in (beam, -to_beam))
        return self._media.optical_depth(origins, directions, 1.0, np.full(len(v), stretch.inside))

    def _count(self, kind: str, number: int) -> None:
        with self._counting:
            self.counts[kind] += number


def of_each(hits: CameraHits, lane: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points that ``count`` samples are of, at rays ``lane`` that hit (None: as many for each): which sample,
    and the point.
    """
    rays = len(hits.points) if hits.first is None else len(hits.first) - 1
    if lane is None:
        lane = np.repeat(np.arange(rays), count // max(rays, 1))
    if hits.first is None:
        return np.arange(count), lane
    start = hits.first.take(lane)
    seen = hits.first.take(lane + 1) - start
    which = np.repeat(np.arange(count), seen)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(seen) - seen, seen) + start.take(which)


class Sights:
    """A stretch of a beam as points ``at`` (L,) of camera hits see it: mapped by 1/r^2."""

    def __init__(self, hits: CameraHits, at: np.ndarray, stretch: Stretch, above: bool = False) -> None:
        """above : only what is above the points' horizon."""
        self._hits, self._at, self._stretch = hits, at, stretch
        axis = stretch.direction[:, None]
        start = stretch.start[:, None] - take(hits.points.position, at).astype(np.float64)
        self._foot = dot(start, axis)
        self._apart = start - self._foot * axis
        low, high = self._foot, self._foot + stretch.length
        if above:
            normal = take(hits.points.normal, at)
            height, slope = dot(normal, self._apart), dot(normal, axis)
            horizon = -height / np.where(slope == 0, 1, slope)
            low = np.where(slope > 0, np.clip(horizon, low, high), low)
            high = np.where(slope < 0, np.clip(horizon, low, high), high)
        far = np.maximum(np.abs(low), np.abs(high))
        self._gap = np.maximum(np.sqrt(dot(self._apart, self._apart)), LEAST_DISTANCE * far)
        self._low, self._dw = half_angles(low, high, self._gap)

    def points(
        self, rows: np.ndarray | None, s: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of sights ``rows`` (N,), None for all, at s (N,): v of the stretch, vectors (3, N) there, their
        lengths, and dv / r^2 / ds.
        """
        low, dw, gap, foot, apart = (
            a if rows is None else take(a, rows)
            for a in (self._low, self._dw, self._gap, self._foot, self._apart)
        )
        x, r, weight = at_half_angle(low + s * dw, dw, gap)
        v = np.clip(x - foot, 0, self._stretch.length)
        return v, apart + x * self._stretch.direction[:, None], r, weight

    def reflected(
        self, reflection: Reflection, s: np.ndarray | float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(3, L) the integrand at s (L,), but for what is between; v (L,) of the stretch, and vectors (3, L)
        float32 there.
        """
        stretch = self._stretch
        v, to_beam, r, weight = self.points(None, s)
        direction = to_beam / r
        value = scattered(stretch.scattering, *halves(-dot(direction, stretch.direction[:, None])))
        value *= stretch.transmittance(v) * stretch.power[:, None] * weight
        value = value.astype(np.float32)
        reflection.of(self._hits, self._at, direction.astype(np.float32), value)
        return value, v, to_beam.astype(np.float32)
