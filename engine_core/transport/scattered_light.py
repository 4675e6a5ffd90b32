# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of any lights that fog scatters once, a point at a time.

The maps along rays are in `distance_maps`, those on lights in `emitters`. Where a ray runs through several
fogs, the distance's dimension chooses among the segments first. Lights without size need no dimension but
the distance, and `ray_rule` integrates that.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.raytracer import FAR
from ..geometry.surfaces import NONE_CAST
from ..geometry.vectors import dot, inverse_length, take
from ..integration.sobol import digital_shift
from . import phase
from .camera_hits import Pixels
from .direct_light import CROSSING, SHADOW, _inset
from .distance_maps import (
    DistanceMap,
    EquiAngular,
    FreePath,
    Tabulated,
    UntruncatedPath,
    within_depth,
)
from .fog_rays import FogRays
from .guide import DIMENSIONS, Guide
from .light_choice_in_fog import FogChoice, segments
from .media import RayMedia
from .single_scattering import Places, Scattered, SingleScattering, run

_STEPS = 8
"""Of the table by which "auto" follows extinction and phase function between a light's angles."""

_AT_ONCE = 1 << 19
"""Points of all lights at once, about."""

_LOOKED_AT = 256
"""Lights, about, that stand for all where nothing but the rough brightness is wanted."""


