# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of a laser's beam onto the surfaces that the camera sees.

    L = integral dv  power T_beam(v) s p(cos_v) T(r) V f cos / r^2

over the beam v, r from the surface point; f its BSDF. The map along the beam is by 1/r^2 about the point. As a
staged function of primary space:

    first : (screen 2, lens 2 if it has a size) -> camera hits
    rest  : (beam 1) -> radiance reflected at those hits, of all lasers at the same point, summed
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from ..geometry.vectors import dot, take
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
        """reflectance : (3, number of materials), ``material`` : of each triangle, where all are Lambertian."""
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
        self._reflection = reflection
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, CROSSING, NON_FINITE), 0))
        self.screen_dimensions = stage.dimensions

    def first(self, pixels: Pixels, u: np.ndarray) -> FirstStage:
        """Hits of camera rays through points (2 or 4, B, S) of pixels' unit squares, and of the lens."""
        self._check()
        hits = self._stage.hit(pixels, _inset(u))
        with self._counting:
            self.counts[CAMERA] += u[0].size
            self.counts[CROSSING] += hits.crossings
        return replace(hits, values=None)

    def rest(
        self, hits: CameraHits, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Radiance (3, N) at u (1, M, S) for M hits; at u (1, N) for hits ``lane`` (N,)."""
        self._check()
        u = np.asarray(u, np.float64).reshape(-1)
        which, at = _of_each(hits, lane, len(u))
        points = hits.points
        out = np.zeros((3, len(u)), np.float32)
        if len(points) == 0:
            return None, out
        position = take(points.position, at).astype(np.float64)
        u = u.take(which)
        for stretch in self.stretches:
            v, to_beam, r, weight = toward(stretch, position, u)
            direction = to_beam / r
            value = scattered(stretch.scattering, *halves(-dot(direction, stretch.direction[:, None])))
            value *= stretch.transmittance(v) * stretch.power[:, None] * weight
            value = value.astype(np.float32)
            unit = direction.astype(np.float32)
            self._reflection.of(hits, at, unit, value)
            lit = np.flatnonzero(value.any(axis=0))
            good = np.isfinite(value[:, lit]).all(axis=0)
            if not good.all():
                with self._counting:
                    self.counts[NON_FINITE] += int(len(lit) - good.sum())
                lit = lit[good]
            where, vector = at.take(lit), take(to_beam, lit).astype(np.float32)
            value = take(value, lit)
            if stretch.casts_shadow:
                cosine = dot(take(points.normal, where), take(unit, lit))
                arrive, part, crossings = self._shadows.arriving(points, Towards(where, vector), cosine)
                with self._counting:
                    self.counts[SHADOW] += len(where)
                    self.counts[CROSSING] += crossings
                lit, vector, value = lit.take(arrive), take(vector, arrive), take(value, arrive)
                if part is not None:
                    value *= part
            # From the beam, where it is known what that is in.
            beam = (stretch.start[:, None] + v.take(lit) * stretch.direction[:, None]).astype(np.float32)
            inside = np.full(len(lit), stretch.inside)
            depth = self._media.optical_depth(beam.T.copy(), -vector.T, 1.0, inside)
            value *= np.exp(-depth)
            for row, channel in zip(out, value, strict=True):
                row += np.bincount(which.take(lit), channel, len(row)).astype(np.float32)
        return None, out


def _of_each(hits: CameraHits, lane: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points that ``count`` samples, at rays ``lane`` (None: as many for each that hit), are of: which sample,
    and the point."""
    rays = len(hits.points) if hits.first is None else len(hits.first) - 1
    if lane is None:
        lane = np.repeat(np.arange(rays), count // max(rays, 1))
    if hits.first is None:
        return np.arange(count), lane
    start = hits.first.take(lane)
    seen = hits.first.take(lane + 1) - start
    which = np.repeat(np.arange(count), seen)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(seen) - seen, seen) + start.take(which)


def toward(
    stretch: Stretch, position: np.ndarray, u: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points v (N,) of a beam's stretch for points (3, N) float64 and u (N,), vectors (3, N) there, their
    lengths, and dv / r^2 / du.
    """
    axis = stretch.direction[:, None]
    start = stretch.start[:, None] - position
    low = dot(start, axis)
    apart = start - low * axis
    far = np.maximum(np.abs(low), np.abs(low + stretch.length))
    gap = np.maximum(np.sqrt(dot(apart, apart)), LEAST_DISTANCE * far)
    w, dw = half_angles(low, low + stretch.length, gap)
    x, r, weight = at_half_angle(w + u * dw, dw, gap)
    return np.clip(x - low, 0, stretch.length), apart + x * axis, r, weight
