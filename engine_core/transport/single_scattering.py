# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters once, towards the camera, as a staged function of primary space.

    first : (screen 2, lens 2 if it has a size) -> camera rays, and the fog that they run through
    rest  : (distance 1, light 2, light choice 1) -> radiance scattered at one point of each ray

    L = integral along the ray of T(t) sum_lights sigma_s p(cos) fluence V T_light dt     (thesis eq. 6.1)

The maps along rays are in `distance_maps`, those on lights in `emitters`. Where a ray runs through several
fogs, the distance's dimension chooses among the segments first. Lights without size need no dimension but
the distance, and `ray_rule` integrates that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Lock

import numpy as np

from ..geometry.frame import Frame
from ..geometry.raytracer import FAR
from ..geometry.surfaces import SHORTFALL, Surfaces
from ..geometry.vectors import dot, inverse_length, take
from ..settings import Settings
from ..shading.terms import LARGEST
from . import phase
from .camera_hits import Pixels
from .camera_rays import CameraRays
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW, _bound, _inset
from .distance_maps import (
    DistanceMap,
    EquiAngular,
    FreePath,
    Tabulated,
    UntruncatedPath,
    within_depth,
)
from .emitters import PointEmitters, SunEmitters
from .guide_in_fog import DIMENSIONS, Guide, stretched
from .light_choice import CELL, WEIGHED, pilot_points
from .light_choice_in_fog import AirLights, FogChoice, fog_clusters, segments
from .light_samples import SceneLights
from .media import Media, RayMedia
from .shadows import Shadows
from .surface_shading import SurfaceShader

EVERY = 8
"""Lights up to which all are sampled, and summed."""

_STEPS = 8
"""Of the table by which "auto" follows extinction and phase function between a light's angles."""


@dataclass(eq=False)
class FogRays:
    """The first stage's result for N camera rays, M of which run through fog.

    values : None, as nothing is known without another dimension. lane : (M,) ascending; None for all N.
    origin, direction : (3, M) float64, unit directions.
    media : K segments, whose ``ray`` counts the M rays. first : (M + 1,) where those of each ray begin.
    through : (3, K) float32, what transparent surfaces before a segment leave of it; None for all.
    cell : (M,) ascending rows of the tile's light choice; None where that knows no cells.
    knots : (M, L, D, K) of a `Guide`; None without one.
    crossings : rays that went on behind transparent surfaces.
    """

    origin: np.ndarray
    direction: np.ndarray
    media: RayMedia
    first: np.ndarray
    lane: np.ndarray | None = None
    through: np.ndarray | None = None
    cell: np.ndarray | None = None
    knots: np.ndarray | None = None
    crossings: int = 0
    values: None = field(default=None, init=False)

    def __len__(self) -> int:
        return self.origin.shape[1]

    def segments(self, ray: np.ndarray | None) -> tuple[np.ndarray | slice, np.ndarray]:
        """The segments of rays (N,), one ray after another, and which of these N each is of; None for all."""
        if ray is None:
            return slice(None), self.media.ray
        start = self.first.take(ray)
        count = self.first.take(ray + 1) - start
        which = np.repeat(np.arange(len(ray)), count)
        return np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count) + start.take(which), which


