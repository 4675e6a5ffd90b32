# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of a laser's beam and then once more, to the camera (thesis eq. 6.10).

    L = integral dt integral dv  power T_beam(v) s p(cos_v) T(r) V / r^2 s p(cos_t) T_ray(t)

over the camera ray t and the beam v, r apart; s scattering coefficients, p phase functions, T transmittances
and V visibility between the two. As a staged function of primary space:

    first : (screen 2, lens 2 if it has a size) -> camera rays and their fog
    rest  : (beam 1, camera ray 1) -> radiance, of all lasers at the same point, summed (thesis eq. 4.1)
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..geometry.surfaces import Surfaces
from ..geometry.vectors import take
from ..integration.inner_rules import InnerRule, Nodes
from ..integration.rules import gauss
from .camera_hits import Pixels
from .camera_rays import CameraRays
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW
from .laser_maps import (
    Passage,
    along_beam,
    along_ray,
    along_ray_as_in_thesis,
    at_half_angle,
    foot_and_gap,
    half_angles,
    passages,
)
from .lasers import DEEPEST, Lasers, Stretch, scattered
from .media import Media
from .shadows import Shadows

INSET = np.float32(1e-5)
"""Of a shadow ray, at either end: both may lie on a surface."""

MAPS = {"point": along_ray, "thesis_2020": along_ray_as_in_thesis}


