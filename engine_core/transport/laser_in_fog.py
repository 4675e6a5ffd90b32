# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of a laser's beam and then once more, to the camera (thesis eq. 6.10).

    L = integral dt integral dv  power T_beam(v) s p(cos_v) T(r) V / r^2 s p(cos_t) T_ray(t)

over the camera ray t and the beam v, r apart; s scattering coefficients, p phase functions, T transmittances
and V visibility between the two. As a staged function of primary space:

    first : (screen 2, lens 2 if it has a size) -> camera rays and their fog
    rest  : (beam 1, camera ray 1) -> radiance, of all lasers, summed (thesis eq. 4.1)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.surfaces import NONE_CAST
from ..geometry.vectors import take
from ..integration.sobol import digital_shift
from . import phase
from .direct_light import CROSSING, SHADOW
from .fog_rays import FogRays
from .laser_maps import (
    Passage,
    along_beam,
    along_ray,
    along_ray_as_in_thesis,
    passages,
)
from .lasers import DEEPEST, Lasers, Stretch, halves
from .media import Media
from .single_scattering import Scattered, SingleScattering, run

INSET = np.float32(1e-5)
"""Of a shadow ray, at either end: both may lie on a surface."""

LOOKS = 2
"""Points of a stretch of a beam, and of a camera ray, that tell what it brings, about."""

MAPS = {"point": along_ray, "thesis_2020": along_ray_as_in_thesis}


