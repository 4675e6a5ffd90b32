# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters once, towards the camera, as a staged function of primary space.

    first : (screen 2, lens 2 if it has a size) -> camera rays, and the fog that they run through
    rest  : (distance 1, light 2, light choice 1) -> radiance scattered at one point of each ray

    L = integral along the ray of T(t) sum_lights sigma_s p(cos) fluence V T_light dt     (thesis eq. 6.1)

Here is what all estimates of it share: `scattered_light` has points of any lights, `ray_rule` whole rays of
those without size and of small ones, `laser_in_fog` the light of beams.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

import numpy as np

from ..geometry.frame import Frame
from ..geometry.raytracer import FAR
from ..geometry.surfaces import NONE_CAST, Surfaces
from ..geometry.vectors import dot, take
from ..settings import Settings
from ..shading.terms import LARGEST
from . import phase
from .camera_hits import Pixels
from .camera_rays import CameraRays
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW, _bound, _inset
from .distance_maps import EquiAngular, within_depth
from .emitters import DiskEmitters, PointEmitters, SphereEmitters, SunEmitters
from .fog_rays import FogRays, Layers, fog_ends, in_layers, taken
from .light_choice_in_fog import AirLights, CellsOfPicture, FogChoice, fog_clusters, segments
from .light_clusters import CELL, pilot_points
from .light_samples import SceneLights
from .long_lights import past
from .media import Media
from .shadows import Shadows
from .surface_shading import SurfaceShader

EVERY = 8
"""Lights up to which all are sampled in any case, and summed."""

PEAKED, BY_PHASE = 0.55, (0.25, 0.5)
"""Anisotropy from where on directions to wide lights follow the phase function, too; and how many of them,
and of those to a sky that is the same everywhere.
"""

FILLED = 0.25
"""What of a phase function's peak a wide light fills at least."""


class SingleScattering:
    """What all estimates of light scattered once share, and all threads.

    screen_dimensions : 2 of a pixel, and 2 of a lens.
    sizeless, sized, small : numbers of the lights without size, which `ray_rule` takes; of all others, as
        those that cast no shadow; and of those among these that it takes, too. Lights that no fog gets light
        of are in none.
    of_mesh : numbers of those that are pieces of meshes. clear : (L,) bool, which cast no shadow.
    sine : (L,) of half the angles that suns fill, 0 of others.
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
        bare, small, of_mesh = np.zeros((3, len(lights)), bool)
        self.sine = np.zeros(len(lights))
        for group, start, stop in zip(lights.groups, lights.first[:-1], lights.first[1:], strict=True):
            if isinstance(group, PointEmitters | SunEmitters):
                bare[start:stop] = group.size == 0
            small[start:stop] = isinstance(group, DiskEmitters | SphereEmitters)
            of_mesh[start:stop] = group.is_mesh
            if isinstance(group, SunEmitters):
                small[start:stop], self.sine[start:stop] = group.size > 0, group.sine
        # What is infinitely far is behind a fog that fills all space.
        reaches = np.isfinite(lights.reach) | ~(media.extinction[:, 0] > 0).all()
        # Not even fog is between a light that casts no shadow and what it lights, unlike whole rays have it.
        self.clear = clear = lights.links.blockers == NONE_CAST
        reaches = (reaches | clear) & lights.links.in_fog
        self.sizeless, self.sized, self.small, self.of_mesh = (
            np.flatnonzero(some & reaches) for some in (bare & ~clear, ~bare | clear, small & ~clear, of_mesh)
        )
        self.cones = AirLights(lights, clear=clear)
        # Of each light's middle, inside which fogs it is.
        self.light_state = np.zeros(len(lights), np.uint64)
        if media.bodies and len(lights):
            origins = np.ascontiguousarray(lights.centre.T, np.float32)
            self.light_state = media.along(origins, np.eye(1, 3, dtype=np.float32), 1e-6).state

    def first(self, pixels: Pixels, u: np.ndarray) -> FogRays:
        """Camera rays through points (2, B, S) of pixels' unit squares; (4, B, S) with those of a lens."""
        origins, directions = self.rays.rays(pixels.x, pixels.y, u)
        return self._in_fog(origins, directions)

    def _in_fog(self, origins: np.ndarray, directions: np.ndarray) -> FogRays:
        through, crossings = None, 0
        if self._shader.transmits.any():
            layers = self._layers(origins, directions)
            media = self.media.along(origins, directions, layers.reach, clip=self.rays.reach)
            media, through = in_layers(media, layers, self.media.extinction, directions)
            crossings = sum(len(ray) for ray, *_ in layers.behind)
        else:
            end = fog_ends(self.surfaces, self.rays, origins, directions)
            media = self.media.along(origins, directions, end, clip=self.rays.reach)
        scatters = self.media.scattering.any(axis=(0, 1))
        if not scatters.all():
            rows = np.flatnonzero(scatters.take(media.mixture))
            media, through = taken(media, rows), None if through is None else take(through, rows)
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

    def _layers(self, origins: np.ndarray, directions: np.ndarray) -> Layers:
        """What camera rays see one behind another, as long as surfaces let them through."""
        n = len(origins)
        layers = Layers(np.full(n, FAR, float), np.full(n, FAR, float), [])
        ray, start, here = np.arange(n), np.zeros(n), origins
        passed = np.ones((3, n), np.float32)
        for crossing in range(self._crossings + 1):
            along = directions if len(directions) == 1 else directions.take(ray, axis=0)
            points, distance = self.surfaces.first_hit(
                here, along, (self.rays.reach - start).astype(np.float32)
            )
            hit = np.arange(len(ray)) if points.lane is None else points.lane
            end = np.full(len(ray), FAR, float)
            end[hit] = start.take(hit) + distance
            if crossing:
                layers.behind.append((ray, start, end, passed))
            else:
                layers.first[:] = end
            layers.reach[ray] = end
            viewer = np.broadcast_to(
                -(along if len(along) == 1 else along.take(hit, axis=0)).T, (3, len(hit))
            )
            before, passed = take(passed, hit), np.zeros((3, len(hit)), np.float32)
            # What is black has no terms.
            for rows, terms in self._shader.terms(points, viewer, False):
                rows = slice(None) if rows is None else rows
                passed[:, rows] = before[:, rows] * terms.transparency
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

    @property
    def is_peaked(self) -> bool:
        """Whether any phase function is so peaked that wide lights are best sampled by it, too."""
        return bool(np.abs(self.media.anisotropy).max(initial=0) >= PEAKED)

    def shares_of_phase(self, sine: np.ndarray) -> np.ndarray:
        """(L,) float32, part of the directions to lights that follow the phase function: of those that fill
        about what its peak does, or more. sine : (L,) of half the angles that they fill, from the fog.
        """
        lights, width = self.lights, phase.width(np.abs(self.media.anisotropy).max())
        shares = np.zeros(len(lights), np.float32)
        filled = (1 - np.sqrt(1 - np.minimum(sine, 1) ** 2)) / 2
        for group, start, stop in zip(lights.groups, lights.first[:-1], lights.first[1:], strict=True):
            if group.is_mesh or isinstance(group, SunEmitters):
                continue
            wide = group.at_infinity | (filled[start:stop] > FILLED * width)
            if group.skewed is not None:
                wide &= ~group.skewed
            share = BY_PHASE[group.at_infinity and not group.has_tint]
            shares[start:stop] = np.where(wide & (group.size > 0), share, 0)
        return shares

    # -- choosing among lights ---------------------------------------------------------------------

    def choice_of_cells(
        self,
        only: np.ndarray,
        cell_x: np.ndarray,
        cell_y: np.ndarray,
        between: Callable[[], None] = lambda: None,
    ) -> FogChoice | None:
        """The choice among lights ``only`` (L,) in K cells of the picture; None where all are sampled.

        cell_x, cell_y : (K,) numbered from the frame's corner, row by row. between : called now and then.
        """
        if len(only) <= EVERY:
            return None
        lights = AirLights(self.lights, only, self.clear)
        if lights.are_few:
            return FogChoice(lights)
        # All over the places that a cell's clusters are used at: see `CellsOfPicture.drawn`.
        u = 2 * pilot_points(cell_x, cell_y) - CELL // 2
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
        clusters = fog_clusters(lights, type(where)(place, direction).reshape(*found.shape), found, between)
        return FogChoice(lights, clusters, CellsOfPicture.of(cell_x, cell_y))

    @property
    def thinnest(self) -> np.ndarray:
        """(R,) extinction of each mixture, the least of the channels that scatter."""
        extinction, scatters = self.media.extinction, self.media.scattering.any(axis=0)
        least = np.where(scatters, extinction, np.inf).min(axis=0)
        return np.where(scatters.any(axis=0), least, extinction.min(axis=0))