@dataclass(eq=False)
class RaysInFog:
    """The first stage's result for N camera rays, K segments of which lie in fog that scatters.

    lane : (M,) ascending, rays that have a segment. first : (M + 1,) where the segments of each begin.
    origin, direction : (3, K) float64, unit. start, end : (K,) float64, along it.
    depth : (C, K) optical depth before the segment. extinction : (C, K).
    scattering : of each phase function, (3, K) and g.
    """

    values: None
    lane: np.ndarray
    first: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    start: np.ndarray
    end: np.ndarray
    depth: np.ndarray
    extinction: np.ndarray
    scattering: list[tuple[np.ndarray, float]]

    def samples(self, lane: np.ndarray | None, count: int) -> tuple[np.ndarray, np.ndarray]:
        """(N',) which of ``count`` samples, and the segment that it has a point on: one for each.

        lane : (count,) of the rays with fog; None for equally many in a row for each.
        """
        if lane is None:
            lane = np.repeat(np.arange(len(self.lane)), count // max(len(self.lane), 1))
        start = self.first.take(lane)
        many = self.first.take(lane + 1) - start
        if (many == 1).all():
            return np.arange(count), start
        which = np.repeat(np.arange(count), many)
        return which, np.arange(len(which)) - np.repeat(np.cumsum(many) - many, many) + start.take(which)


class LaserInFog:
    """The integrand, over `Pixels`; shared by all threads.

    counts : so far, rays by kind and what was not finite.
    """

    rest_dimensions = 2
    staged = True

    def __init__(
        self,
        lasers: Lasers,
        rays: CameraRays,
        surfaces: Surfaces,
        shadows: Shadows,
        media: Media,
        map: str = "point",
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """map : along the camera ray, of `MAPS`. check : called before every batch; may raise, to give up."""
        self.stretches = [s for s in lasers.stretches if s.laser.in_fog]
        self._rays, self._surfaces, self._shadows, self._media = rays, surfaces, shadows, media
        self._map, self._check = MAPS[map], check
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, CROSSING, NON_FINITE), 0))
        self.screen_dimensions = rays.dimensions

    def first(self, pixels: Pixels, u: np.ndarray) -> RaysInFog:
        """Camera rays through points (2 or 4, B, S) of pixels' unit squares, and of the lens."""
        self._check()
        origins, directions = self._rays.rays(pixels.x, pixels.y, inset(u))
        points, distance = self._surfaces.first_hit(origins, directions, self._rays.reach)
        end = np.full(len(origins), self._rays.reach)
        end[slice(None) if points.lane is None else points.lane] = distance
        with self._counting:
            self.counts[CAMERA] += len(origins)
        return rays_in_fog(self._media, origins, directions, end)

    def rest(
        self, stage: RaysInFog, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Radiance (3, N) at u (2, M, S), beam and camera ray, for M rays with fog; (2, N) for rays ``lane``."""
        self._check()
        u = np.asarray(u, np.float64).reshape(2, -1)
        which, segment = stage.samples(lane, u.shape[1])
        along, across = take(u, which)
        out = np.zeros((3, u.shape[1]))
        for stretch in self.stretches:
            passage = passage_of(stage, stretch)
            passage = passage.take(segment)
            v, dv = along_beam(passage, along)
            x, r, weight = self._map(passage, v, across)
            value = unshadowed(stage, stretch, segment, passage, v, x, r)
            value *= weight * dv
            good = np.isfinite(value).all(axis=0)
            bad = len(good) - np.count_nonzero(good)
            lit = np.flatnonzero(value.any(axis=0) & good)
            segment_lit, v, t = segment.take(lit), v.take(lit), (passage.foot + v * passage.cos + x).take(lit)
            lit, part = self.arriving(stage, stretch, segment_lit, v, t, lit)
            value = take(value, lit) * part
            for row, channel in zip(out, value, strict=True):
                row += np.bincount(which.take(lit), channel, len(row))
            if bad:
                with self._counting:
                    self.counts[NON_FINITE] += bad
        return None, out.astype(np.float32)

    def arriving(
        self,
        stage: RaysInFog,
        stretch: Stretch,
        segment: np.ndarray,
        v: np.ndarray,
        t: np.ndarray,
        number: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which of N samples, by their ``number`` (N,), are lit, and what part (3, J) or (1, J) gets through.

        segment : (N,). v : (N,) on the stretch of the beam. t : (N,) on the camera ray.
        """
        origins, directions = self.between(stage, stretch, segment, v, t)
        arrive, part = np.arange(len(v)), np.float64(1.0)
        if stretch.casts_shadow:
            origins += INSET * directions
            reach = 1 - 2 * INSET
            arrive, passed, crossings = self._shadows.passing(origins, directions, float(reach))
            part = part if passed is None else passed.astype(np.float64)
            with self._counting:
                self.counts[SHADOW] += len(v)
                self.counts[CROSSING] += crossings
            origins, directions = origins.take(arrive, axis=0), directions.take(arrive, axis=0)
        depth = self.depth_between(stretch, origins, directions)
        return number.take(arrive), part * np.exp(-depth.astype(np.float64))

    @staticmethod
    def between(
        stage: RaysInFog, stretch: Stretch, segment: np.ndarray, v: np.ndarray, t: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rays (N, 3) from points v of the beam to points t of the camera rays."""
        origins = np.empty((len(v), 3), np.float32)
        directions = np.empty((len(v), 3), np.float32)
        for i in range(3):
            from_beam = stretch.start[i] + v * stretch.direction[i]
            origins[:, i] = from_beam
            point = t * stage.direction[i].take(segment)
            point += stage.origin[i].take(segment)
            point -= from_beam
            directions[:, i] = point
        return origins, directions

    def depth_between(self, stretch: Stretch, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(C, N) optical depth between beam and camera rays."""
        inside = np.full(len(origins), stretch.inside)
        return self._media.optical_depth(origins, directions, 1.0, inside)


def rays_in_fog(media: Media, origins: np.ndarray, directions: np.ndarray, end: np.ndarray) -> RaysInFog:
    """Camera rays, as of `CameraRays`, up to ``end`` (N,) lengths of their direction."""
    fog = media.along(origins, directions, end)
    table = media.scattering.any(axis=(0, 1))
    kept = np.flatnonzero(table.take(fog.mixture))
    ray, start, mixture = fog.ray.take(kept), fog.start.take(kept), fog.mixture.take(kept)
    extinction, depth = take(media.extinction, mixture), take(fog.depth, kept).astype(np.float64)
    attenuates = np.where((extinction > 0).all(axis=0), extinction.min(axis=0), extinction.max(axis=0))
    end = np.minimum(fog.end.take(kept), start + np.maximum(DEEPEST - depth.min(axis=0), 0) / attenuates)
    scattering = [
        (take(sigma, mixture), float(g))
        for sigma, g in zip(media.scattering, media.anisotropy, strict=True)
        if sigma[:, mixture].any()
    ]
    first = np.flatnonzero(np.diff(ray, prepend=-1))
    direction = (directions if len(directions) == 1 else directions.take(ray, axis=0)).T.astype(np.float64)
    direction = direction / np.sqrt((direction * direction).sum(axis=0))
    return RaysInFog(
        None,
        ray.take(first),
        np.append(first, len(ray)),
        origins.take(ray, axis=0).T.astype(np.float64),
        np.ascontiguousarray(np.broadcast_to(direction, (3, len(ray)))),
        start,
        end,
        depth,
        extinction,
        scattering,
    )


def passage_of(stage: RaysInFog, stretch: Stretch) -> Passage:
    """Of all segments of camera rays."""
    between = stretch.start[:, None] - stage.origin
    beam = stretch.direction[:, None]
    return passages(between, stage.direction, beam, stretch.length, stage.start, stage.end)


def unshadowed(
    stage: RaysInFog,
    stretch: Stretch,
    segment: np.ndarray,
    p: Passage,
    v: np.ndarray,
    x: np.ndarray,
    r: np.ndarray,
) -> np.ndarray:
    """(3, N) the integrand times r^2, but for what happens between beam and camera ray.

    segment : (N,), p of these. v : (N,) of the beam; x : (N,) of the camera ray, from the foot; r : distance.
    """
    cos_t = x / r
    cos_v = (x * p.cos - (p.y + v * p.sin) * p.sin) / r
    t = p.foot + v * p.cos + x
    attenuation = np.exp(
        -(
            take(stage.depth, segment)
            + take(stage.extinction, segment) * np.maximum(t - p.start, 0)
            + stretch.depth
            + stretch.extinction * v
        )
    )
    value = scattered(stretch.scattering, *halves(cos_v))
    value *= scattered([(take(sigma, segment), g) for sigma, g in stage.scattering], *halves(-cos_t))
    value *= attenuation
    value *= stretch.power[:, None]
    return value


def halves(cos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What `phase.value` wants of a cosine."""
    return np.maximum(0.5 - 0.5 * cos, 0), np.maximum(0.5 + 0.5 * cos, 0)


def inset(u: np.ndarray) -> np.ndarray:
    """Points as float32 inside the open cube."""
    return u if u.dtype == np.float32 else np.clip(u, 2.0**-24, 1 - 2.0**-24).astype(np.float32)
