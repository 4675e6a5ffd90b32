# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of a laser's beam onto the surfaces that the camera sees.

    L = integral dv  power T_beam(v) s p(cos_v) T(r) V f cos / r^2

over the beam v, r from the surface point; f its BSDF. The map along the beam is by 1/r^2 about the point, and
by what it mirrors. As a staged function of primary space:

    first : (screen 2, lens 2 if it has a size) -> camera hits
    rest  : (beam 1) -> radiance reflected at those hits, of all lasers, summed
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from ..bsdf.microfacet import MIN_ALPHA
from ..geometry.surfaces import NONE_CAST
from ..geometry.vectors import dot, inverse_length, take
from ..integration.integrand import FirstStage
from ..integration.mapping import Map
from ..integration.sobol import digital_shift
from ..scene import Linking
from .camera_hits import CameraHits, CameraStage, Pixels
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW, _inset
from .highlights import Highlights
from .laser_maps import LEAST_DISTANCE, at_half_angle, half_angles, half_angles_by_lobe
from .lasers import Lasers, Stretch, halves, scattered
from .media import Media
from .shadows import Shadows
from .single_scattering import run

BEND = 0.9
"""Cosine between the normals at two corners of a pixel, below which there is a crease."""

ROWS = 32
"""Of the picture, traced at once for creases."""

MIRRORED, WIDE = 0.5, 0.5
"""Of a beam's points, those that are where a lobe mirrors it that is brighter there than all that is diffuse:
half of a net are one, too. But a lobe that is as wide as that, in radians, is no matter of luck.
"""

GRAZING, STEPS = 0.02, 2
"""Cosines of lobes at least; and steps to the middle of what a lobe shows of a beam."""

LOOKS = 2
"""Points of a stretch of a beam that tell what it brings, about."""


@dataclass(frozen=True, eq=False)
class Ends:
    """Where stretches of beams end, or begin at a laser, as `around_light.blocks` wants them. What surfaces
    there get is as bright as 1/distance.

    centre : (3, L) in the frame. reach : (L,) how far a surface may be. stretch : (L,) numbers of them.
    """

    centre: np.ndarray
    reach: np.ndarray
    stretch: np.ndarray

    @staticmethod
    def of(stretches: Sequence[Stretch]) -> Ends:
        end = [s.start + s.length * s.direction for s in stretches]
        behind = np.array([s.behind for s in stretches])
        near = np.flatnonzero(np.isfinite(behind))
        centre = np.stack(end + [stretches[k].start for k in near], axis=1)
        reach = np.concatenate([np.zeros(len(end)), behind[near]])
        return Ends(centre, reach, np.concatenate([np.arange(len(end)), near]))

    @property
    def numbers(self) -> np.ndarray:
        return np.arange(self.centre.shape[1])


@dataclass(eq=False)
class Towards:
    """Points of a beam, as `Shadows` wants them."""

    at: np.ndarray
    to_light: np.ndarray
    at_infinity: bool = False


