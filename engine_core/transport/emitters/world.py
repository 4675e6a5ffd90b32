# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: light from everywhere."""

from __future__ import annotations

import numpy as np

from ...geometry.vectors import dot, length, take
from ...geometry.warps import cosine_hemisphere, uniform_sphere
from ...scene import Linking, World
from .base import Emitters, LightHits
from .environment_by_cosine import EnvironmentByCosine
from .environment_map import EnvironmentMap

ALONE = 0.25
"""Of the directions to a picture, what follows its luminance alone where normals may be others than told."""

_LEAST = np.float32(1e-37)


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
    """Radiance by a picture: directions follow its luminance times the cosine. Measure: 1 / pdf.

    Points in space have no cosine: for them directions follow the luminance alone.
    """

    at_infinity = True
    is_world = True
    has_tint = True
    is_background = True

    def __init__(self, world: World, bent: bool = False) -> None:
        """bent : whether surfaces may have normals that are not those that are told: what is next to the
        horizon of these may be all that lights those. So some directions follow the luminance alone.
        """
        super().__init__(np.ones((1, 3)), np.ones(1), [Linking()])
        self._map = EnvironmentMap(np.maximum(world.image, 0), world.rotation)
        self._by_cosine = EnvironmentByCosine(self._map)
        self._brightness = np.full(1, self._map.mean.mean(), np.float32)
        self._visible = [0] if world.visible_to_camera else []
        self._alone = np.float32(ALONE if bent else 0)

    def sample(self, which, position, normal, w, u):
        if normal is None:
            direction, density = self._map.sample(u)
        elif not self._alone:
            direction, density = self._by_cosine.sample(normal, u)
        else:
            alone = u[0] < self._alone
            direction, density = np.empty((3, len(alone)), np.float32), np.empty(len(alone), np.float32)
            rows, v = np.flatnonzero(alone), np.where(alone, u[0], u[0] - self._alone)
            v /= np.where(alone, self._alone, 1 - self._alone)
            v = np.stack([v, u[1]])
            direction[:, rows], density[rows] = self._map.sample(take(v, rows))
            density[rows] *= self._alone
            density[rows] += (1 - self._alone) * self._by_cosine.pdf(take(normal, rows), direction[:, rows])
            rows = np.flatnonzero(~alone)
            direction[:, rows], density[rows] = self._by_cosine.sample(take(normal, rows), take(v, rows))
            density[rows] *= 1 - self._alone
            density[rows] += self._alone * self._map.pdf(direction[:, rows])
        # Where it is 0, so is the light.
        return direction.astype(np.float32), np.where(density > 0, 1 / np.maximum(density, _LEAST), 0)

    def pdf(self, which, position, normal, to_light):
        if normal is None:
            return self._map.pdf(to_light)
        density = self._by_cosine.pdf(normal, to_light)
        if self._alone:
            density = (1 - self._alone) * density + self._alone * self._map.pdf(to_light)
        return density

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
        found = self._by_cosine.irradiance(normal)
        if self._alone:
            found = (1 - self._alone) * found + self._alone * np.float32(np.pi)
        return (found * self._brightness[0])[None]

    def seen(self, origins, directions, distance, through=None):
        open_sky = np.flatnonzero(np.isinf(distance))
        if not self._visible or not open_sky.size:
            return None
        total = np.zeros((3, len(distance)), np.float32)
        some = np.broadcast_to(directions, (len(distance), 3)).take(open_sky, axis=0)
        radiance = self._map.radiance(some.T)
        total[:, open_sky] = radiance if through is None else radiance * through(open_sky, np.inf)
        return total