class SingleScattering:
    """What all estimates of light scattered once share, and all threads.

    screen_dimensions : 2 of a pixel, and 2 of a lens.
    sizeless, sized : numbers of the lights without size, which `ray_rule` takes, and of all others, but
        for those that no fog gets light of.
    """

    def __init__(
        self,
        frame: Frame,
        media: Media,
        lights: SceneLights,
        surfaces: Surfaces,
        shader: SurfaceShader,
        rays: CameraRays,
        settings: Settings,
    ) -> None:
        self.frame, self.media, self.lights, self.surfaces = frame, media, lights, surfaces
        self.rays, self.sampling = rays, settings.distance_sampling
        self._shader, self._crossings = shader, settings.transparent_bounces
        self.shadows = Shadows(surfaces, shader, settings.transparent_bounces)
        self.screen_dimensions = rays.dimensions
        bare = np.zeros(len(lights), bool)
        for group, start, stop in zip(lights.groups, lights.first[:-1], lights.first[1:], strict=True):
            if isinstance(group, PointEmitters | SunEmitters):
                bare[start:stop] = group.size == 0
        # Whole rays know but light and dark: where shadows are coloured, points are sampled.
        bare &= not surfaces.any_transparent
        # What is infinitely far is behind a fog that fills all space.
        reaches = np.isfinite(lights.reach) | ~(media.extinction[:, 0] > 0).all()
        self.sizeless, self.sized = np.flatnonzero(bare & reaches), np.flatnonzero(~bare & reaches)
        self.cones = AirLights(lights)
        # Of each light's middle, inside which fogs it is.
        self.light_state = np.zeros(len(lights), np.uint64)
        if media.bodies and len(lights):
            origins = np.ascontiguousarray(lights.centre.T, np.float32)
            self.light_state = media.along(origins, np.eye(1, 3, dtype=np.float32), 1e-6).state

    def first(self, pixels: Pixels, u: np.ndarray) -> FogRays:
        """Camera rays through points (2, B, S) of pixels' unit squares; (4, B, S) with those of a lens."""
        origins, directions = self.rays.rays(pixels.x, pixels.y, u)
        rays = self._in_fog(origins, directions)
        if len(self.lights) > WEIGHED:
            cell = np.repeat(pixels.cell, u.shape[2])
            rays.cell = cell if rays.lane is None else cell.take(rays.lane)
        return rays

    def _in_fog(self, origins: np.ndarray, directions: np.ndarray) -> FogRays:
        through, crossings = None, 0
        if self._shader.transmits.any():
            layers = self._layers(origins, directions)
            media = self.media.along(origins, directions, layers.reach)
            media, through = _in_layers(media, layers, self.media.extinction, directions)
            crossings = sum(len(ray) for ray, *_ in layers.behind)
        else:
            end = self.surfaces.distance(origins, directions, self.rays.reach)
            media = self.media.along(origins, directions, end)
        scatters = self.media.scattering.any(axis=(0, 1))
        if not scatters.all():
            rows = np.flatnonzero(scatters.take(media.mixture))
            media, through = _taken(media, rows), None if through is None else take(through, rows)
        begins = np.append(True, media.ray[1:] != media.ray[:-1])[: len(media.ray)]
        lane = None
        first = np.append(np.flatnonzero(begins), len(media.ray))
        if len(first) - 1 < len(origins):
            lane = media.ray[first[:-1]]
            media.ray = np.cumsum(begins) - 1
            origins = origins.take(lane, axis=0)
            directions = directions if len(directions) == 1 else directions.take(lane, axis=0)
        direction = directions.T.astype(np.float64)
        direction /= np.sqrt((direction * direction).sum(axis=0))
        direction = np.broadcast_to(direction, (3, len(origins)))
        return FogRays(
            origins.T.astype(np.float64), direction, media, first, lane, through, crossings=crossings
        )

    def _layers(self, origins: np.ndarray, directions: np.ndarray) -> _Layers:
        """What camera rays see one behind another, as long as surfaces let them through."""
        n = len(origins)
        layers = _Layers(np.full(n, self.rays.reach), np.full(n, self.rays.reach), [])
        ray, start, here = np.arange(n), np.zeros(n), origins
        passed = np.ones((3, n), np.float32)
        for crossing in range(self._crossings + 1):
            along = directions if len(directions) == 1 else directions.take(ray, axis=0)
            points, distance = self.surfaces.first_hit(
                here, along, (self.rays.reach - start).astype(np.float32)
            )
            hit = np.arange(len(ray)) if points.lane is None else points.lane
            end = np.full(len(ray), self.rays.reach)
            end[hit] = start.take(hit) + distance
            if crossing:
                layers.behind.append((ray, start, end, passed))
            else:
                layers.first[:] = end
            layers.reach[ray] = end
            viewer = np.broadcast_to(
                -(along if len(along) == 1 else along.take(hit, axis=0)).T, (3, len(hit))
            )
            passed = take(passed, hit)
            for rows, terms in self._shader.terms(points, viewer, False):
                passed[:, slice(None) if rows is None else rows] *= terms.transparency
            on = np.flatnonzero(passed.any(axis=0))
            if on.size == 0 or crossing == self._crossings:
                break
            hit = hit.take(on)
            ray, start, passed = ray.take(hit), end.take(hit), np.minimum(take(passed, on), LARGEST)
            here = self.surfaces.beyond(points.take(on))
        return layers

    @property
    def anisotropy(self) -> np.ndarray:
        """(R,) of each mixture, the mean over its phase functions."""
        brightness = self.media.scattering.mean(axis=1)
        return self.media.anisotropy @ brightness / np.maximum(brightness.sum(axis=0), 1e-300)

    # -- choosing among lights ---------------------------------------------------------------------

    def choice_of_cells(
        self,
        only: np.ndarray,
        cell_x: np.ndarray,
        cell_y: np.ndarray,
        between: Callable[[], None] = lambda: None,
    ) -> FogChoice | None:
        """The choice among lights ``only`` (L,) in K cells of the picture; None where all are sampled.

        cell_x, cell_y : (K,) numbered from the whole frame's corner. between : called now and then.
        """
        if len(only) <= EVERY:
            return None
        lights = AirLights(self.lights, only)
        if len(only) <= WEIGHED:
            return FogChoice(lights, None)
        u = pilot_points(cell_x, cell_y)
        if self.screen_dimensions == 4:
            u = np.concatenate([u, np.full_like(u, 0.5)])  # the lens' middle
        rays = self._in_fog(*self.rays.rays(cell_x * CELL, cell_y * CELL, u))
        found = np.zeros(u.shape[1:], bool)
        found.reshape(-1)[slice(None) if rays.lane is None else rays.lane] = True
        # From where the fog begins to where it ends.
        media, n = rays.media, found.size
        where = segments(
            rays.origin,
            rays.direction,
            media.start.take(rays.first[:-1]),
            media.end.take(rays.first[1:] - 1),
            self.thinnest.take(media.mixture.take(rays.first[:-1])),
            self.thinnest[0],
        )
        place, direction = np.zeros((7, n), np.float32), np.zeros((3, n), np.float32)
        place[:, found.reshape(-1)], direction[:, found.reshape(-1)] = where
        return FogChoice(
            lights, fog_clusters(lights, type(where)(place, direction).reshape(*found.shape), found, between)
        )

    @property
    def thinnest(self) -> np.ndarray:
        """(R,) extinction of each mixture, the least of the channels that scatter."""
        extinction, scatters = self.media.extinction, self.media.scattering.any(axis=0)
        least = np.where(scatters, extinction, np.inf).min(axis=0)
        return np.where(scatters.any(axis=0), least, extinction.min(axis=0))


