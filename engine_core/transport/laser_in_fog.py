# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of a laser's beam and then once more, to the camera (thesis eq. 6.10).

    L = integral dt integral dv  power T_beam(v) s p(cos_v) T(r) V / r^2 s p(cos_t) T_ray(t)

over the camera ray t and the beam v, r apart; s scattering coefficients, p phase functions, T transmittances
and V visibility between the two. As a staged function of primary space:

    first : (screen 2, lens 2 if it has a size) -> camera rays and their fog
    rest  : (beam 1, camera ray 1) -> radiance, of all lasers at the same point, summed (thesis eq. 4.1)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..geometry.vectors import take
from .direct_light import CROSSING, SHADOW
from .laser_maps import (
    Passage,
    along_beam,
    along_ray,
    along_ray_as_in_thesis,
    passages,
)
from .lasers import DEEPEST, Lasers, Stretch, halves, scattered
from .media import Media
from .single_scattering import FogRays, Scattered, SingleScattering

INSET = np.float32(1e-5)
"""Of a shadow ray, at either end: both may lie on a surface."""

MAPS = {"point": along_ray, "thesis_2020": along_ray_as_in_thesis}


@dataclass(eq=False)
class Segments:
    """K segments of M camera rays, each in one mixture of media.

    origin, direction : (3, M) float64, unit. ray : (K,). start, end : (K,) float64, along it.
    depth : (C, K) optical depth before the segment. extinction : (C, K), or (C, 1) if all are of one mixture.
    scattering : of each phase function, (3, K) or (3, 1), and g.
    """

    origin: np.ndarray
    direction: np.ndarray
    ray: np.ndarray
    start: np.ndarray
    end: np.ndarray
    depth: np.ndarray
    extinction: np.ndarray
    scattering: list[tuple[np.ndarray, float]]

    @staticmethod
    def of(rays: FogRays, media: Media) -> Segments:
        fog = rays.media
        mixture = fog.mixture
        if len(mixture) and (mixture == mixture[0]).all():
            mixture = mixture[:1]
        extinction, depth = take(media.extinction, mixture), fog.depth.astype(np.float64)
        # Up to where no colour is left.
        slowest = np.where((extinction > 0).all(axis=0), extinction.min(axis=0), extinction.max(axis=0))
        length = np.maximum(DEEPEST - depth.min(axis=0), 0) / slowest
        return Segments(
            rays.origin,
            rays.direction,
            fog.ray,
            fog.start,
            np.minimum(fog.end, fog.start + length),
            depth,
            extinction,
            [
                (take(sigma, mixture), float(g))
                for sigma, g in zip(media.scattering, media.anisotropy, strict=True)
                if sigma[:, mixture].any()
            ],
        )

    def take(self, rows: np.ndarray | slice) -> Segments:
        if isinstance(rows, slice):
            return self

        def of_mixture(a: np.ndarray) -> np.ndarray:
            return a if a.shape[1] == 1 else take(a, rows)

        return Segments(
            self.origin,
            self.direction,
            self.ray.take(rows),
            self.start.take(rows),
            self.end.take(rows),
            take(self.depth, rows),
            of_mixture(self.extinction),
            [(of_mixture(sigma), g) for sigma, g in self.scattering],
        )

    def passage(self, stretch: Stretch) -> Passage:
        """Past a stretch of a beam."""
        between = stretch.start[:, None] - take(self.origin, self.ray)
        direction, beam = take(self.direction, self.ray), stretch.direction[:, None]
        return passages(between, direction, beam, stretch.length, self.start, self.end)

    def unshadowed(
        self, stretch: Stretch, p: Passage, v: np.ndarray, x: np.ndarray, r: np.ndarray
    ) -> np.ndarray:
        """(3, K) the integrand times r^2, but for what is between beam and camera ray.

        v : (K,) on the beam. x : (K,) on the camera ray, from the foot. r : (K,) their distance.
        """
        cos_v = (x * p.cos - (p.y + v * p.sin) * p.sin) / r
        t = p.foot + v * p.cos + x
        depth = self.depth + self.extinction * np.maximum(t - self.start, 0)
        depth += stretch.depth + stretch.extinction * v
        value = scattered(stretch.scattering, *halves(cos_v))
        value *= scattered(self.scattering, *halves(-x / r))
        value *= np.exp(-depth)
        value *= stretch.power[:, None]
        return value


