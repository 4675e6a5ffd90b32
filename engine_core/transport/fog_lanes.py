# SPDX-License-Identifier: GPL-3.0-or-later
"""Segments of fog and lights without size, in pairs: all that the integrand is but for shadows.

A *lane* is a segment of one medium and a light. Its variable s in [0, 1] is one in which the integrand is
flat. About a light at distance D from the ray's line, with x along it from its foot on,

    w = x / (D + r) = tan(angle / 2),   dx / r^2 = 2 dw / ((1 + w^2) D),   s linear in w.

In m = 1 + w and p = 1 - w, which are found without cancellation, all is rational: r + x = D m / p,
r - x = D p / m, and the squared cosine of half the scattering angle is p^2 / (m^2 + p^2). What a lane's
exponents have in common is taken out of them; from its start on, x + r grows by 2 D dw s / (p p0).
For a sun, s is uniform in what the fog lets pass.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..geometry.raytracer import FAR
from ..geometry.vectors import dot, take
from ..integration.sobol import hash_combine, unit_float
from . import phase
from .bare_lights import SPOT, BareLights
from .fog_rays import FogRays
from .media import Media

DEEPEST = 24.0
"""Optical depth of a lane beyond which nothing is looked for: exp(-24) is 4e-11."""

PIECE = 6.0
"""Optical depth at which a deep lane is parted for quadrature."""

SHORT = 1 - 1e-4
"""Part of the way from a light to a point that must be free: then begins the surface that the point is on."""

_NEAREST = 1e-9
"""Distance of a light from the ray, as a part of the segment's range: none is taken to be nearer."""

_NEAR = 256.0
"""How far lights may be, in the frame's units, for rays to begin there: float32 has them end at the point."""

_TINY = 1e-300

GRAZING = (0.8, 4), (0.4, 8)
"""Pairs of points of a small spot that light a ray, where less than such a part of what they light of it is
lit by all."""


Look = Callable[[np.ndarray, np.ndarray, float, "np.ndarray | int"], np.ndarray]
"""Of origins and directions (N, 3), a reach in their lengths, and blockers (N,) or one for all, as of
`Links`: (1, N) bool whether nothing is in the way, or (3, N) float32 what part of each colour passes."""


@dataclass(eq=False)
class FogSegments:
    """K segments of fog, of some of N rays.

    ray : (K,) ascending. origin, direction : (3, K) float64, of the rays. start, end : (K,) float64.
    depth : (C, K) before the start. inside : (K,) bits. mixture : (K,) rows, or (1,) if all are the same, of
    sigma (C, R) extinction, scattering (G, 3, R), of those phase functions that are used, with anisotropy
    (G,), and of thinnest and densest (R,) extinction of the channels that scatter.
    bits : (K,) uint32, as if by chance, other ones of each camera ray. lamp : (2, K) in [0, 1), where on
    lights the rays have their points; None if ``bits`` are to say.
    """

    ray: np.ndarray
    origin: np.ndarray
    direction: np.ndarray
    start: np.ndarray
    end: np.ndarray
    depth: np.ndarray
    inside: np.ndarray
    mixture: np.ndarray
    sigma: np.ndarray
    scattering: np.ndarray
    anisotropy: np.ndarray
    thinnest: np.ndarray
    densest: np.ndarray
    through: np.ndarray | None
    bits: np.ndarray
    lamp: np.ndarray | None

    @staticmethod
    def of(
        rays: FogRays, ray: np.ndarray | None, media: Media, lamp: np.ndarray | None = None
    ) -> FogSegments:
        """Of rays (N,), None for all. lamp : (2, N), or None, as above."""
        segments, which = rays.segments(ray)
        found = rays.media
        sigma, scattering = media.extinction, media.scattering
        mixture = found.mixture[segments]
        if len(mixture) and (mixture == mixture[0]).all():
            # Of one row, tables need no look-up.
            sigma, scattering = sigma[:, mixture[:1]], scattering[:, :, mixture[:1]]
            mixture = np.zeros(1, np.intp)
        used = np.flatnonzero(scattering.any(axis=(1, 2)))
        scattering = scattering[used]
        colours = scattering.any(axis=0)
        wide = np.broadcast_to(sigma, colours.shape)
        origin, direction = rays.origin, rays.direction
        if not (ray is None and len(which) == len(rays)):
            own = found.ray[segments]
            origin, direction = take(origin, own), take(direction, own)
        bits = (origin + direction).view(np.uint64)
        return FogSegments(
            which, origin, direction, found.start[segments], found.end[segments], found.depth[:, segments],
            found.inside[segments], mixture, sigma, scattering, media.anisotropy[used],
            np.where(colours, wide, np.inf).min(axis=0), np.where(colours, wide, 0).max(axis=0),
            None if rays.through is None else rays.through[:, segments],
            hash_combine(*(bits ^ bits >> np.uint64(32))), None if lamp is None else take(lamp, which),
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.ray)