@dataclass(eq=False)
class RaySegments:
    """K segments of M camera rays, each in one mixture of media.

    origin, direction : (3, M) float64, unit. ray : (K,). start, end : (K,) float64, along it.
    depth : (C, K) optical depth before the segment. extinction : (C, K), or (C, 1) if all are of one mixture.
    scattering : of each phase function, (3, K) or (3, 1), and g; of what is left behind transparent surfaces.
    inside : (K,) bits, as in `RayMedia`.
    """

    origin: np.ndarray
    direction: np.ndarray
    ray: np.ndarray
    start: np.ndarray
    end: np.ndarray
    depth: np.ndarray
    extinction: np.ndarray
    scattering: list[tuple[np.ndarray, float]]
    inside: np.ndarray

    @staticmethod
    def of(rays: FogRays, media: Media) -> RaySegments:
        fog = rays.media
        mixture = fog.mixture
        if len(mixture) and (mixture == mixture[0]).all():
            mixture = mixture[:1]
        extinction, depth = take(media.extinction, mixture), fog.depth.astype(np.float64)
        # Up to where no colour is left.
        slowest = np.where((extinction > 0).all(axis=0), extinction.min(axis=0), extinction.max(axis=0))
        length = np.maximum(DEEPEST - depth.min(axis=0), 0) / slowest
        # Of light scattered there, what surfaces on the way leave.
        through = 1 if rays.through is None else rays.through
        return RaySegments(
            rays.origin,
            rays.direction,
            fog.ray,
            fog.start,
            np.minimum(fog.end, fog.start + length),
            depth,
            extinction,
            [
                (take(sigma, mixture) * through, float(g))
                for sigma, g in zip(media.scattering, media.anisotropy, strict=True)
                if sigma[:, mixture].any()
            ],
            fog.inside,
        )

    def take(self, rows: np.ndarray | slice) -> RaySegments:
        if isinstance(rows, slice):
            return self

        def of_mixture(a: np.ndarray) -> np.ndarray:
            return a if a.shape[1] == 1 else take(a, rows)

        return RaySegments(
            self.origin,
            self.direction,
            self.ray.take(rows),
            self.start.take(rows),
            self.end.take(rows),
            take(self.depth, rows),
            of_mixture(self.extinction),
            [(of_mixture(sigma), g) for sigma, g in self.scattering],
            self.inside.take(rows),
        )

    def passage(self, stretch: Stretch) -> Passage:
        """Past a stretch of a beam."""
        between = stretch.start[:, None] - take(self.origin, self.ray)
        direction, beam = take(self.direction, self.ray), stretch.direction[:, None]
        return passages(between, direction, beam, stretch.length, self.start, self.end)

    def meets(self, stretch: Stretch, media: Media) -> bool:
        """Whether all that is between these segments and a stretch of a beam is one fog."""
        # Another body might lie between two points that are in the same ones.
        everything = (1 << media.bodies) - 1
        return media.convex and stretch.inside == everything and bool((self.inside == everything).all())

    def unshadowed(
        self, stretch: Stretch, p: Passage, v: np.ndarray, x: np.ndarray, r: np.ndarray, one_fog: bool
    ) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The integrand times r^2, but for what is between beam and camera ray, as a sum of products.

        v : (K, S) on the beam. x : (K, S) on the camera ray, from the foot. r : (K, S) their distance.
        one_fog : what `meets` says; then the fog between is included. Yields colours, (3, K, 1) or (3, 1, 1),
        and factors (C, K, S) float32.
        """
        along = np.maximum(p.foot + v * p.cos + x - self.start[:, None], 0)
        if one_fog:
            along += r
        along, before = along.astype(np.float32), v.astype(np.float32)
        left = np.empty((len(self.depth), *v.shape), np.float32)
        constant = (self.depth + stretch.depth).astype(np.float32)
        for out, depth, ours, theirs in zip(left, constant, self.extinction, stretch.extinction, strict=True):
            np.multiply(along, -ours.astype(np.float32)[:, None], out=out)
            out -= before * np.float32(theirs[0])
            out -= depth[:, None]
        np.exp(left, out=left)

        def scattered(components: list[tuple[np.ndarray, float]], cos: Callable[[], np.ndarray]):
            angle = halves(cos().astype(np.float32)) if any(g for _, g in components) else None
            for sigma, g in components:
                yield sigma, phase.value(*angle, np.float32(g)) if g else phase.ISOTROPIC

        ours = list(scattered(self.scattering, lambda: -x / r))
        for sigma, there in scattered(
            stretch.scattering, lambda: (x * p.cos - (p.y + v * p.sin) * p.sin) / r
        ):
            for tau, here in ours:
                yield (
                    (sigma * tau * stretch.power[:, None])[:, :, None].astype(np.float32),
                    left * (there * here),
                )


class LaserInFog(Scattered):
    """The integrand, over `Pixels`; shared by all threads."""

    rest_dimensions = 2

    def __init__(
        self,
        lasers: Lasers,
        scattering: SingleScattering,
        map: str = "point",
        check: Callable[[], None] = lambda: None,
        shifted: bool = False,
    ) -> None:
        """map : along the camera ray, of `MAPS`. check : called before every batch; may raise, to give up.
        shifted : as of `ScatteredLight`, of stretches of beams.
        """
        super().__init__(scattering, np.zeros(0, np.intp), check)
        self.media = scattering.media
        self.stretches = [s for s in lasers.stretches if s.laser.in_fog]
        self._map, self._shifted = MAPS[map], shifted

    def rest(
        self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Radiance (3, N) at u (2, M, S), beam and camera ray, of M rays in fog; at (2, N) of ``lane``."""
        self._check()
        split = u.shape[2] if lane is None else run(lane)
        rows, which = rays.segments(None if lane is None else lane[::split])
        every = RaySegments.of(rays, self.media)
        segments = every.take(rows)
        u = np.asarray(u, np.float64).reshape(2, -1, split)
        out = np.zeros((3, *u.shape[1:]), np.float32)
        if len(which) != u.shape[1] or not (which == np.arange(len(which))).all():
            u = u.take(which, axis=1)
        for number, stretch in enumerate(self.stretches):
            p = every.passage(stretch)
            if not isinstance(rows, slice):
                p = p.take(rows)
            own = digital_shift(u, number) if self._shifted else u
            self._add(out, which, segments, stretch, p.columns(), own)
        return None, self._bounded(out.reshape(3, -1))

    def unshadowed(self, rays: FogRays, count: int) -> np.ndarray:
        """(count,) what so many camera rays bring if nothing is shaded, about: by a few points of each beam
        and ray, always the same ones.
        """
        segments = RaySegments.of(rays, self.media)
        u = (np.indices((LOOKS, LOOKS)).reshape(2, 1, -1) + 0.5) / LOOKS
        light = np.zeros((3, len(rays), LOOKS**2), np.float32)
        for stretch in self.stretches:
            p = segments.passage(stretch).columns()
            own = np.broadcast_to(u, (2, len(segments.ray), LOOKS**2))
            self._add(light, segments.ray, segments, replace(stretch, blockers=NONE_CAST), p, own)
        found = np.where(np.isfinite(light), light, 0).sum(axis=(0, 2), dtype=np.float64)
        return found if rays.lane is None else np.bincount(rays.lane, found, count)

    def _add(
        self,
        out: np.ndarray,
        which: np.ndarray,
        segments: RaySegments,
        stretch: Stretch,
        p: Passage,
        u: np.ndarray,
    ) -> None:
        """Add to light (3, M, S) of rays ``which`` (K,) what K segments get of a stretch, which they pass
        in ``p``, at u (2, K, S).
        """
        v, dv = along_beam(p, u[0])
        x, r, weight = self._map(p, v, u[1])
        weight = (weight * dv).astype(np.float32)
        one_fog = segments.meets(stretch, self.media)
        t = p.foot + v * p.cos + x
        arrive, part = self.arriving(segments, stretch, v, t, one_fog)
        seen = np.zeros((1 if part is None else len(part), v.size), np.float32)
        seen[:, arrive] = 1 if part is None else part
        seen = seen.reshape(len(seen), *v.shape)
        seen *= weight
        every = len(which) == out.shape[1]
        # Of one ray's segments, which are side by side.
        begin = None if every else np.flatnonzero(np.diff(which, prepend=-1))
        for colour, factor in segments.unshadowed(stretch, p, v, x, r, one_fog):
            value = (factor * seen) * colour
            if every:
                out += value
            else:
                out[:, which.take(begin)] += np.add.reduceat(value, begin, axis=1)

    def arriving(
        self, segments: RaySegments, stretch: Stretch, v: np.ndarray, t: np.ndarray, one_fog: bool
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of points t (K, S) of segments see points v (K, S) of the beam, and what part, (3, J) or
        (1, J), of its light gets there; None for all.

        one_fog : what is between needs no thought.
        """
        arrive, part = np.arange(v.size), None
        origins, directions = between(segments, stretch, v, t)
        if stretch.blockers != NONE_CAST:
            arrive, part = self.arrivals(*shortened(origins, directions), stretch.blockers)
        if not one_fog:
            origins, directions = origins.take(arrive, axis=0), directions.take(arrive, axis=0)
            left = np.exp(-self.depth_between(stretch, origins, directions))
            part = left if part is None else left * part
        return arrive, part

    def arrivals(
        self, origins: np.ndarray, directions: np.ndarray, reach: float, blockers: int
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of rays (N, 3) no surface blocks, and what part (3, J) gets through; None for all."""
        arrive, part, crossings = self._scattering.shadows.passing(origins, directions, reach, blockers)
        self._count(SHADOW, len(origins))
        self._count(CROSSING, crossings)
        return arrive, part

    def depth_between(self, stretch: Stretch, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(C, N) float64 optical depth of rays (N, 3) from the beam to where they lead."""
        inside = np.full(len(origins), stretch.inside)
        return self.media.optical_depth(origins, directions, 1.0, inside).astype(np.float64)


def between(
    segments: RaySegments, stretch: Stretch, v: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Origins (K * S, 3) at points v (K, S) of a beam, and directions to points t (K, S) of K segments."""
    origins, directions = np.empty((2, *v.shape, 3), np.float32)
    for i in range(3):
        from_beam = stretch.start[i] + v * stretch.direction[i]
        origins[..., i] = from_beam
        point = t * segments.direction[i].take(segments.ray)[:, None]
        point += segments.origin[i].take(segments.ray)[:, None]
        point -= from_beam
        directions[..., i] = point
    return origins.reshape(-1, 3), directions.reshape(-1, 3)


def shortened(origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Rays between two points, either of which may lie on a surface."""
    return origins + INSET * directions, directions, float(1 - 2 * INSET)