def in_cone(
    apex: np.ndarray, axis: np.ndarray, cos: np.ndarray, origin: np.ndarray, direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """From where to where (P,) rays (3, P) are in cones of at most half of space; never if last < first."""
    vector = apex - origin
    foot = dot(vector, direction)
    slope = dot(axis, direction)
    # At the foot, along the axis.
    height = foot * slope - dot(axis, vector)
    beside = vector - foot * direction
    a = slope * slope - cos * cos
    a = np.copysign(np.maximum(np.abs(a), 1e-15), a)
    radicand = height * height + dot(beside, beside) * a
    root = cos * np.sqrt(np.maximum(radicand, 0))
    one, other = (-height * slope - root) / a, (-height * slope + root) / a
    wide = a > 0
    first = np.where(wide, np.where(slope > 0, other, -1e30), np.minimum(one, other))
    last = np.where(wide, np.where(slope > 0, 1e30, one), np.maximum(one, other))
    never = ~wide & ((radicand < 0) | (height <= 0))
    return np.where(never, 1e30, foot + first), np.where(never, -1e30, foot + last)


def _cosine_to_edge(cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """Of the least angle between a direction and those to a light: 1 where it is one of them.

    cosine : of the angle to the light's centre. sine : of half the angle that the light fills.
    """
    sine = np.minimum(sine, np.float32(1))
    half = np.sqrt(1 - sine * sine)
    edge = cosine * half
    edge += np.sqrt(np.maximum(1 - cosine * cosine, 0)) * sine
    edge[cosine > half] = 1
    return np.minimum(edge, 1, out=edge)


class ScatteredLight(Scattered):
    """Light of any lights: one point of a camera ray, and one of each light or of one of many, at a time.

    guide : of these lights, where all are sampled and it is known; None for none.
    """

    def __init__(
        self,
        scattering: SingleScattering,
        lights: np.ndarray,
        choice: FogChoice | None = None,
        check: Callable[[], None] = lambda: None,
        by_phase: np.ndarray | None = None,
        shifted: bool = False,
    ) -> None:
        """choice : among the lights (`SingleScattering.choice_of_cells`); None samples them all.
        by_phase : (L,) of all lights, as of `SingleScattering.shares_of_phase`; None for none.
        shifted : whether each of all lights has the points of a net otherwise (`digital_shift`), so that
        errors of those that are alike even out. A polynomial would not follow what is cut up so.
        """
        super().__init__(scattering, lights, check)
        self._choice, self._shifted = choice, shifted and len(lights) > 1
        # A share that went with the place would make a point follow another technique in the next pixel.
        self._by_phase = np.zeros(len(scattering.lights), np.float32) if by_phase is None else by_phase
        self.guide: Guide | None = None
        scene = scattering.lights
        self._number = None if len(scene) == 1 else self._lights
        pieces = scene.chooses_piece and np.isin(lights, scattering.of_mesh).any()
        self.rest_dimensions = 4 if choice is not None or pieces else 3

    def first(self, pixels: Pixels, u: np.ndarray) -> FogRays:
        rays = super().first(pixels, u)
        by_cells = self._choice is not None and self._choice.cells is not None
        if self.guide is not None or by_cells:
            corner = np.stack([pixels.x, pixels.y])
            place = (corner[:, :, None] + u[:2]).reshape(2, -1)
            rays.place = place if rays.lane is None else take(place, rays.lane)
        if self.guide is not None:
            rays.tiles = self.guide.tiles(*rays.place)
        return rays

    def unshadowed(self, rays: FogRays, count: int) -> np.ndarray:
        """(count,) float64 estimates, in some unit, of what so many camera rays bring if nothing is shaded.

        By the integral that chooses among lights (thesis eq. 6.5; `light_choice_in_fog`), within some tens of
        per cent; of many lights by some. 0 of rays that meet no fog, and outside of all cones.
        """
        scattering, media = self._scattering, rays.media
        where = self._where(rays, media.ray, np.arange(len(media.ray)))
        lights = self._lights[:: -(-len(self._lights) // _LOOKED_AT)]
        found = scattering.cones.irradiance_of_all(*where, lights, self._check)
        found *= scattering.media.scattering.mean(axis=(0, 1)).take(media.mixture)
        found *= np.exp(-media.depth.min(axis=0))
        ray = media.ray if rays.lane is None else rays.lane.take(media.ray)
        return np.bincount(ray, found, count)

    def rest(self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self._check()
        split, u = (u.shape[2] if lane is None else run(lane)), _inset(u).reshape(len(u), -1)
        ray = np.arange(len(rays)) if lane is None else lane[::split]
        if u.shape[1] == 0 or len(self._lights) == 0:
            return np.zeros(0, np.intp), np.zeros((3, 0), np.float32)
        if len(rays.media.ray) > len(rays) or self._choice is not None:
            # Each point has a segment, or a light, of its own.
            ray, split = np.repeat(ray, split), 1
        if self._choice is not None:
            which, values = self._scattered(rays, ray, None, u, split)
            return which, self._bounded(values)
        lit, parts = self.lit_rays(rays), []
        for number, some in rays.lit.items():
            lit[np.searchsorted(self._lights, number)] &= some
        step = max(1, _AT_ONCE // (len(self._lights) * split))
        for low in range(0, len(ray), step):
            some = ray[low : low + step]
            points = u[:, low * split : (low + step) * split]
            which, values = self._scattered(rays, some, lit.take(some, axis=1), points, split)
            parts.append((which + low * split, values))
        if len(parts) == 1:
            which, values = parts[0]
        else:
            which, values = (np.concatenate(a, axis=-1) for a in zip(*parts, strict=True))
        return which, self._bounded(values)

    def _scattered(
        self, rays: FogRays, ray: np.ndarray, lit: np.ndarray | None, u: np.ndarray, split: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which (J,) of N points get radiance (3, J), at u (D, N), ``split`` in a row of each ray (R,).

        lit : (L, R) bool, by which lights, as far as is known; None if one is chosen.
        """
        weight = None
        if lit is not None:
            number, row = np.nonzero(lit)
            light = self._lights.take(number)
            which = (row[:, None] * split + np.arange(split)).ravel()
            own = take(u, which)
            if self._shifted:
                own = digital_shift(own, np.repeat(number, split))
            w, at = own[-1], own[:DIMENSIONS]
            if rays.tiles is not None:
                weight, of_ray = np.ones(len(which), np.float32), np.repeat(ray, split)
                bounds = np.searchsorted(number, np.arange(len(self._lights) + 1)) * split
                for one in self.guide.gaining:
                    part = slice(bounds[one], bounds[one + 1])
                    place = at[: self.guide.dimensions, part]
                    place[:], weight[part] = self.guide.stretched(
                        one, rays.tiles, of_ray.take(which[part]), place
                    )
            place = self._segment(rays, ray.take(row), light, at[0].reshape(-1, split))
            ray = ray.take(row)
        else:
            cell, w = None, u[3]
            if rays.place is not None:
                cell, w = self._choice.cells.drawn(take(rays.place, ray), w)
                # A cell at a time.
                order = np.argsort(cell, kind="stable")
                cell, w, ray, u = cell.take(order), w.take(order), ray.take(order), take(u, order)
            place = self._segment(rays, ray, None, u[0][:, None])
            light, of_light, w = self._choice.choose(self._where(rays, ray, place.row), cell, w[:, None])
            place.chance *= of_light
            which = np.argsort(light, kind="stable")
            ray, light, w, place = ray.take(which), light.take(which), w.take(which), place.take(which)
            at = take(u[:DIMENSIONS], which)
            if cell is not None:
                which = order.take(which)
        parts = []
        for t, density in self._distances(rays, ray, light, place):
            density *= place.chance[:, None]
            each = (np.repeat(x, split) for x in (ray, light, place.row))
            parts.append(self._arriving(rays, *each, t.reshape(-1), density.reshape(-1), at[1:], w))
            if weight is not None:
                rows, values = parts[-1]
                values *= weight.take(rows)
        if len(parts) == 1:
            rows, values = parts[0]
            return which.take(rows), values
        return (
            np.concatenate([which.take(rows) for rows, _ in parts]),
            np.concatenate([values for _, values in parts], axis=1),
        )

    def _where(self, rays: FogRays, ray: np.ndarray, row: np.ndarray):
        """Segments ``row`` (N,) as the choice among lights takes them."""
        thinnest, media = self._scattering.thinnest, rays.media
        ends = media.start.take(row), media.end.take(row), thinnest.take(media.mixture.take(row))
        return segments(take(rays.origin, ray), take(rays.direction, ray), *ends, thinnest[0])

    def _distances(
        self, rays: FogRays, ray: np.ndarray, light: np.ndarray, place: Places
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Distances (P, S) in segments, and densities (P, S), of each technique that is summed."""
        scattering, media = self._scattering, rays.media
        mixture = media.mixture.take(place.row)
        sigma = scattering.thinnest.take(mixture)[:, None]
        length = (media.end - media.start).take(place.row)
        sampling = scattering.sampling
        if sampling == "free_path_untruncated":
            path = UntruncatedPath(sigma, length[:, None])
            t = path.sample(place.u)
            return [(t, path.pdf(t))]
        low, high = self._lit(rays, ray, light, media.start.take(place.row), length)
        length = within_depth(sigma, (high - low)[:, None])

        def one(*maps: DistanceMap):
            samples = [m.sample(place.u) for m in maps]
            # The balance heuristic divides by the sum of all densities (thesis eq. 6.7, 6.8).
            return [(t + low[:, None], sum(m.pdf(t) for m in maps)) for t in samples]

        path = FreePath(sigma, length)
        if sampling == "free_path":
            return one(path)
        foot, distance, finite = self._around(rays, ray, light, place.row)
        if not finite.any():
            return one(path)
        about = EquiAngular((foot - low)[:, None], distance[:, None], length)
        if sampling == "mis":
            found = one(about, path)
        elif sampling == "equiangular":
            found = one(about)
        else:
            found = one(Tabulated(about, self._falling_off(about, place.row, media, light)))
        if finite.all():
            return found
        # Of what is infinitely far, free paths alone; a second technique finds nothing more there.
        ((t, density),) = one(path)
        finite = finite[:, None]
        for i, (near, near_density) in enumerate(found):
            found[i] = np.where(finite, near, t), np.where(finite, near_density, np.inf if i else density)
        return found

    def lit_rays(self, rays: FogRays) -> np.ndarray:
        """(L, R) bool, whether rays' fog meets the cones that lights shine in."""
        media, every = rays.media, np.arange(len(rays))
        lit = np.ones((len(self._lights), len(rays)), bool)
        if len(self._lights) == 1 or len(rays) == 0:
            return lit
        start, end = media.start.take(rays.first[:-1]), media.end.take(rays.first[1:] - 1)
        # One at a time, as there may be many rays.
        for number in np.flatnonzero(self._scattering.cones.coned.take(self._lights)):
            first, last = self._in_cones(rays, every, np.full(len(rays), self._lights[number]))
            lit[number] = np.minimum(last, end) > np.maximum(first, start)
        return lit

    def _in_cones(self, rays: FogRays, ray: np.ndarray, light: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As `in_cone`, of lights' cones, a little wider."""
        cones = self._scattering.cones
        first, last = in_cone(
            *(take(x, light).astype(np.float64) for x in (cones.apex, cones.axis, cones.cos)),
            take(rays.origin, ray),
            take(rays.direction, ray),
        )
        margin = 1e-6 * (np.abs(first) + np.abs(last))
        return first - margin, last + margin

    def _lit(
        self, rays: FogRays, ray: np.ndarray, light: np.ndarray, start: np.ndarray, length: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """From where to where (P,), from their start on, segments are in cones of spots and area lights."""
        cones = self._scattering.cones
        low, high = np.zeros(len(ray)), length
        rows = np.flatnonzero(cones.coned.take(light))
        if rows.size == 0:
            return low, high
        light, ray = light.take(rows), ray.take(rows)
        first, last = (
            np.clip(x - start.take(rows), 0, length.take(rows)) for x in self._in_cones(rays, ray, light)
        )
        some = np.flatnonzero(last > first)
        high = high.copy()
        low[rows[some]], high[rows[some]] = first[some], last[some]
        return low, high

    def _falling_off(
        self, about: EquiAngular, row: np.ndarray, media: RayMedia, light: np.ndarray
    ) -> np.ndarray:
        """(steps + 1, P, 1) extinction and phase function at even steps of the angle, the largest about 1."""
        scattering = self._scattering
        x, t = about.steps(_STEPS)
        # Squares of what is next to nothing are 0, and there would be no direction to the light.
        r = np.sqrt(np.maximum(about.distance.astype(np.float32) ** 2 + x * x, np.finfo(np.float32).tiny))
        mixture = media.mixture.take(row)
        sigma = scattering.thinnest.astype(np.float32).take(mixture)
        same = scattering.light_state.take(light) == media.inside.take(row)
        leg = np.where(same, sigma, np.float32(scattering.thinnest[0])) * ~scattering.clear.take(light)
        depth = sigma[:, None] * t + leg[:, None] * r
        depth -= depth.min(axis=0)
        factor = np.exp(-depth)
        g = scattering.anisotropy.astype(np.float32).take(mixture)[:, None]
        if g.any():
            reach = scattering.lights.reach.take(light).astype(np.float32)
            # Of its centre, and of where it is brightest.
            g, ahead = np.abs(g), -x / r * np.copysign(np.float32(1), g)
            edge = _cosine_to_edge(ahead, reach[:, None] / r)
            of_edge = phase.value((1 - edge) / 2, (1 + edge) / 2, g)
            factor *= phase.value((1 - ahead) / 2, (1 + ahead) / 2, g) + of_edge
            factor /= factor.max(axis=0)
        return factor

    def _arriving(
        self,
        rays: FogRays,
        ray: np.ndarray,
        light: np.ndarray,
        row: np.ndarray,
        t: np.ndarray,
        density: np.ndarray,
        u: np.ndarray,
        w: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which (J,) of P samples at distances t (P,) in segments get radiance (3, J)."""
        scattering, media, fog = self._scattering, rays.media, self._scattering.media
        lights = scattering.lights
        length = (media.end - media.start).take(row)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            chance = 1 / density
            far = np.minimum(t, length)
            mixture = media.mixture.take(row)
            passed = np.exp(-(take(media.depth, row) + take(fog.extinction, mixture) * far))
            passed *= np.where(t <= length, chance, 0)
        direction = take(rays.direction, ray)
        position = take(rays.origin, ray) + direction * (media.start.take(row) + far)
        number = None if len(lights) == 1 else light
        to_light, weight, at_infinity = self._towards(
            number, position, direction, scattering.anisotropy.take(mixture), u, w
        )
        passed = passed * weight
        lit = np.flatnonzero(passed.any(axis=0))
        if lit.size < len(ray):
            ray, light, row, mixture, w = (x.take(lit) for x in (ray, light, row, mixture, w))
            direction, position, to_light, passed = (
                take(x, lit) for x in (direction, position, to_light, passed)
            )
            at_infinity = at_infinity if np.ndim(at_infinity) == 0 else at_infinity.take(lit)
            number = None if number is None else light
        less, more = phase.half_angle(to_light * inverse_length(to_light), direction)
        scattered = np.zeros((3, len(ray)))
        for sigma, g in zip(fog.scattering, fog.anisotropy, strict=True):
            if sigma.any():
                scattered += take(sigma, mixture) * (phase.value(less, more, g) if g else phase.ISOTROPIC)
        scattered *= passed
        scattered *= lights.strength_in_space(number, position, to_light, w)
        if rays.through is not None:
            scattered *= take(rays.through, row)
        arrive, part = self._passing(position, to_light, at_infinity, light)
        scattered = take(scattered, arrive)
        if part is not None:
            scattered *= part
        origins, directions = (
            np.ascontiguousarray(take(x, arrive).T, np.float32) for x in (position, to_light)
        )
        reach = np.where(np.broadcast_to(at_infinity, len(ray)).take(arrive), np.inf, 1)
        reach = np.where(scattering.clear.take(light.take(arrive)), 0, reach)
        depth = fog.optical_depth(origins, directions, reach, media.inside.take(row.take(arrive)))
        scattered *= np.exp(-depth)
        return lit.take(arrive), scattered

    def _towards(
        self,
        light: np.ndarray | None,
        position: np.ndarray,
        direction: np.ndarray,
        g: np.ndarray,
        u: np.ndarray,
        w: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | bool]:
        """As `SceneLights.sample_in_space`; of wide lights, part of the directions follow phase functions of
        anisotropies g (K,) about those of rays (3, K), by the balance heuristic.
        """
        lights, shares = self._scattering.lights, self._by_phase
        share = shares.take(self._lights[:1] if light is None else light)
        if not share.any():
            return lights.sample_in_space(light, position, u, w)
        share = np.broadcast_to(share, len(g))
        by_phase, u = u[0] < share, u.copy()
        u[0] -= np.where(by_phase, 0, share)
        u[0] /= np.where(by_phase, share, 1 - share)
        to_light, weight, at_infinity = lights.sample_in_space(light, position, u, w)
        rows = np.flatnonzero(by_phase)
        if rows.size:
            unit = phase.sample(take(direction, rows), g.take(rows), take(u, rows))
            number = None if light is None else light.take(rows)
            to_light[:, rows], weight[rows] = lights.met_in_space(number, take(position, rows), unit)
        rows = np.flatnonzero(share)
        number = None if light is None else light.take(rows)
        vector, share, along = take(to_light, rows), share.take(rows), take(direction, rows)
        of_light = lights.density_in_space(number, take(position, rows), vector, w.take(rows))
        less, more = phase.half_angle(vector * inverse_length(vector), along)
        density = share * phase.value(less, more, g.take(rows)) + (1 - share) * of_light
        weight[rows] *= np.where(by_phase.take(rows), 1, of_light) / density
        return to_light, weight, at_infinity

    def _passing(self, position, to_light, at_infinity, light) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of shadow rays arrive, and what part (3, J) surfaces leave of them, None for all."""
        scattering = self._scattering
        blockers = scattering.lights.links.casting(light)
        casts = np.broadcast_to(blockers != NONE_CAST, len(light))
        rows = np.arange(len(light)) if casts.all() else np.flatnonzero(casts)
        blockers = blockers if np.ndim(blockers) == 0 else blockers.take(rows)
        origins, directions = (
            np.ascontiguousarray(take(x, rows).T, np.float32) for x in (position, to_light)
        )
        reach = np.where(at_infinity, FAR, 1).astype(np.float32)
        reach = float(reach) if reach.ndim == 0 else reach.take(rows)
        arrive, part, crossings = scattering.shadows.passing(origins, directions, reach, blockers)
        self._count(SHADOW, len(rows))
        if scattering.surfaces.any_transparent:
            self._count(CROSSING, crossings)
        if len(rows) == len(light):
            return arrive, part
        whole = np.ones((3, len(light)))
        whole[:, rows] = 0
        whole[:, rows.take(arrive)] = 1 if part is None else part
        arrive = np.flatnonzero(whole.any(axis=0))
        return arrive, take(whole, arrive)