@dataclass(eq=False)
class _Layers:
    """How far N camera rays get, in lengths of the direction: to the ``first`` surface, and in the end.

    behind : of each further layer the rays (R,), start and end (R,) there, and what reaches it (3, R).
    """

    first: np.ndarray
    reach: np.ndarray
    behind: list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]


def _in_layers(
    media: RayMedia, layers: _Layers, extinction: np.ndarray, directions: np.ndarray
) -> tuple[RayMedia, np.ndarray | None]:
    """Segments that end at surfaces, and what is left (3, K) of light from them; None for all."""
    if not layers.behind:
        return media, None
    unit = np.broadcast_to(np.sqrt((directions.astype(np.float64) ** 2).sum(axis=1)), len(layers.first))
    found = [(None, np.zeros(len(unit)), layers.first, np.ones((3, len(unit)), np.float32)), *layers.behind]
    parts, through = [], []
    number = np.empty(len(unit), np.intp)
    for ray, start, end, passed in found:
        number[:] = -1
        number[slice(None) if ray is None else ray] = np.arange(len(start))
        row = number.take(media.ray)
        start, end = ((x * (unit if ray is None else unit.take(ray))).take(row) for x in (start, end))
        start, end = np.maximum(start, media.start), np.minimum(end, media.end)
        rows = np.flatnonzero((row >= 0) & (end > start))
        part = _taken(media, rows)
        skipped = start.take(rows) - part.start
        part.depth = (part.depth + take(extinction, part.mixture) * skipped).astype(np.float32)
        part.start, part.end = start.take(rows), end.take(rows)
        parts.append(part)
        through.append(take(passed, row.take(rows)))
    fields_ = ("ray", "start", "end", "inside", "mixture", "depth")
    joined = {name: np.concatenate([getattr(part, name) for part in parts], axis=-1) for name in fields_}
    joined = replace(media, **joined)
    order = np.lexsort((joined.start, joined.ray))
    return _taken(joined, order), take(np.concatenate(through, axis=1), order)


