# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: light from everywhere."""

from __future__ import annotations

import numpy as np

from ...geometry.vectors import dot, length, take
from ...geometry.warps import cosine_hemisphere, uniform_sphere
from ...scene import Linking, World
from .base import Emitters, LightHits
from .environment_map import LUMINANCE, EnvironmentMap


class WorldEmitter(Emitters):
    """Constant radiance from everywhere, by a cosine-weighted direction. Measure: pi / cos.

    From points in space by any direction, measure 4 pi.
    """

    at_infinity = True
    is_world = True

    def __init__(self, world: World) -> None:
        super().__init__(world.radiance[None], np.ones(1), [Linking()])

    def sample(self, which, position, normal, w, u):
        if normal is None:
            direction, measure = uniform_sphere(u)
            return direction, np.full(u.shape[1], measure)
        return cosine_hemisphere(normal, u)

    @property
    def far_fluence(self):
        return np.float32(4 * np.pi) * self._brightness

    def irradiance(self, position, normal, which=None):
        return np.full((1, position.shape[1]), np.float32(np.pi) * self._brightness[0])

    def pdf(self, which, position, normal, to_light):
        if normal is None:
            return np.full(to_light.shape[1], np.float32(0.25 / np.pi))
        cosine = dot(normal, to_light) / length(to_light)
        return np.maximum(cosine, 0) * np.float32(1 / np.pi)

    def met(self, which, position, directions):
        return np.ones((2, position.shape[1]), np.float32)

    def hits(self, position, directions, lights=None):
        n = position.shape[1]
        yield LightHits(np.arange(n), np.zeros(n, np.intp), np.ones(n, np.float32), None)


class ImageWorldEmitter(Emitters):
    """Radiance by a picture: directions follow its luminance, or the cosine. Measure: 1 / pdf.

    A picture of little contrast is better served by the cosine, one with a sun by its luminance. The
    share of both is what has the least variance for surfaces of all orientations. ``u[0]`` tells which.
    Points in space have no cosine: for them all directions follow the luminance.
    """

    at_infinity = True
    is_world = True
    has_tint = True
    is_background = True

    def __init__(self, world: World) -> None:
        super().__init__(np.ones((1, 3)), np.ones(1), [Linking()])
        self._map = EnvironmentMap(np.maximum(world.image, 0), world.rotation)
        self._brightness = np.full(1, self._map.mean.mean(), np.float32)
        self._visible = [0] if world.visible_to_camera else []
        self._by_map = _share_of_map(self._map)

    def sample(self, which, position, normal, w, u):
        if normal is None:
            direction, density = self._map.sample(u)
            return direction.astype(np.float32), 1 / np.maximum(density, np.float32(1e-37))
        by_map = u[0] < self._by_map
        chosen, others = np.flatnonzero(by_map), np.flatnonzero(~by_map)
        direction, density = np.empty((3, len(by_map)), np.float32), np.empty(len(by_map), np.float32)
        v = take(u, chosen)
        v[0] /= self._by_map
        direction[:, chosen], density[chosen] = self._map.sample(v)
        if others.size:
            v = take(u, others)
            v[0] = (v[0] - self._by_map) / (1 - self._by_map)
            direction[:, others], _ = cosine_hemisphere(take(normal, others), v)
            density[others] = self._map.pdf(take(direction, others))
        return direction, 1 / np.maximum(self._mixed(density, normal, direction), np.float32(1e-37))

    def pdf(self, which, position, normal, to_light):
        density = self._map.pdf(to_light)
        return density if normal is None else self._mixed(density, normal, to_light / length(to_light))

    def _mixed(self, density: np.ndarray, normal: np.ndarray, direction: np.ndarray) -> np.ndarray:
        if self._by_map == 1:
            return density
        cosine = np.maximum(dot(normal, direction), 0)
        return density * self._by_map + cosine * ((1 - self._by_map) * np.float32(1 / np.pi))

    def tint(self, which, to_light):
        return self._map.radiance(to_light)

    def met(self, which, position, directions):
        return np.ones((2, position.shape[1]), np.float32)

    def hits(self, position, directions, lights=None):
        n = position.shape[1]
        yield LightHits(
            np.arange(n), np.zeros(n, np.intp), np.ones(n, np.float32), self._map.radiance(directions)
        )

    @property
    def far_fluence(self):
        return np.float32(4 * np.pi) * self._brightness

    def irradiance(self, position, normal, which=None):
        return np.full((1, position.shape[1]), np.float32(np.pi) * self._brightness[0])

    def seen(self, origins, directions, distance, through=None):
        open_sky = np.flatnonzero(np.isinf(distance))
        if not self._visible or not open_sky.size:
            return None
        total = np.zeros((3, len(distance)), np.float32)
        some = np.broadcast_to(directions, (len(distance), 3)).take(open_sky, axis=0)
        radiance = self._map.radiance(some.T)
        total[:, open_sky] = radiance if through is None else radiance * through(open_sky, np.inf)
        return total


def _share_of_map(environment: EnvironmentMap) -> np.float32:
    """The part of all samples that should follow a picture's luminance, the others the cosine."""
    count = 4096
    # Points of the golden ratio's generalisation to two dimensions, R2.
    lattice = (np.arange(1, count + 1) * np.array([[0.7548776662466927], [0.5698402909980532]])) % 1
    direction, density = environment.sample(lattice.astype(np.float32))
    light = LUMINANCE @ environment.radiance(direction)
    normals = np.array([n for n in np.ndindex(3, 3, 3) if n != (1, 1, 1)]) - 1.0
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    cosine = np.maximum(normals @ direction, 0)
    mean = (light / density * cosine).mean(axis=1)
    shares = np.array([0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875, 1.0])
    mixed = shares[:, None, None] * density + (1 - shares[:, None, None]) * cosine / np.pi
    square = ((light * cosine) ** 2 / (density * np.maximum(mixed, 1e-37))).mean(axis=2)
    lit = mean > 1e-3 * mean.max()
    return np.float32(shares[np.argmin((square[:, lit] / mean[lit] ** 2).mean(axis=1))])