@dataclass(frozen=True, eq=False)
class Mirrored:
    """Lobes in which M points show beams that they mirror: the highest of each, as GGX.

    normal, viewer : (3, M) unit, of the lobe and towards the camera. alpha : (M,) width of its slopes.
    peak, diffuse : (M,) BRDF in its middle, and of all lobes that are smooth.
    """

    normal: np.ndarray
    viewer: np.ndarray
    alpha: np.ndarray
    peak: np.ndarray
    diffuse: np.ndarray

    @staticmethod
    def of(hits: CameraHits) -> Mirrored | None:
        """None where all lobes are smooth."""
        seen = Highlights.of(hits.slots, len(hits.points))
        if seen is None:
            return None
        found = Mirrored(
            *np.zeros((2, 3, len(seen.diffuse))), *np.zeros((2, len(seen.diffuse))), seen.diffuse
        )
        for lobe in seen.glossy:
            cos = np.maximum(lobe.cos_viewer, GRAZING)
            peak = lobe.strength / (4 * np.pi * np.square(lobe.alpha.astype(np.float64) * cos))
            # A mirror shows no light that has no size.
            higher = np.isfinite(peak) & (peak > found.peak) & (lobe.alpha > MIN_ALPHA)
            own = lobe.normal, lobe.towards_viewer, lobe.alpha, peak
            for a, b in zip((found.normal, found.viewer, found.alpha, found.peak), own, strict=True):
                np.copyto(a, b, where=higher)
        return found

    def take(self, rows: np.ndarray) -> Mirrored:
        return Mirrored(*(getattr(self, name)[..., rows] for name in self.__dataclass_fields__))

    def lobe(self, across: np.ndarray, axis: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `half_angles_by_lobe` wants it, of angles from unit vectors ``across`` (3, M) to ``axis``.

        Along the beam the slope of half vectors is taken to be linear in the angle about where it is least,
        found from where the mirrored ray is nearest: a lobe that is seen at a grazing angle is narrower
        sideways.
        """
        direction = 2 * dot(self.normal, self.viewer) * self.normal - self.viewer
        angle = np.arctan2(dot(direction, axis), dot(direction, across))
        for _ in range(STEPS):
            sin, cos = np.sin(angle), np.cos(angle)
            half, turned = cos * across + sin * axis + self.viewer, cos * axis - sin * across
            along = np.maximum(dot(half, self.normal), GRAZING)
            slope = half / along - self.normal
            change = (turned - dot(turned, self.normal) * (self.normal + slope)) / along
            square = np.maximum(dot(change, change), np.finfo(np.float32).tiny)
            step = dot(slope, change) / square
            angle = angle - step
            least = np.maximum(dot(slope, slope) - step * step * square, 0)
        width = self.alpha * self.alpha
        # What a beam that passes the lobe's middle at some distance gets of it.
        peak = self.peak / np.square(1 + least / np.maximum(width, np.finfo(np.float32).tiny))
        width = np.sqrt((width + least) / square)
        bright = (peak > self.diffuse) & (width < WIDE)
        return angle, np.where(bright, width, 1), MIRRORED * bright


EVERYTHING = Linking()


class Reflection:
    """What the points of camera hits reflect."""

    def __init__(
        self, reflectance: np.ndarray, material: np.ndarray, light_set: np.ndarray | int = 0
    ) -> None:
        """Where all are Lambertian: reflectance (3, number of materials), and each triangle's material.

        light_set : as of `Triangles`.
        """
        self._lambert = (np.asarray(reflectance) / np.pi).astype(np.float32)
        self._material, self._set = material, light_set

    def of(
        self,
        hits: CameraHits,
        at: np.ndarray,
        direction: np.ndarray,
        value: np.ndarray,
        linking: Linking = EVERYTHING,
    ) -> None:
        """Multiply ``value`` (3, N) with BSDF and cosine of points ``at`` (N,), for light from unit
        ``direction`` (3, N) float32, and with what fog leaves on the way to the camera; with 0 where the
        light is not linked to them.
        """
        if linking.receivers is not None:
            sets = self._set
            if np.ndim(sets):
                sets = sets.take(hits.points.triangle.take(at))
            value *= np.isin(sets, list(linking.receivers))
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
        shifted: bool = False,
    ) -> None:
        """check : called before every batch; may raise, to give up. shifted : as of `LaserInFog`."""
        self.stretches = [s for s in lasers.stretches if s.laser.on_surfaces]
        self._stage, self._shadows, self._media, self._check = stage, shadows, media, check
        self.reflection, self._shifted = reflection, shifted
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, CROSSING, NON_FINITE), 0))
        self.screen_dimensions = stage.dimensions

    def of_some(self, numbers: np.ndarray) -> LaserOnSurfaces:
        """The same of some of the stretches alone, with counts of its own."""
        some = copy(self)
        some.stretches = [self.stretches[number] for number in numbers]
        some._counting, some.counts = Lock(), Counter(dict.fromkeys(self.counts, 0))
        return some

    def first(self, pixels: Pixels, u: np.ndarray) -> FirstStage:
        """Hits of camera rays through points (2 or 4, B, S) of pixels' unit squares, and of the lens."""
        self._check()
        hits = self._stage.hit(pixels, _inset(u))
        self._count(CAMERA, u[0].size)
        self._count(CROSSING, hits.crossings)
        return replace(hits, values=None)

    @property
    def ends(self) -> Ends:
        return Ends.of(self.stretches)

    def rest(
        self, hits: CameraHits, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """Radiance (3, N) at u (1, M, S) for M hits; at u (1, N) for hits ``lane`` (N,)."""
        self._check()
        split = u.shape[2] if lane is None else run(lane)
        u = np.asarray(u, np.float64).reshape(-1, split)
        which, at = of_each(hits, None if lane is None else lane[::split], len(u))
        out = np.zeros((3, u.size), np.float32)
        if len(at) == 0:
            return None, out
        u = u.take(which, axis=0)
        which = (which[:, None] * split + np.arange(split)).ravel()
        mirrored = Mirrored.of(hits)
        mirrored = None if mirrored is None else mirrored.take(at)
        every = np.repeat(at, split) if split > 1 else at
        for number, stretch in enumerate(self.stretches):
            own = digital_shift(u[None], number)[0] if self._shifted else u
            value, v, to_beam = reflected(hits, at, every, stretch, self.reflection, own, mirrored)
            lit = np.flatnonzero(self.finite(value).any(axis=0))
            if stretch.blockers != NONE_CAST:
                arrive, part = self.arrivals(hits, every.take(lit), take(to_beam, lit), stretch.blockers)
                lit = lit.take(arrive)
                value = take(value, lit) if part is None else take(value, lit) * part
            else:
                value = take(value, lit)
            value *= np.exp(-self.depth_between(stretch, v.take(lit), take(to_beam, lit)))
            for row, channel in zip(out, value, strict=True):
                row += np.bincount(which.take(lit), channel, len(row)).astype(np.float32)
        return None, out

    def unshadowed(self, hits: CameraHits, count: int) -> np.ndarray:
        """(count,) what so many camera rays bring if nothing is shaded, about: by a few points of each beam,
        always the same ones.
        """
        at, found = np.arange(len(hits.points)), np.zeros(len(hits.points))
        if len(at):
            u = np.broadcast_to((np.arange(LOOKS) + 0.5) / LOOKS, (len(at), LOOKS))
            every, mirrored = np.repeat(at, LOOKS), Mirrored.of(hits)
            for stretch in self.stretches:
                value, v, to_beam = reflected(hits, at, every, stretch, self.reflection, u, mirrored)
                value = value * np.exp(-self.depth_between(stretch, v, to_beam))
                value = np.where(np.isfinite(value), value, 0).sum(axis=0, dtype=np.float64)
                found += value.reshape(-1, LOOKS).sum(axis=1)
        lane = hits.points.lane
        return found if lane is None else np.bincount(lane, found, count)

    def creases(self, region: tuple[int, int, int, int], map_: Map) -> np.ndarray:
        """(W, H) bool, pixels of a region x0, y0, x1, y1 between whose corners a surface turns, or ends.

        map_ : runs a function over items on the workers, and returns the results in order.
        """
        x0, y0, x1, y1 = region
        width, height = x1 - x0, y1 - y0

        def trace(low: int) -> np.ndarray:
            y, x = (a.ravel() for a in np.mgrid[low : min(low + ROWS, y1 + 1), x0 : x1 + 1])
            at = np.minimum(x, x1 - 1), np.minimum(y, y1 - 1)
            pixels = Pixels(*(a.astype(np.int32) for a in at), np.zeros(len(x), np.int32))
            hits = self.first(pixels, np.stack([x - at[0], y - at[1]]).astype(np.float32)[:, :, None])
            normal = np.zeros((3, len(x)), np.float32)
            normal[:, slice(None) if hits.lane is None else hits.lane] = hits.normal
            return normal.reshape(3, -1, width + 1)

        normal = np.concatenate(map_(trace, range(y0, y1 + 1, ROWS)), axis=1)
        found = np.zeros((height, width), bool)
        # Where nothing is seen, nothing turns.
        seen = normal.any(axis=0)
        bends = (dot(normal[:, 1:], normal[:, :-1]) < BEND) & (seen[1:] | seen[:-1])
        found |= bends[:, 1:] | bends[:, :-1]
        bends = (dot(normal[:, :, 1:], normal[:, :, :-1]) < BEND) & (seen[:, 1:] | seen[:, :-1])
        found |= bends[1:] | bends[:-1]
        return found.T

    def finite(self, value: np.ndarray) -> np.ndarray:
        """``value`` (3, N) with 0 in place of what is not finite, which is counted."""
        bad = ~np.isfinite(value).all(axis=0)
        if bad.any():
            self._count(NON_FINITE, int(bad.sum()))
            value[:, bad] = 0
        return value

    def arrivals(
        self, hits: CameraHits, at: np.ndarray, to_beam: np.ndarray, blockers: int
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of points ``at`` (N,) see where ``to_beam`` (3, N) leads, and what part (3, J) of its
        light gets through; None for all.
        """
        cosine = dot(take(hits.points.normal, at), to_beam) * inverse_length(to_beam)
        towards = Towards(at, to_beam)
        arrive, part, crossings = self._shadows.arriving(hits.points, towards, cosine, blockers, short=True)
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


def reflected(
    hits: CameraHits,
    at: np.ndarray,
    every: np.ndarray,
    stretch: Stretch,
    reflection: Reflection,
    u: np.ndarray,
    mirrored: Mirrored | None = None,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What points ``at`` (L,) of camera hits reflect of a stretch of a beam, at u (L, S).

    The map is by 1/r^2, and in part by where they mirror it.

    every : (L * S,) the points again, S times each. mirrored : of L points; None for none. Returns (3, L * S)
    the integrand, but for what is between; v (L * S,) of the stretch; and vectors (3, L * S) float32 there.
    """
    axis = stretch.direction[:, None]
    start = stretch.start[:, None] - take(hits.points.position, at).astype(np.float64)
    foot = dot(start, axis)
    apart, last = start - foot * axis, foot + stretch.length
    far = np.maximum(np.abs(foot), np.abs(last))
    gap = np.maximum(np.sqrt(dot(apart, apart)), LEAST_DISTANCE * far)
    low, dw = half_angles(foot, last, gap)
    w, each = low[:, None] + u * dw[:, None], dw[:, None]
    if mirrored is not None:
        lobe = mirrored.lobe(apart / gap, axis)
        if lobe[2].any():
            w, each = half_angles_by_lobe(low, dw, lobe, u)
    x, r, weight = at_half_angle(w, each, gap[:, None])
    v = np.clip(x - foot[:, None], 0, stretch.length).ravel()
    to_beam = np.empty((3, *x.shape), np.float32)
    direction = np.empty_like(to_beam)
    inverse = 1 / r
    for i in range(3):
        part = x * stretch.direction[i]
        part += apart[i][:, None]
        to_beam[i] = part
        np.multiply(part, inverse, out=direction[i], casting="same_kind")
    # Towards the beam is against the light.
    cos = (-x * inverse).ravel()
    value = scattered(stretch.scattering, *halves(cos)) * (stretch.transmittance(v) * weight.ravel())
    value = (value * stretch.power[:, None]).astype(np.float32)
    reflection.of(hits, every, direction.reshape(3, -1), value, stretch.laser.linking)
    return value, v, to_beam.reshape(3, -1)