class Lanes(ABC):
    """n lanes of segments and lights.

    segment : (n,) row, light : (n,) row, or (1,) of the only light.
    breaks : (B, n) ascending places s between which the integrand is smooth.
    lit : (2, n), two of them outside of which it is next to nothing; None if that is not known.
    blockers : (n,) or (1,) what casts shadows, as of `Links`.
    shift : (n,) float32 in [0, 1), as if by chance, another one for each camera ray.
    turn : (n,) the same, how lanes of one ray and light are staggered; None if there is but one.
    several : (n,) how many pairs of lanes a ray and a light have; None if no more than one.
    """

    # What may have one entry for all lanes: these are not taken from then.
    _COMMON = frozenset(("light", "mixture", "sigma", "blockers"))

    def __init__(
        self, segments: FogSegments, lights: BareLights, media: Media, segment: np.ndarray, light: np.ndarray
    ) -> None:
        self._segments, self._lights, self._media = segments, lights, media
        self.segment, self.light = segment, light
        self.mixture = segments.mixture if len(segments.mixture) == 1 else segments.mixture.take(segment)
        self.sigma = take(segments.sigma, self.mixture)
        self.blockers = lights.blockers.take(light)
        self.breaks = np.zeros((0, len(segment)))
        self.lit: np.ndarray | None = None
        self.along = take(segments.direction, segment).astype(np.float32)
        self.shift = unit_float(segments.bits).take(segment)
        self.begin: np.ndarray | None = None
        self.several: np.ndarray | None = None
        self.turn: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.segment)

    def take(self, rows: np.ndarray) -> Lanes:
        """Lanes ``rows``."""
        part = object.__new__(type(self))
        for name, value in self.__dict__.items():
            if isinstance(value, np.ndarray) and not (name in self._COMMON and value.shape[-1] == 1):
                value = value.take(rows, axis=-1)
            part.__dict__[name] = value
        return part

    def _visible(self, look: Look, origin: np.ndarray, vector: np.ndarray, reach: float) -> np.ndarray:
        """(c, ..., n) of ``look`` along ``vector`` (..., n, 3) from ``origin``."""
        shape, blockers = origin.shape[:-1], self.blockers
        if len(blockers) == 1 or (blockers == blockers[0]).all():
            blockers = int(blockers[0])
        else:
            blockers = np.broadcast_to(blockers, shape).reshape(-1)
        rays = (np.ascontiguousarray(x.reshape(-1, 3)) for x in (origin, vector))
        found = look(*rays, reach, blockers)
        return found.reshape(len(found), *shape)

    def radiance(self, integrals: np.ndarray) -> np.ndarray:
        """(3, n) radiance that integrals (G, C, n) over s of `smooth` come to."""
        weighed = self.weight * integrals
        scattering = take(self._segments.scattering, self.mixture)
        total = scattering[0] * weighed[0]
        for sigma, one in zip(scattering[1:], weighed[1:], strict=True):
            total += sigma * one
        total *= take(self._lights.strength, self.light)
        if self._segments.through is not None:
            total *= take(self._segments.through, self.segment)
        return total

    @property
    @abstractmethod
    def weight(self) -> np.ndarray:
        """(C, n) float64, what integrals over s are multiplied with, besides scattering and strength."""

    @abstractmethod
    def smooth(self, s: np.ndarray) -> np.ndarray:
        """(G, C, n) the integrand at s (n,), or (G, C, Q, n) at s (Q, n) or (Q, 1)."""

    @abstractmethod
    def seen(self, s: np.ndarray, look: Look) -> np.ndarray:
        """(c, n) of ``look`` what of lights is seen from s (n,), or (c, Q, n) from s (Q, n) or (Q, 1)."""

    def _phases(self, value: np.ndarray, less: np.ndarray, more: np.ndarray) -> np.ndarray:
        """``value`` (C, ...) times each phase function."""
        gs = self._segments.anisotropy
        out = np.empty((len(gs), *value.shape), np.float32)
        for row, g in zip(out, gs, strict=True):
            np.multiply(value, phase.value(less, more, np.float32(g)) if g else phase.ISOTROPIC, out=row)
        return out

    def _legs(self, position: np.ndarray, to_light: np.ndarray, reach: float, rows: np.ndarray) -> np.ndarray:
        """(C, Q, K) optical depth along vectors (3, Q, K) from positions (3, Q, K) of lanes ``rows`` (K,)."""
        shape = position.shape[1:]
        inside = np.broadcast_to(self._segments.inside.take(self.segment.take(rows)), shape).reshape(-1)
        return self._media.optical_depth(_rows(position), _rows(to_light), reach, inside).reshape(-1, *shape)