def _taken(media: RayMedia, rows: np.ndarray) -> RayMedia:
    """Only segments ``rows``."""
    parts = {name: getattr(media, name).take(rows) for name in ("ray", "start", "end", "inside", "mixture")}
    return replace(media, **parts, depth=media.depth.take(rows, axis=1))


@dataclass(eq=False)
class _Places:
    """P segments ``row``, chosen with ``chance`` (P,), and what that left of their dimension, u (P, S)."""

    row: np.ndarray
    u: np.ndarray
    chance: np.ndarray

    def take(self, rows: np.ndarray) -> _Places:
        return _Places(self.row.take(rows), self.u.take(rows, axis=0), self.chance.take(rows))


def run(lane: np.ndarray) -> int:
    """How many times in a row every entry of (N,) comes, as long as all do so alike; else 1."""
    changes = np.flatnonzero(lane[1:] != lane[:-1])
    split = int(changes[0]) + 1 if changes.size else max(len(lane), 1)
    if split == 1 or len(lane) % split or (lane.reshape(-1, split) != lane[::split, None]).any():
        return 1
    return split


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


class Scattered:
    """A part of the light that fog scatters, as an integrand: what both kinds of it share.

    check : called before every batch; may raise, to give up.
    counts : so far, rays by kind and what was not finite.
    """

    staged = True

    def __init__(
        self, scattering: SingleScattering, lights: np.ndarray, check: Callable[[], None] = lambda: None
    ) -> None:
        """lights : (L,) numbers of those that are meant, ascending."""
        self._scattering, self._lights, self._check = scattering, np.asarray(lights, np.intp), check
        self._counting = Lock()
        self.counts = Counter(dict.fromkeys((CAMERA, SHADOW, CROSSING, NON_FINITE), 0))

    def first(self, pixels: Pixels, u: np.ndarray) -> FogRays:
        self._check()
        rays = self._scattering.first(pixels, _inset(u))
        self._count(CAMERA, u[0].size)
        self._count(CROSSING, rays.crossings)
        return rays

    def _count(self, kind: str, number: int) -> None:
        with self._counting:
            self.counts[kind] += number

    def _bounded(self, radiance: np.ndarray) -> np.ndarray:
        """Radiance (3, N) without what is not finite, which is counted, as float32."""
        radiance = radiance.astype(np.float32)
        if not np.isfinite(radiance.sum()):
            self._count(NON_FINITE, int((~np.isfinite(radiance)).any(axis=0).sum()))
            radiance[~np.isfinite(radiance)] = 0
        _bound(radiance)
        return radiance


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
    ) -> None:
        """choice : among the lights (`SingleScattering.choice_of_cells`); None samples them all."""
        super().__init__(scattering, lights, check)
        self._choice = choice
        self.guide: Guide | None = None
        scene = scattering.lights
        self._number = None if len(scene) == 1 else self._lights
        self.rest_dimensions = 4 if choice is not None or scene.chooses_triangle else 3

    def first(self, pixels: Pixels, u: np.ndarray) -> FogRays:
        rays = super().first(pixels, u)
        if self.guide is not None:
            places = (
                (corner[:, None] + at).ravel() for corner, at in zip((pixels.x, pixels.y), u, strict=True)
            )
            places = (at if rays.lane is None else at.take(rays.lane) for at in places)
            rays.knots = self.guide.knots(*places)
        return rays

    def rest(self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        self._check()
        split, u = (u.shape[2] if lane is None else run(lane)), _inset(u).reshape(len(u), -1)
        ray = np.arange(len(rays)) if lane is None else lane[::split]
        if u.shape[1] == 0 or len(self._lights) == 0:
            return np.zeros(0, np.intp), np.zeros((3, 0), np.float32)
        if len(rays.media.ray) > len(rays) or self._choice is not None:
            # Each point has a segment, or a light, of its own.
            ray, split = np.repeat(ray, split), 1
        which, values = self._scattered(rays, ray, u, split)
        return which, self._bounded(values)

    def _scattered(
        self, rays: FogRays, ray: np.ndarray, u: np.ndarray, split: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Which (J,) of N points get radiance (3, J), at u (D, N), ``split`` in a row of each ray (R,)."""
        weight = None
        if self._choice is None:
            row = np.tile(np.arange(len(ray)), len(self._lights))
            light = np.repeat(self._lights, len(ray))
            which = np.tile(np.arange(u.shape[1]), len(self._lights))
            w, at = u[-1].take(which), take(u[:DIMENSIONS], which)
            if rays.knots is not None:
                at, weight = stretched(rays.knots, np.repeat(ray, split), u[:DIMENSIONS])
                at, weight = at.reshape(DIMENSIONS, -1), weight.ravel()
            place = self._segment(rays, ray.take(row), light, at[0].reshape(-1, split))
            ray = ray.take(row)
        else:
            place = self._segment(rays, ray, None, u[0][:, None])
            light, of_light, w = self._choice.choose(
                self._where(rays, ray, place.row), self._cells(rays, ray), u[3][:, None]
            )
            place.chance *= of_light
            which = np.argsort(light, kind="stable")
            ray, light, w, place = ray.take(which), light.take(which), w.take(which), place.take(which)
            at = take(u[:DIMENSIONS], which)
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

    @staticmethod
    def _cells(rays: FogRays, ray: np.ndarray) -> np.ndarray | None:
        return None if rays.cell is None else rays.cell.take(ray)

    def _segment(self, rays: FogRays, ray: np.ndarray, light: np.ndarray | None, u: np.ndarray) -> _Places:
        """A segment of each ray (P,), for lights (P,) or any, by u (P, S); (P, 1) if there are several."""
        row = rays.first.take(ray)
        if len(rays.media.ray) == len(rays):
            return _Places(row, u.astype(np.float64), np.ones(len(ray)))
        rows, pair = rays.segments(ray)
        media, scattering = rays.media, self._scattering
        mixture = media.mixture.take(rows)
        sigma = scattering.thinnest.take(mixture)
        length = within_depth(sigma, (media.end - media.start).take(rows))
        weight = length / (1 + sigma * length)
        if light is not None:
            foot, distance, finite = self._around(rays, ray.take(pair), light.take(pair), rows)
            weight = np.where(finite, EquiAngular(foot, distance, length).weight, weight)
        weight *= scattering.media.scattering.mean(axis=(0, 1)).take(mixture)
        weight *= np.exp(-media.depth.min(axis=0).take(rows).astype(np.float64))
        total = np.bincount(pair, weight, len(ray))
        number = np.bincount(pair, minlength=len(ray))
        # A part of the chances is the same for all segments, whatever is known of them.
        weight = 0.95 * weight / np.where(total > 0, total, 1).take(pair)
        weight += np.where(total > 0, 0.05, 1).take(pair) / number.take(pair)
        upper = np.cumsum(weight)
        start = np.cumsum(number) - number
        base = (upper - weight).take(start)
        upper = np.minimum(pair + (upper - base.take(pair)), pair + 1)
        chosen = np.searchsorted(upper, np.arange(len(ray)) + u[:, 0].astype(np.float64), side="right")
        chosen = np.clip(chosen, start, start + number - 1)
        chance = weight.take(chosen)
        left = u[:, 0] - (upper.take(chosen) - np.arange(len(ray)) - chance)
        return _Places(rows.take(chosen), np.clip(left / chance, 0, 1)[:, None], chance)

    def _around(
        self, rays: FogRays, ray: np.ndarray, light: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Feet of lights (P,) on rays (P,) from the start of segments ``row`` on, how far they are, softened
        by the lights' size, and which of them are at a finite distance."""
        lights = self._scattering.lights
        reach = lights.reach.take(light)
        direction = take(rays.direction, ray)
        vector = take(lights.centre, light) - take(rays.origin, ray)
        foot = dot(vector, direction)
        vector -= foot * direction
        finite = np.isfinite(reach)
        reach = np.where(finite, reach, 0)
        return foot - rays.media.start.take(row), np.sqrt(dot(vector, vector) + reach * reach), finite

    def _distances(
        self, rays: FogRays, ray: np.ndarray, light: np.ndarray, place: _Places
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
        first, last = in_cone(
            *(take(x, light).astype(np.float64) for x in (cones.apex, cones.axis, cones.cos)),
            take(rays.origin, ray),
            take(rays.direction, ray),
        )
        margin = 1e-6 * (np.abs(first) + np.abs(last))
        first, last = (
            np.clip(x - start.take(rows), 0, length.take(rows)) for x in (first - margin, last + margin)
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
        leg = np.where(same, sigma, np.float32(scattering.thinnest[0]))
        depth = sigma[:, None] * t + leg[:, None] * r
        depth -= depth.min(axis=0)
        factor = np.exp(-depth)
        g = scattering.anisotropy.astype(np.float32).take(mixture)[:, None]
        if g.any():
            cosine = -x / r
            factor *= phase.value((1 - cosine) / 2, (1 + cosine) / 2, g)
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
        to_light, weight, at_infinity, is_mesh = lights.sample_in_space(number, position, u, w)
        passed = passed * weight
        lit = np.flatnonzero(passed.any(axis=0))
        if lit.size < len(ray):
            ray, light, row, mixture, w = (x.take(lit) for x in (ray, light, row, mixture, w))
            direction, position, to_light, passed = (
                take(x, lit) for x in (direction, position, to_light, passed)
            )
            at_infinity, is_mesh = (x if np.ndim(x) == 0 else x.take(lit) for x in (at_infinity, is_mesh))
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
        arrive, part = self._passing(position, to_light, at_infinity, is_mesh, light)
        scattered = take(scattered, arrive)
        if part is not None:
            scattered *= part
        origins, directions = (
            np.ascontiguousarray(take(x, arrive).T, np.float32) for x in (position, to_light)
        )
        reach = np.where(np.broadcast_to(at_infinity, len(ray)).take(arrive), np.inf, 1)
        depth = fog.optical_depth(origins, directions, reach, media.inside.take(row.take(arrive)))
        scattered *= np.exp(-depth)
        return lit.take(arrive), scattered

    def _passing(
        self, position, to_light, at_infinity, is_mesh, light
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Which (J,) of shadow rays arrive, and what part (3, J) surfaces leave of them, None for all."""
        scattering = self._scattering
        casts = scattering.lights.casts_shadow.take(light)
        rows = np.arange(len(light)) if casts.all() else np.flatnonzero(casts)
        origins, directions = (
            np.ascontiguousarray(take(x, rows).T, np.float32) for x in (position, to_light)
        )
        reach = np.where(at_infinity, FAR, np.where(is_mesh, SHORTFALL, 1)).astype(np.float32)
        reach = float(reach) if reach.ndim == 0 else reach.take(rows)
        arrive, part, crossings = scattering.shadows.passing(origins, directions, reach)
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