class LaserInFog(Scattered):
    """The integrand, over `Pixels`; shared by all threads."""

    rest_dimensions = 2

    def __init__(
        self,
        lasers: Lasers,
        scattering: SingleScattering,
        map: str = "point",
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """map : along the camera ray, of `MAPS`. check : called before every batch; may raise, to give up."""
        super().__init__(scattering, np.zeros(0, np.intp), check)
        self.media = scattering.media
        self.stretches = [s for s in lasers.stretches if s.laser.in_fog]
        self._map = MAPS[map]

    def rest(
        self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Radiance (3, N) at u (2, M, S), beam and camera ray, of M rays in fog; at (2, N) of ``lane``."""
        self._check()
        if lane is None and u.shape[2] > 1:
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        u = np.asarray(u, np.float64).reshape(2, -1)
        rows, which = rays.segments(lane)
        every = Segments.of(rays, self.media)
        segments = every.take(rows)
        along, across = take(u, which)
        out = np.zeros((3, u.shape[1]))
        for stretch in self.stretches:
            if len(which) > len(every.start):
                passage = every.passage(stretch).take(rows)
            else:
                passage = segments.passage(stretch)
            v, dv = along_beam(passage, along)
            x, r, weight = self._map(passage, v, across)
            value = segments.unshadowed(stretch, passage, v, x, r)
            value *= weight * dv
            lit = np.flatnonzero(value.any(axis=0))
            t = passage.foot + v * passage.cos + x
            arrive, part = self.arriving(segments, stretch, lit, v.take(lit), t.take(lit))
            lit = lit.take(arrive)
            value = take(value, lit) * part
            for row, channel in zip(out, value, strict=True):
                row += np.bincount(which.take(lit), channel, len(row))
        return None, self._bounded(out)

    def arriving(
        self, segments: Segments, stretch: Stretch, rows: np.ndarray, v: np.ndarray, t: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which (J,) of points t (N,) of segments ``rows`` (N,) see points v (N,) of the beam, and what part
        (3, J) or (1, J) of its light gets there.
        """
        origins, directions = between(segments, stretch, rows, v, t)
        arrive, part = np.arange(len(v)), None
        if stretch.casts_shadow:
            arrive, part = self.arrivals(*shortened(origins, directions))
            origins, directions = origins.take(arrive, axis=0), directions.take(arrive, axis=0)
        left = np.exp(-self.depth_between(stretch, origins, directions))
        return arrive, left if part is None else left * part

    def arrivals(
        self, origins: np.ndarray, directions: np.ndarray, reach: float
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of rays (N, 3) no surface blocks, and what part (3, J) gets through; None for all."""
        arrive, part, crossings = self._scattering.shadows.passing(origins, directions, reach)
        self._count(SHADOW, len(origins))
        self._count(CROSSING, crossings)
        return arrive, part

    def depth_between(self, stretch: Stretch, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(C, N) float64 optical depth of rays (N, 3) from the beam to where they lead."""
        inside = np.full(len(origins), stretch.inside)
        return self.media.optical_depth(origins, directions, 1.0, inside).astype(np.float64)


def between(
    segments: Segments, stretch: Stretch, rows: np.ndarray, v: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Origins at points v (N,) of a beam, and directions (N, 3) to points t of segments ``rows`` (N,)."""
    origins, directions = np.empty((2, len(v), 3), np.float32)
    ray = segments.ray.take(rows)
    for i in range(3):
        from_beam = stretch.start[i] + v * stretch.direction[i]
        origins[:, i] = from_beam
        point = t * segments.direction[i].take(ray)
        point += segments.origin[i].take(ray)
        point -= from_beam
        directions[:, i] = point
    return origins, directions


def shortened(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Rays between two points, either of which may lie on a surface."""
    return origins + INSET * directions, directions, float(1 - 2 * INSET)
