# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters once, towards the camera, as a staged function of primary space.

    first : (screen 2, lens 2 if it has a size) -> camera rays, and the fog that they run through
    rest  : (distance 1, light 2, choice 1) -> radiance scattered at one point of each ray

    L = integral along the ray of T(t) sum_lights sigma_s p(cos) fluence V T_light dt     (thesis eq. 6.1)

The maps along rays are in `distance_maps`, those on lights in `emitters`. Lights without size need no other
dimension than the distance, and `ray_rule` integrates that.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock

import numpy as np

from ..geometry.frame import Frame
from ..geometry.surfaces import Surfaces
from ..settings import Settings
from .camera_hits import Pixels
from .camera_rays import CameraRays
from .direct_light import CAMERA, CROSSING, NON_FINITE, SHADOW, _bound, _inset
from .light_samples import SceneLights
from .media import Media, RayMedia
from .shadows import Shadows
from .surface_shading import SurfaceShader


@dataclass(eq=False)
class FogRays:
    """The first stage's result for N camera rays, M of which run through fog.

    values : None, as nothing is known without another dimension. lane : (M,) ascending; None for all N.
    origin, direction : (3, M) float64, unit directions.
    media : K segments, whose ``ray`` counts the M rays. first : (M + 1,) where those of each ray begin.
    through : (3, K) float32, what transparent surfaces before a segment leave of it; None for all.
    """

    origin: np.ndarray
    direction: np.ndarray
    media: RayMedia
    first: np.ndarray
    lane: np.ndarray | None = None
    through: np.ndarray | None = None
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

    messages : none yet, of what can't be drawn. screen_dimensions : 2 of a pixel, and 2 of a lens.
    sizeless, sized : numbers of the lights without size, which `ScatteredAlongRay` takes, and of all others.
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
        self.rays, self.settings = rays, settings
        self.shadows = Shadows(surfaces, shader, settings.transparent_bounces)
        self.screen_dimensions = rays.dimensions
        size = np.concatenate([np.zeros(0)] + [group.size for group in lights.groups])
        # Background and meshes have no size in this sense, or a size.
        bare = np.repeat([not group.is_mesh and not group.is_background for group in lights.groups],
                         [len(group) for group in lights.groups])  # fmt: skip
        without = (size == 0) & bare.astype(bool)
        if surfaces.any_transparent:
            without[:] = False
        self.sizeless, self.sized = np.flatnonzero(without), np.flatnonzero(~without)

    def first(self, pixels: Pixels, u: np.ndarray) -> FogRays:
        """Camera rays through points (2, B, S) of pixels' unit squares; (4, B, S) with those of a lens."""
        origins, directions = self.rays.rays(pixels.x, pixels.y, u)
        reach = self.rays.reach
        end = self.surfaces.distance(origins, directions, reach)
        return self._in_fog(origins, directions, end)

    def _in_fog(self, origins: np.ndarray, directions: np.ndarray, end: np.ndarray) -> FogRays:
        media = self.media.along(origins, directions, end)
        scatters = self.media.scattering.any(axis=(0, 1))
        if not scatters.all():
            media = _taken(media, np.flatnonzero(scatters.take(media.mixture)))
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
        return FogRays(
            origins.T.astype(np.float64),
            np.broadcast_to(direction, (3, len(origins))),
            media,
            first,
            lane,
        )


def _taken(media: RayMedia, rows: np.ndarray) -> RayMedia:
    """Only segments ``rows``."""
    return RayMedia(
        media.ray.take(rows),
        media.start.take(rows),
        media.end.take(rows),
        media.inside.take(rows),
        media.mixture.take(rows),
        media.depth.take(rows, axis=1),
        media.total,
        media.state,
        media.emission,
    )


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