@dataclass(eq=False)
class Places:
    """P segments ``row``, chosen with ``chance`` (P,), and what that left of their dimension, u (P, S)."""

    row: np.ndarray
    u: np.ndarray
    chance: np.ndarray

    def take(self, rows: np.ndarray) -> Places:
        return Places(self.row.take(rows), self.u.take(rows, axis=0), self.chance.take(rows))


def run(lane: np.ndarray) -> int:
    """How many times in a row every entry of (N,) comes, as long as all do so alike; else 1."""
    changes = np.flatnonzero(lane[1:] != lane[:-1])
    split = int(changes[0]) + 1 if changes.size else max(len(lane), 1)
    if split == 1 or len(lane) % split or (lane.reshape(-1, split) != lane[::split, None]).any():
        return 1
    return split


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

    def _segment(self, rays: FogRays, ray: np.ndarray, light: np.ndarray | None, u: np.ndarray) -> Places:
        """A segment of each ray (P,), for lights (P,) or any, by u (P, S); (P, 1) if there are several."""
        row = rays.first.take(ray)
        if len(rays.media.ray) == len(rays):
            return Places(row, u.astype(np.float64), np.ones(len(ray)))
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
        return Places(rows.take(chosen), np.clip(left / chance, 0, 1)[:, None], chance)

    def _around(
        self, rays: FogRays, ray: np.ndarray, light: np.ndarray, row: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Feet of lights (P,) on rays (P,) from the start of segments ``row`` on, how far they are, softened
        by the lights' size, and which of them are at a finite distance."""
        lights, cones = self._scattering.lights, self._scattering.cones
        direction = take(rays.direction, ray)
        vector = take(lights.centre, light) - take(rays.origin, ray)
        foot = dot(vector, direction)
        vector -= foot * direction
        finite = np.isfinite(lights.reach.take(light))
        thickness = cones.thickness.take(light).astype(np.float64)
        square = dot(vector, vector) + thickness * thickness
        rows = np.flatnonzero(cones.long.take(light))
        if rows.size:
            core, direction = take(cones.core, light.take(rows)).astype(np.float64), take(direction, rows)
            least = np.maximum(square.take(rows), 1e-36)
            some, near, along = past(core, take(vector, rows), np.zeros(len(rows)), direction, least)
            # What runs beside it passes it for as long as it is.
            square[rows] = some + along * along
            foot[rows] += near * along
        return foot - rays.media.start.take(row), np.sqrt(square), finite

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
