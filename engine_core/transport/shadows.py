# SPDX-License-Identifier: GPL-3.0-or-later
"""What of a light arrives: nothing through opaque surfaces, a part through transparent ones and fog."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from ..geometry.raytracer import FAR
from ..geometry.surfaces import ALL_CAST, SurfacePoints, Surfaces, by_number
from ..geometry.vectors import take
from ..shading.terms import LARGEST
from .media import Media
from .surface_shading import SurfaceShader


class Towards(Protocol):
    """Vectors (3, K) to lights from surface points ``at`` (K,)."""

    at: np.ndarray
    to_light: np.ndarray
    at_infinity: np.ndarray | bool


class Shadows:
    """Shadow rays through a scene.

    crossings : how many transparent surfaces a ray may cross; beyond, it is blocked.
    media : the fogs that light arrives through, too; None for none.
    """

    def __init__(
        self, surfaces: Surfaces, shader: SurfaceShader, crossings: int, media: Media | None = None
    ) -> None:
        self._media = media
        self._surfaces = surfaces
        self._shader = shader
        self._most = crossings

    def arriving(
        self,
        points: SurfacePoints,
        towards: Towards,
        cosine: np.ndarray,
        blockers: np.ndarray | int = ALL_CAST,
        short: bool = False,
    ) -> tuple[np.ndarray, np.ndarray | None, int]:
        """Which (J,) arrive at all, what part (3, J) of each (None: the whole), and how many further rays
        looked for transparent surfaces.

        cosine : (K,) of the directions to the points' shading normals.
        blockers : (K,) or one, as of `Surfaces`. short : as in `Surfaces.shadow_rays`.
        """
        origins, directions, reach = self._surfaces.shadow_rays(
            points, towards.at, towards.to_light, cosine, towards.at_infinity, short
        )
        arrive, part, rays = self.passing(origins, directions, reach, blockers)
        if self._media is None:
            return arrive, part, rays
        end = np.where(np.broadcast_to(towards.at_infinity, len(origins)).take(arrive), np.inf, 1)
        depth = self._media.optical_depth(origins.take(arrive, axis=0), directions.take(arrive, axis=0), end)
        passed = self._media.transmittance(depth)
        part = passed if part is None else part * passed
        some = np.flatnonzero(part.any(axis=0))
        return arrive.take(some), take(part, some), rays

    def passing(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        reach: float | np.ndarray,
        blockers: np.ndarray | int = ALL_CAST,
    ) -> tuple[np.ndarray, np.ndarray | None, int]:
        """The same of shadow rays (K, 3) of any origin, without fog; reach in lengths of the direction."""
        arrive = np.flatnonzero(~self._surfaces.occluded(origins, directions, reach, blockers))
        if not self._surfaces.any_transparent:
            return arrive, None, 0
        reach = np.broadcast_to(np.asarray(reach, np.float32), len(origins)).take(arrive)
        origins, directions = origins.take(arrive, axis=0), directions.take(arrive, axis=0)
        if np.ndim(blockers) == 0:
            part, rays = self._part(origins, directions, reach, blockers)
        else:
            blockers = blockers.take(arrive)
            part, rays = np.ones((3, len(arrive)), np.float32), 0
            for number, rows in by_number(blockers):
                of_light = (x.take(rows, axis=0) for x in (origins, directions, reach))
                part[:, rows], count = self._part(*of_light, number)
                rays += count
        some = np.flatnonzero(part.any(axis=0))
        return arrive.take(some), take(part, some), rays

    def _part(
        self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray, blockers: int
    ) -> tuple[np.ndarray, int]:
        """(3, K) what transparent surfaces leave of the light along rays that nothing opaque blocks."""
        part = np.ones((3, len(origins)), np.float32)
        ray, rays = np.arange(len(origins)), 0
        for crossing in range(self._most + 1):
            rays += len(ray)
            points, distance = self._surfaces.next_transparent(origins, directions, reach, blockers)
            if len(points) == 0:
                break
            if points.lane is not None:
                ray, reach, directions = (
                    ray.take(points.lane), reach.take(points.lane), directions.take(points.lane, axis=0)
                )  # fmt: skip
            if crossing == self._most:
                part[:, ray] = 0
                break
            passed = take(part, ray) * self._shader.transparency(points, -directions.T)
            part[:, ray] = np.minimum(passed, LARGEST)
            on = np.flatnonzero(part[:, ray].any(axis=0))
            if on.size == 0:
                break
            origins = self._surfaces.beyond(points.take(on))
            ray, reach, directions = ray.take(on), (reach - distance).take(on), directions.take(on, axis=0)
        return part, rays

    def glow(
        self, origins: np.ndarray, directions: np.ndarray, inside: np.ndarray | None = None
    ) -> np.ndarray:
        """(3, K) radiance of glowing fog that rays (K, 3) see before something opaque.

        inside : (K,) as `Media` have it, the bodies in which rays begin; None if unknown.
        """
        end = self._surfaces.blocked_at(origins, directions, FAR)
        radiance = self._media.seen(origins, directions, end, inside)[1]
        if not self._surfaces.any_transparent:
            return radiance
        # Behind each layer the light is what the whole ray's is less what lies before it.
        ray, here, start = np.arange(len(origins)), origins, np.zeros(len(origins), np.float32)
        part, total = np.ones((3, len(origins)), np.float32), radiance.copy()
        for crossing in range(self._most + 1):
            to_end = np.minimum(end.take(ray), FAR).astype(np.float32) - start
            points, distance = self._surfaces.next_transparent(here, directions.take(ray, axis=0), to_end)
            lane = np.arange(len(ray)) if points.lane is None else points.lane
            ray, start, part = ray.take(lane), start.take(lane) + distance, take(part, lane)
            if ray.size == 0:
                break
            along = directions.take(ray, axis=0)
            bodies = None if inside is None else inside.take(ray)
            before = self._media.seen(origins.take(ray, axis=0), along, start, bodies)[1]
            behind = take(radiance, ray) - before
            left = np.zeros_like(part)
            if crossing < self._most:
                left = np.minimum(part * self._shader.transparency(points, -along.T), LARGEST)
            total[:, ray] -= (part - left) * behind
            part, here = left, self._surfaces.beyond(points)
        return np.maximum(total, 0)

    def met(
        self, origin: np.ndarray, direction: np.ndarray, reach: float, blockers: int = ALL_CAST
    ) -> tuple[np.ndarray, np.ndarray]:
        """What one shadow ray (1, 3) meets: distances (J,), ascending, and what (3, J) is left behind each.

        Nothing is left at the end of a ray that is blocked.
        """
        far = np.float32(min(reach, FAR))
        end, distances, parts = self._surfaces.blocked_at(origin, direction, far, blockers)[0], [], []
        if self._surfaces.any_transparent:
            left, start = np.ones((3, 1), np.float32), 0.0
            for _ in range(self._most):
                limit = np.full(1, min(end, far) - start, np.float32)
                points, distance = self._surfaces.next_transparent(origin, direction, limit, blockers)
                if len(points) == 0:
                    break
                start += float(distance[0])
                left = np.minimum(left * self._shader.transparency(points, -direction.T), LARGEST)
                distances.append(start)
                parts.append(left)
                origin = self._surfaces.beyond(points)
            else:
                end = start
        if np.isfinite(end):
            distances.append(end)
            parts.append(np.zeros((3, 1), np.float32))
        return np.array(distances, np.float64), np.concatenate([np.zeros((3, 0)), *parts], axis=1)