class AboutPoints(Lanes):
    """Lanes to points and spots.

    is_cut : whether the first two of `_dimming` are where a spot's light begins and ends.
    """

    is_cut = False

    def __init__(self, segments: FogSegments, lights: BareLights, media: Media) -> None:
        origin, direction = segments.origin[:, None], segments.direction[:, None]
        # (L, K), as all of these.
        foot = lights.position[:, :, None] - origin
        at = dot(foot, direction)
        foot = at * direction - foot
        aside = np.maximum(np.sqrt(dot(foot, foot)), lights.nearest[:, None])
        # Next to a light with a size there is no peak to follow.
        distance = np.hypot(aside, lights.radius[:, None]) if lights.radius.any() else aside
        low, high = segments.start - at, segments.end - at
        closed = _closed(segments, lights, media)
        first, inner = low, []
        is_spot = (lights.kind == SPOT).any()
        if is_spot:
            # To the light's own space; what is outside of the cone, which is most, goes first.
            axes = -lights.axes.transpose(2, 0, 1)
            at_foot, along = ((axes @ v.swapaxes(0, -2)).swapaxes(0, 1) for v in (foot, segments.direction))
            all_of_it = at_foot
            if lights.back.any():
                all_of_it = at_foot.copy()
                all_of_it[2] += lights.back[:, None]
            low, high = within_cones(all_of_it, along, lights.below[:, None], low, high)
        thinnest = segments.thinnest.take(segments.mixture)
        high = np.where(high > low, _reached(low, high, distance, thinnest, closed), low)
        rows = np.flatnonzero(high > low)
        everything = len(rows) == low.size

        def flat(x):
            x = x.reshape(*x.shape[:-2], -1)
            return x if everything else x.take(rows, axis=-1)

        pairs = np.ones(1, np.intp)
        if is_spot and lights.several and lights.back.any():
            back, below = (np.repeat(x, low.shape[1]).take(rows) for x in (lights.back, lights.below))
            pairs = _pairs(flat(at_foot), flat(along), back, below, flat(low), flat(high))
            if (pairs > 1).any():
                rows, everything = np.repeat(rows, pairs), False
        light, segment = np.divmod(rows, low.shape[1])
        super().__init__(segments, lights, media, segment, light if len(lights) > 1 else light[:1])
        if len(rows) == 0:
            return
        if pairs.max() > 1:
            self.several = np.repeat(pairs, pairs)
            self._pair = np.arange(len(rows)) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        aside = flat(aside)
        foot, distance, low, high, begin = (flat(x) for x in (foot, distance, low, high, low + at))
        below, sharpness = (x.take(self.light) for x in (lights.below, lights.sharpness))
        if is_spot:
            at_foot, along = flat(at_foot), flat(along)
        distance = np.maximum(distance, np.maximum(_NEAREST * np.maximum(-low, high), _TINY))
        m0, p0 = _ends(low, distance)
        m1, p1 = _ends(high, distance)
        step = np.where(low > 0, p0 - p1, m1 - m0)
        self._closed = closed if isinstance(closed, bool) else flat(closed)
        length = np.where(self._closed, np.sqrt(low * low + distance * distance), 0)
        if is_spot:
            length += low - flat(first)
        self._weight = np.exp(-(take(segments.depth, segment) + length * self.sigma)) * (step / distance)
        if self.several is not None:
            self._weight /= self.several
        if is_spot and lights.whole.any():
            nearest, whole = (x.take(self.light) for x in (lights.nearest, lights.whole))
            part = np.clip((distance - nearest) / np.maximum(whole - nearest, _TINY), 0, 1)
            self._weight *= np.where(whole > 0, part * part * (3 - 2 * part), 1)
        self.sigma = self.sigma.astype(np.float32)
        self._foot, self._distance = foot.astype(np.float32), distance.astype(np.float32)
        self._cone = None
        if is_spot:
            self._cone = np.stack([at_foot, along]).astype(np.float32)
            self._below, self._sharpness = (
                np.broadcast_to(x, len(rows)).astype(np.float32) for x in (below, sharpness)
            )
        self._choose_points(aside)
        if is_spot:
            inner = self._dimming(at_foot, along, below, sharpness, low, high)
        self._set_breaks(inner, low, distance, m0, p0, step)
        self._far = lights.ahead or bool(np.abs(lights.position).max() > _NEAR)
        if self._far or not np.all(self._closed):
            self.begin = (take(segments.origin, segment) + take(segments.direction, segment) * begin).astype(
                np.float32
            )
        self._over_p, self._over_m = (distance * step / x for x in (p0, m0))
        self._m, self._p = np.stack([m0, m1]).astype(np.float32), np.stack([p0, p1]).astype(np.float32)
        self._over_p, self._over_m = self._over_p.astype(np.float32), self._over_m.astype(np.float32)

    @property
    def weight(self):
        return self._weight

    def _choose_points(self, aside: np.ndarray) -> None:
        """On lights, where these have a size. aside : (n,) distances of their centres from rays."""

    def _dimming(
        self,
        at_foot: np.ndarray,
        along: np.ndarray,
        below: np.ndarray,
        sharpness: np.ndarray,
        low: np.ndarray,
        high: np.ndarray,
    ) -> list[np.ndarray]:
        """Places x (n,) between which a spot's light is smooth, ``low`` for none: where it begins to dim,
        and of small ones, first of all, where there begins to be any.
        """
        begins, ends = within_cones(at_foot, along, below - 1 / sharpness, low, high)
        return [np.where(ends > begins, x, low) for x in (begins, ends)]

    def _set_breaks(self, inner, low, distance, m0, p0, step) -> None:
        """Parts lanes where spots begin to dim, and where so much is absorbed that a new piece is due.

        inner : of `_dimming`.
        """
        sigma = np.broadcast_to(self._segments.densest.take(self.mixture), low.shape)
        p1 = np.maximum(p0 - step, _TINY)
        depth = 2 * sigma * distance * step / (p0 * p1)
        if not np.all(self._closed):
            depth = np.where(self._closed, depth, depth / 2 * (1 + p0 * p1 / (m0 * (m0 + step))))
        places = list(inner)
        deep = depth > 1.5 * PIECE
        if deep.any():
            for part in (PIECE,) if self._media.grey else (PIECE, DEEPEST):
                at = np.where(self._closed, _place_of(low, distance, part / sigma), low + part / sigma)
                places.append(np.where(deep, at, low))
        if places:
            ends = (_ends(x, distance) for x in places)
            parts = [np.where(low > 0, p0 - p, m - m0) / step for m, p in ends]
            # In the thickest fog a lane may be too short to be parted: its places are 0 / 0.
            parts = np.clip(np.nan_to_num(parts), 0, 1)
            if inner and self.is_cut and self._lights.several:
                # Next to a light this is too rough.
                self.lit = parts[:2].copy()
            self.breaks = np.sort(parts, axis=0)

    def _at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """m, p and s as float32: sums of what is positive, so that no digit is lost."""
        s = s.astype(np.float32)
        rest = 1 - s
        m, p = self._m[0] * rest, self._p[0] * rest
        m += self._m[1] * s
        p += self._p[1] * s
        return m, p, s

    def smooth(self, s):
        m, p, s = self._at(s)
        more, less = p * p, m * m
        scale = 1 / (more + less)
        more *= scale
        less *= scale
        path = s / p
        path *= self._over_p
        open_ = np.zeros(0, np.intp) if self._closed is True else np.flatnonzero(~self._closed)
        if open_.size:
            ahead = path + self._over_m * s / m
            path = np.where(self._closed, 2 * path, ahead)
        else:
            path *= 2
        depth = columns(self.sigma, path.ndim) * path
        if open_.size:
            # (3, Q, K)
            along, foot = (take(x, open_)[:, None] for x in (self.along, self._foot))
            ahead, x = (take(y.reshape(-1, len(self)), open_) for y in (ahead, self._x(m, p)))
            position = take(self.begin, open_)[:, None] + along * ahead
            legs = self._legs(position, -(foot + along * x), 1.0, open_)
            depth.reshape(len(depth), -1, len(self))[:, :, open_] += legs
        np.negative(depth, out=depth)
        value = np.exp(depth, out=depth)
        scale *= 4
        if self._cone is not None:
            scale *= self._attenuation(m, p)
        value *= scale
        return self._phases(value, less, more)

    def _x(self, m: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Distances along the ray from the foot."""
        x = m - p
        x /= m * p
        x *= self._distance
        return x

    def _attenuation(self, m: np.ndarray, p: np.ndarray) -> np.ndarray:
        """Of spots: smoothstep of the cosine to the axis, by 1 - cos, which keeps its digits."""
        x = self._x(m, p)
        return self._smoothstep(*(at_foot + along * x for at_foot, along in zip(*self._cone, strict=True)))

    def _smoothstep(self, u: np.ndarray, v: np.ndarray, z: np.ndarray) -> np.ndarray:
        """The same of places (u, v, z) in the lights' own spaces."""
        across = u * u + v * v
        size = np.sqrt(across + z * z)
        below = across / np.maximum(size * (size + z), np.float32(1e-37))
        t = np.clip((self._below - below) * self._sharpness, 0, 1)
        return t * t * (3 - 2 * t)

    def seen(self, s, look):
        m, p, s = self._at(s)
        x = self._x(m, p)
        vector, origin = np.empty((2, *x.shape, 3), np.float32)
        for i in range(3):
            np.multiply(x, self.along[i], out=vector[..., i])
            vector[..., i] += self._foot[i]
        reach = SHORT
        if self._far:
            ahead = self._over_p * s / p + self._over_m * s / m
            for i in range(3):
                origin[..., i] = self.begin[i] + self.along[i] * ahead
            np.negative(vector, out=vector)
            reach = 1.0
        else:
            lights = self._lights.position.T.astype(np.float32)
            origin[:] = lights[0] if len(lights) == 1 else lights.take(self.light, axis=0)
        return self._visible(look, origin, vector, reach)


class TowardsSuns(Lanes):
    """Lanes to suns."""

    def __init__(self, segments: FogSegments, lights: BareLights, media: Media) -> None:
        light, segment = np.divmod(np.arange(len(lights) * len(segments)), len(segments))
        super().__init__(segments, lights, media, segment, light)
        least = np.broadcast_to(segments.thinnest.take(self.mixture), len(segment))
        length = (segments.end - segments.start).take(segment)
        passed = -np.expm1(-np.minimum(least * length, DEEPEST))
        self._weight = np.exp(-take(segments.depth, segment).astype(np.float64)) * (passed / least)
        along = take(segments.direction, segment)
        begin = take(segments.origin, segment) + along * segments.start.take(segment)
        towards = self._directions()
        less, more = phase.half_angle(-towards, -along)
        self._passed, self._least, self.begin, self._towards, self._less, self._more = (
            x.astype(np.float32) for x in (passed, least, begin, towards, less, more)
        )
        self._further = (self.sigma - least).astype(np.float32)

    @property
    def weight(self):
        return self._weight

    def _directions(self) -> np.ndarray:
        """(3, n) float64, unit."""
        return take(self._lights.position, self.light)

    def _place(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Distances from the lanes' start (Q, n), and positions (3, Q, n), at s (Q, n) or (Q, 1)."""
        t = -np.log1p(-s.astype(np.float32) * self._passed) / self._least
        return t, self.begin[:, None] + self.along[:, None] * t

    def smooth(self, s):
        if s.ndim == 1:
            return self.smooth(s[None])[:, :, 0]
        t, position = self._place(s)
        towards = np.broadcast_to(self._towards[:, None], position.shape)
        depth = self._legs(position, towards, np.inf, np.arange(len(self)))
        return self._phases(np.exp(-(depth + self._further[:, None] * t)), self._less, self._more)

    def seen(self, s, look):
        if s.ndim == 1:
            return self.seen(s[None], look)[:, 0]
        _, position = self._place(s)
        towards = np.broadcast_to(self._towards[:, None], position.shape)
        return self._visible(look, np.moveaxis(position, 0, -1), np.moveaxis(towards, 0, -1), FAR)


def _rows(a: np.ndarray) -> np.ndarray:
    """(N, 3) float32, contiguous, of (3, ...)."""
    return np.ascontiguousarray(a.reshape(3, -1).T, np.float32)


def columns(a: np.ndarray, ndim: int) -> np.ndarray:
    """(C, n) as (C, ..., n), to go with arrays of ``ndim`` dimensions."""
    return a.reshape(len(a), *(1,) * (ndim - 1), a.shape[-1])


def _ends(x: np.ndarray, distance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """1 + w and 1 - w of w = x / (D + r), each to all its digits."""
    root = np.sqrt(distance * distance + x * x)
    far = root + np.abs(x)
    near = distance * distance / far
    scale = 1 / (distance + root)
    large, small = (distance + far) * scale, (distance + near) * scale
    ahead = x >= 0
    return np.where(ahead, large, small), np.where(ahead, small, large)


def _place_of(low: np.ndarray, distance: np.ndarray, further: np.ndarray) -> np.ndarray:
    """The x at which x + r is ``further`` than at ``low``."""
    square = distance * distance
    root = np.sqrt(square + low * low)
    whole = np.where(low > 0, low + root, square / np.maximum(root - low, _TINY)) + further
    return (whole - square / np.maximum(whole, _TINY)) / 2


def _closed(segments: FogSegments, lights: BareLights, media: Media) -> np.ndarray | bool:
    """(L, K) whether the way to the light stays in the segment's own fog; True if all do."""
    if media.bodies == 0:
        return True
    if not media.convex:
        return np.zeros((len(lights), len(segments)), bool)
    every = np.uint64((1 << media.bodies) - 1)
    closed = (lights.state == every)[:, None] & (segments.inside == every)
    return True if closed.all() else closed


def _reached(low, high, distance, sigma, closed) -> np.ndarray:
    """Ends of lanes (L, K), no further than from where next to nothing comes."""
    if not ((high - low) * (2 * sigma) > DEEPEST).any():
        return high
    further = DEEPEST / sigma
    at = np.where(closed, _place_of(low, distance, further), low + further)
    return np.minimum(high, at)


def _pairs(
    at_foot: np.ndarray,
    along: np.ndarray,
    back: np.ndarray,
    below: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
) -> np.ndarray:
    """(n,) int, pairs of points of a spot that a ray looks from; as `within_cones`, and ``back`` of lights.

    The mean of two opposite chords of a circle that moves differs by (1 - part)^2 / 8 from the chord of the
    one in the middle, with the part of the longest chord that is common to all.
    """
    common = at_foot.copy()
    common[2] -= back
    begins, ends = within_cones(common, along, below, low, high)
    part = np.maximum(ends - begins, 0) / (high - low)
    pairs = np.ones(len(part), np.intp)
    for most, count in GRAZING:
        pairs[part < most] = count
    return pairs


def within_cones(
    at_foot: np.ndarray, along: np.ndarray, below: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """From where to where, between ``low`` and ``high`` (...), lines are in cones about z; never if the
    second
    is not above the first.

    at_foot, along : (3, ...) of lines, in the lights' own spaces. below : 1 - cosine of half the cone's
    angle.

    A place is on the cone where z^2 = cos^2 |v|^2, with v the vector from the light and z along its axis,
    which is quadratic in x. A cone of at most a half space is convex: what is in it is in one piece.
    """
    # sin^2 z^2 - cos^2 (|v|^2 - z^2) = alpha x^2 + 2 beta x + gamma
    sine = below * (2 - below)
    gamma, beta, alpha = (
        sine * (a[2] * b[2]) - (1 - sine) * (a[0] * b[0] + a[1] * b[1])
        for a, b in ((at_foot, at_foot), (at_foot, along), (along, along))
    )
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        q = -(beta + np.copysign(np.sqrt(np.maximum(beta * beta - alpha * gamma, 0)), beta))
        roots = [np.clip(np.where(np.isnan(r), low, r), low, high) for r in (q / alpha, gamma / q)]
    cuts = [low, np.minimum(*roots), np.maximum(*roots), high]
    begin, end = high, low
    for a, b in zip(cuts[:-1], cuts[1:], strict=True):
        x = 0.5 * (a + np.minimum(b, a + 1e30))
        inside = (at_foot[2] + along[2] * x > 0) & ((alpha * x + 2 * beta) * x + gamma >= 0)
        inside &= (b > a) & (below > 0)
        begin = np.where(inside, np.minimum(begin, a), begin)
        end = np.where(inside, np.maximum(end, b), end)
    return begin, end
