# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers as the camera sees them: the beam, where fog scatters it to the camera, and the spot where it ends.

The beam is a cylinder of its radius R, in which the flux is even. Along a chord of it

    L = integral dt  s p(cos) power / (pi R^2) T_beam T_ray

is closed: all exponents are linear in t. The spot is what the surfaces reflect that the light of the cylinder
meets first: irradiance power / (pi R^2) T cos.

Both may be far thinner than a pixel, so that points of it would miss them. So their points lie where the
cylinder is: within the two lines in the picture that are its outline, and between its ends (`Outline`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from threading import Lock

import numpy as np

from ..geometry.surfaces import NONE_CAST
from ..geometry.vectors import dot, take
from ..geometry.warps import basis
from .camera_hits import CameraHits, CameraStage, Pixels
from .camera_rays import CameraRays
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW, _bound, _inset
from .fog_rays import FogRays
from .laser_in_fog import RaySegments
from .laser_on_surfaces import Reflection, Towards
from .lasers import THINNEST, Beam, Lasers, Stretch, halves, scattered, unblocked
from .lens_targets import LensTargets
from .shadows import Shadows
from .single_scattering import SingleScattering

WIDE = 1.0
"""Pixels, above which a cylinder's image is sampled as all else is."""


SPOT_WORTH = 8.0
"""Times as many points as beams, of a pixel that sees where one ends, through a lens: that is brighter by
far, and may be far smaller than what a pixel sees of it."""


@dataclass(eq=False)
class _Values:
    """A first stage that is all there is."""

    values: np.ndarray
    lane: None = None


class LasersSeen:
    """Radiance of beams and spots as camera rays see it: an integral over the pixel alone.

    counts : so far, rays by kind and what was not finite.
    """

    rest_dimensions = 0
    staged = True

    def __init__(
        self,
        lasers: Lasers,
        rays: CameraRays,
        stage: CameraStage,
        reflection: Reflection,
        shadows: Shadows,
        scattering: SingleScattering | None,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        """scattering : None without fog. check : called before every batch; may raise, to give up."""
        self.stretches = [s for s in lasers.stretches if s.laser.beam]
        self.spots = [b for b in lasers.beams if b.laser.spot]
        self._rays, self._stage, self._reflection = rays, stage, reflection
        self._shadows, self._scattering, self._check = shadows, scattering, check
        self._outlines = self._outlines_of() if rays.dimensions == 2 else []
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, CROSSING, NON_FINITE), 0))
        self.screen_dimensions = rays.dimensions

    # -- at points of pixels -----------------------------------------------------------------------

    def first(self, pixels: Pixels, u: np.ndarray) -> _Values:
        """All that rays see through points (2 or 4, B, S) of pixels, and of the lens: values (3, B * S)."""
        self._check()
        u = _inset(u)
        out = np.zeros((3, u[0].size))
        if self.stretches:
            self._add_beams(out, self._scattering.first(pixels, u), self.stretches)
        if self.spots:
            hits = self._stage.hit(pixels, u)
            for beam in self.spots:
                self._add_spot(out, hits, beam)
        self._count(CAMERA, u[0].size * (bool(self.stretches) + bool(self.spots)))
        return _Values(self._bounded(out))

    def _add_beams(self, out: np.ndarray, rays: FogRays, stretches: Sequence[Stretch]) -> None:
        segments = RaySegments.of(rays, self._scattering.media)
        lane = rays.media.ray if rays.lane is None else rays.lane.take(rays.media.ray)
        for stretch in stretches:
            for row, channel in zip(out, glow(segments, stretch), strict=True):
                row += np.bincount(lane, channel, len(row))

    def _add_spot(self, out: np.ndarray, hits: CameraHits, beam: Beam) -> None:
        points = hits.points
        axis = beam.direction[:, None]
        from_start = points.position - beam.origin[:, None]
        v = dot(from_start, axis)
        apart = from_start - v * axis
        at = np.flatnonzero((v > 0) & (v <= beam.length) & (dot(apart, apart) <= beam.radius**2))
        v = v.take(at)
        direction = np.broadcast_to(-axis.astype(np.float32), (3, len(at)))
        value = np.empty((3, len(at)), np.float32)
        value[:] = (beam.power / (np.pi * beam.radius**2))[:, None]
        self._reflection.of(hits, at, direction, value, beam.laser.linking)
        lit = np.flatnonzero(value.any(axis=0))
        at, v, value = at.take(lit), v.take(lit), take(value, lit)
        back = (-axis * v).astype(np.float32)
        if beam.blockers != NONE_CAST:
            cosine = dot(take(points.normal, at), take(direction, lit))
            # A laser may touch a wall.
            towards = Towards(at, back * np.maximum(1 - unblocked(beam.origin) / v, 0.5).astype(np.float32))
            arrive, part, crossings = self._shadows.arriving(
                points, towards, cosine, beam.blockers, short=True
            )
            self._count(SHADOW, len(at))
            self._count(CROSSING, crossings)
            at, v, back, value = at.take(arrive), v.take(arrive), take(back, arrive), take(value, arrive)
            if part is not None:
                value *= part
        if self._scattering is not None:
            start = np.ascontiguousarray((take(points.position, at) + back).T)
            inside = np.full(len(at), beam.inside)
            depth = self._scattering.media.optical_depth(start, -np.ascontiguousarray(back.T), 1.0, inside)
            value *= np.exp(-depth)
        lane = at if points.lane is None else points.lane.take(at)
        for row, channel in zip(out, value, strict=True):
            row += np.bincount(lane, channel, len(row))

    def targets(self) -> LensTargets:
        """All of it, of a lens: the beams, and where their light is known to meet surfaces, or may do so."""
        rods = [(s.start, s.direction, s.length, s.radius, 1.0) for s in self.stretches]
        rods += [(b.origin, b.direction, b.length, b.radius, 0.0) for b in self.spots]
        ends = [(end, beam.radius) for beam in self.spots for end in beam.ends]
        middle = np.array([end.mean(axis=1) for end, _ in ends]).reshape(-1, 3).T
        reach = [np.linalg.norm(end.T - end.mean(axis=1), axis=1).max() + radius for end, radius in ends]
        return LensTargets.of(self._rays, (middle, np.array(reach), SPOT_WORTH), rods)

    # -- over pixels -------------------------------------------------------------------------------

    def means(
        self, pixels: Pixels, u: np.ndarray, spots: bool | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Mean radiance (3, B) of pixels, and its standard error, about; without a lens.

        spots : of where beams end, which want many points where a surface grazes the beam; or of all else;
            None for both.

        u : (2, B, S) points of the unit square, float64 if they can be; S for each cylinder in each pixel.
        """
        total, variance = np.zeros((2, 3, len(pixels)))
        for outline, look, is_spot in self._outlines:
            if spots is not None and is_spot != spots:
                continue
            self._check()
            touched = outline.touches(pixels)
            if touched.size == 0:
                continue
            place, weight = outline.points(pixels[touched], u[:, touched])
            values = look(pixels[touched], place).reshape(3, *weight.shape) * weight
            mean = values.mean(axis=2)
            total[:, touched] += mean
            spread = np.square(values - mean[:, :, None]).mean(axis=2)
            # Of a net's points.
            variance[:, touched] += spread / weight.shape[1] ** 1.5
        return total, np.sqrt(variance)

    def touched(self, pixels: Pixels, spots: bool) -> np.ndarray:
        """(B',) which of pixels `means` may find anything in."""
        found = [outline.touches(pixels) for outline, _, is_spot in self._outlines if is_spot == spots]
        return np.unique(np.concatenate([np.zeros(0, np.intp), *found]))

    def _outlines_of(self) -> list[tuple[Outline, Callable[[Pixels, np.ndarray], np.ndarray], bool]]:
        """Where in the picture each cylinder is, what rays of pixels through points see of it alone, and
        whether that is a spot.
        """
        found, rays = [], self._rays
        for s in self.stretches:
            outline = Outline(rays, s.start, s.direction, s.radius, s.length)
            found.append((outline, partial(self._beam_at, stretch=s), False))
        for beam in self.spots:
            # Where its light is known to meet surfaces, points lie close; some of it may be anywhere.
            ends = [Outline(rays, beam.origin, beam.direction, beam.radius, points=p) for p in beam.ends]
            ends = [end for end in ends if end.bounded]
            found += [
                (end, partial(self._spot_at, beam=beam, besides=ends[:i]), True) for i, end in enumerate(ends)
            ]
            whole = Outline(rays, beam.origin, beam.direction, beam.radius, beam.length)
            found.append((whole, partial(self._spot_at, beam=beam, besides=ends), False))
        return found

    def _beam_at(self, pixels: Pixels, u: np.ndarray, stretch: Stretch) -> np.ndarray:
        """(3, B * S) what rays through points u (2, B, S) float64 see of a stretch of a beam."""
        out = np.zeros((3, u[0].size))
        rays = self._scattering.first(pixels, u)
        # A beam may be thinner than what float32 can tell of a pixel.
        x, y = (a + b[:, None] for a, b in zip(u, (pixels.x, pixels.y), strict=True))
        lanes = slice(None) if rays.lane is None else rays.lane
        rays.origin, rays.direction = (a.reshape(3, -1)[:, lanes] for a in self._rays.exactly(x, y))
        rays.direction = rays.direction / np.sqrt(dot(rays.direction, rays.direction))
        self._count(CAMERA, u[0].size)
        self._add_beams(out, rays, [stretch])
        return self._bounded(out)

    def _spot_at(self, pixels: Pixels, u: np.ndarray, beam: Beam, besides: Sequence[Outline]) -> np.ndarray:
        """(3, B * S) the same of a beam's spots, but within the boxes of others."""
        out = np.zeros((3, u[0].size))
        x, y = (a + b[:, None] for a, b in zip(u, (pixels.x, pixels.y), strict=True))
        wanted = ~sum((end.holds(x, y) for end in besides), np.zeros(x.shape, bool))
        rows = np.flatnonzero(wanted.any(axis=1))
        if rows.size:
            some = np.zeros((3, u[0, rows].size))
            self._count(CAMERA, u[0, rows].size)
            self._add_spot(some, self._stage.hit(pixels[rows], _inset(u[:, rows])), beam)
            out.reshape(3, *x.shape)[:, rows] = some.reshape(3, len(rows), -1) * wanted[rows]
        return self._bounded(out)

    def _count(self, kind: str, number: int) -> None:
        with self._counting:
            self.counts[kind] += number

    def _bounded(self, radiance: np.ndarray) -> np.ndarray:
        bad = np.count_nonzero(~np.isfinite(radiance).all(axis=0))
        if bad:
            self._count(NON_FINITE, bad)
            radiance[~np.isfinite(radiance)] = 0
        radiance = radiance.astype(np.float32)
        _bound(radiance)
        return radiance


def glow(segments: RaySegments, stretch: Stretch) -> np.ndarray:
    """(3, K) radiance that a stretch of a beam adds to segments of camera rays."""
    axis = stretch.direction[:, None]
    start = take(segments.origin, segments.ray) - stretch.start[:, None]
    along = dot(start, axis)
    apart = start - along * axis
    direction = take(segments.direction, segments.ray)
    cos = dot(direction, axis)
    across = direction - cos * axis
    square = dot(across, across)
    parallel = square < 1e-24
    square = np.where(parallel, 1, square)
    nearest = np.where(parallel, 0, -dot(apart, across) / square)
    gap = apart + nearest * across
    inside = stretch.radius**2 - dot(gap, gap)
    half = np.where(parallel, np.inf, np.sqrt(np.maximum(inside, 0) / square))
    low, high = np.maximum(nearest - half, segments.start), np.minimum(nearest + half, segments.end)
    # Between the stretch's ends.
    beside = np.abs(cos) < 1e-12
    slope = np.where(beside, 1, cos)
    ends = -along / slope, (stretch.length - along) / slope
    between = (along >= 0) & (along <= stretch.length)
    low = np.where(beside, low, np.maximum(low, np.minimum(*ends)))
    high = np.where(beside, high, np.minimum(high, np.maximum(*ends)))
    some = np.flatnonzero((high > low) & (inside > 0) & (between | ~beside))
    out = np.zeros((3, len(along)))
    if some.size == 0:
        return out
    segments, low, high, cos, along = (
        segments.take(some), low.take(some), high.take(some), cos.take(some), along.take(some)
    )  # fmt: skip
    growth = segments.extinction + stretch.extinction * cos
    # From the end where less is lost, so that nothing grows.
    t = np.where(growth >= 0, low, high)
    depth = segments.depth + segments.extinction * (t - segments.start)
    depth += stretch.depth + stretch.extinction * np.clip(along + t * cos, 0, stretch.length)
    lost = np.abs(growth) * (high - low)
    chord = (high - low) * np.where(
        lost > 1e-8, -np.expm1(-lost) / np.where(lost > 1e-8, lost, 1), 1 - lost / 2
    )
    value = scattered(segments.scattering, *halves(-cos))
    value *= chord * np.exp(-depth)
    value *= (stretch.power / (np.pi * stretch.radius**2))[:, None]
    out[:, some] = value
    return out


def beside_beams(
    rays: CameraRays, stretches: Sequence[Stretch], region: tuple[int, int, int, int], distance: float = 2.0
) -> np.ndarray:
    """(W, H) bool, pixels of a region x0, y0, x1, y1 whose middle is beside the image of a beam: there light
    that fog scatters twice is as bright as log(1/distance), which no polynomial follows.
    """
    x0, y0, x1, y1 = region
    x, y = np.arange(x0, x1)[:, None] + 0.5, np.arange(y0, y1) + 0.5
    near = np.zeros((x1 - x0, y1 - y0), bool)
    for s in stretches:
        near |= Outline(rays, s.start, s.direction, THINNEST, s.length).beside(x, y, distance)
    return near


class Outline:
    """Where in the picture a cylinder is: points of pixels that are spread over it alone."""

    def __init__(
        self,
        rays: CameraRays,
        origin: np.ndarray,
        axis: np.ndarray,
        radius: float,
        length: float = np.inf,
        points: np.ndarray | None = None,
    ) -> None:
        """origin : (3,) in the frame, where it begins. points : (3, M), only about these."""
        self._box = np.array([[-np.inf, np.inf]] * 2)
        if points is None and np.isfinite(length):
            side, other = (np.asarray(a, np.float64).ravel() for a in basis(axis[:, None]))
            corners = [
                origin + v * axis + radius * (i * side + j * other)
                for v in (0.0, length) for i in (-1, 1) for j in (-1, 1)
            ]  # fmt: skip
            points = np.array(corners).T
        if points is not None:
            with np.errstate(invalid="ignore", over="ignore"):
                place, depth = rays.image_of(points)
            if (depth > rays.clip_start / 2).all():
                low, high = place.min(axis=1), place.max(axis=1)
                margin = 0.03 * (high - low) + 1e-9
                self._box = np.stack([low - margin, high + margin], axis=1)
        self.bounded = bool(np.isfinite(self._box).all())
        self._edges = self._lines(rays, origin, axis, radius)

    def holds(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether places of the picture, in pixels, are within its box."""
        (left, right), (low, high) = self._box
        return (x >= left) & (x <= right) & (y >= low) & (y <= high)

    @staticmethod
    def _lines(rays: CameraRays, origin: np.ndarray, axis: np.ndarray, radius: float) -> np.ndarray | None:
        """(2, 3): of both outlines c, x, y, so that c + x X + y Y is above 0 within; None: everywhere."""
        corners = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
        start, towards = rays.exactly(*corners)
        if np.ptp(towards, axis=1).any():
            # From one point: planes through it that touch the cylinder.
            apart = origin - (origin @ axis) * axis
            distance = np.linalg.norm(apart)
            if not distance > radius * (1 + 1e-9):
                return None
            apart /= distance
            across = np.cross(axis, apart) @ towards
            ahead = (apart @ towards) * (radius / np.sqrt(distance**2 - radius**2))
        else:
            across = np.cross(axis, towards[:, 0])
            sine = np.linalg.norm(across)
            if not sine > 1e-9:
                return None
            across = (across / sine) @ (start - origin[:, None])
            ahead = np.full(3, radius)
        edges = np.stack([ahead - across, ahead + across])
        return np.stack([edges[:, 0], edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0]], axis=1)

    def beside(self, x: np.ndarray, y: np.ndarray, distance: float) -> np.ndarray:
        """Whether places of the picture, in pixels, are within ``distance`` of the image of the axis."""
        (left, right), (low, high) = self._box
        near = (x >= left - distance) & (x <= right + distance)
        near = near & (y >= low - distance) & (y <= high + distance)
        if self._edges is not None:
            c, along_x, along_y = (self._edges[0] - self._edges[1]) / 2
            near &= np.abs(c + along_x * x + along_y * y) <= distance * np.hypot(along_x, along_y)
        return near

    def touches(self, pixels: Pixels) -> np.ndarray:
        """Which of pixels may see the cylinder."""
        (left, right), (low, high) = self._box
        seen = (pixels.x + 1 > left) & (pixels.x < right) & (pixels.y + 1 > low) & (pixels.y < high)
        if self._edges is not None:
            for c, x, y in self._edges:
                # At the corner that lies furthest within.
                seen &= c + x * (pixels.x + (x > 0)) + y * (pixels.y + (y > 0)) > 0
        return np.flatnonzero(seen)

    def points(self, pixels: Pixels, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points (2, B, S) float64 of pixels that may see it, for u (2, B, S), and their weights (B, S)."""
        corner = np.stack([pixels.x, pixels.y]).astype(np.float64)
        first = np.clip(self._box[:, :1] - corner, 0, 1)
        last = np.clip(self._box[:, 1:] - corner, 0, 1)
        place = first[:, :, None] + u * (last - first)[:, :, None]
        weight = np.broadcast_to(np.prod(last - first, axis=0)[:, None], u[0].shape).copy()
        if self._edges is None:
            return place, weight
        # The axis along which the outlines run, and the one that they are functions of it on.
        c, slope = self._edges[:, :1] + self._edges[:, 1:] @ corner, self._edges[:, 1:]
        long = int(np.abs(slope).sum(axis=0).argmin())
        short = 1 - long
        rise, per = slope[:, long], slope[:, short]
        # One of them bounds from below, the other from above.
        if not per[0] * per[1] < 0 or (np.abs(per) < 0.3 * np.abs(rise)).any():
            return place, weight
        bottom, top = (0, 1) if per[0] > 0 else (1, 0)

        def edge(which: int, at: np.ndarray) -> np.ndarray:
            return -(c[which].reshape(-1, *([1] * (at.ndim - 1))) + rise[which] * at) / per[which]

        ends = np.stack([first[long], last[long]], axis=1)
        width = edge(top, ends) - edge(bottom, ends)
        thin = np.flatnonzero((width >= 0).all(axis=1) & (width < WIDE).all(axis=1))
        if thin.size == 0:
            return place, weight
        c, ends = c[:, thin], ends[thin]
        below, above = first[short, thin], last[short, thin]
        # Where top > below, and bottom < above: both are linear.
        for which, limit, sign in ((top, below, 1), (bottom, above, -1)):
            at = edge(which, ends) - limit[:, None]
            at *= sign
            step = at[:, 1] - at[:, 0]
            zero = ends[:, 0] - at[:, 0] * (ends[:, 1] - ends[:, 0]) / np.where(step == 0, 1, step)
            nothing = (at <= 0).all(axis=1)
            ends[:, 0] = np.where(
                (at[:, 0] < 0) & ~nothing, np.clip(zero, ends[:, 0], ends[:, 1]), ends[:, 0]
            )
            ends[:, 1] = np.where(
                (at[:, 1] < 0) & ~nothing, np.clip(zero, ends[:, 0], ends[:, 1]), ends[:, 1]
            )
            ends[nothing, 1] = ends[nothing, 0]
        t = ends[:, :1] + u[long][thin] * (ends[:, 1:] - ends[:, :1])
        under = np.maximum(edge(bottom, t), below[:, None])
        over = np.minimum(edge(top, t), above[:, None])
        size = np.maximum(over - under, 0)
        place[long][thin] = t
        place[short][thin] = under + u[short][thin] * size
        weight[thin] = size * (ends[:, 1:] - ends[:, :1])
        return place, weight
