# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: light from everywhere."""

from __future__ import annotations

import numpy as np

from ...geometry.vectors import dot, length, take
from ...geometry.warps import cosine_hemisphere, uniform_sphere
from ...scene import Linking, World
from .base import Emitters, LightHits, Sample
from .environment_by_cosine import EnvironmentByCosine
from .environment_map import EnvironmentMap
from .openings import Openings

ALONE = 0.25
"""Of the directions to a picture, what follows its luminance alone where normals may be others than told."""

_LEAST = np.float32(1e-37)


class _World(Emitters):
    """What both kinds share: points in space are served by openings, surfaces are not. Measure: 1 / pdf.

    openings : through which most of it comes to points in space; None for from all sides.
    """

    at_infinity = True
    is_world = True
    openings: Openings | None = None

    def sample(self, which, position, normal, w, u):
        if normal is not None:
            return self._on_surface(normal, u)
        if self.openings is None:
            return self.in_space(u)
        direction, density = self.openings.sample(self, position, u)
        return direction, _measure(density)

    def pdf(self, which, position, normal, to_light):
        if normal is not None:
            return self._pdf_on_surface(normal, to_light)
        if self.openings is None:
            return self.pdf_in_space(to_light)
        return self.openings.pdf(self, position, to_light)

    def in_space(self, u: np.ndarray) -> Sample:
        """As of `openings.Everywhere`."""
        raise NotImplementedError

    def pdf_in_space(self, direction: np.ndarray) -> np.ndarray:
        """As of `openings.Everywhere`."""
        raise NotImplementedError

    def _on_surface(self, normal: np.ndarray, u: np.ndarray) -> Sample:
        """Directions (3, M) from points of ``normal`` (3, M), and measures (M,), at u (2, M)."""
        raise NotImplementedError

    def _pdf_on_surface(self, normal: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(M,) densities of these."""
        raise NotImplementedError

    @property
    def far_fluence(self):
        return np.float32(4 * np.pi) * self._brightness

    def met(self, which, position, directions):
        return np.ones((2, position.shape[1]), np.float32)


class WorldEmitter(_World):
    """Constant radiance from everywhere, by a cosine-weighted direction; from points in space by any."""

    def __init__(self, world: World) -> None:
        super().__init__(world.radiance[None], np.ones(1), [Linking()])

    def in_space(self, u):
        direction, measure = uniform_sphere(u)
        return direction, np.full(u.shape[1], measure)

    def pdf_in_space(self, direction):
        return np.full(direction.shape[1], np.float32(0.25 / np.pi))

    def _on_surface(self, normal, u):
        return cosine_hemisphere(normal, u)

    def _pdf_on_surface(self, normal, direction):
        cosine = dot(normal, direction) / length(direction)
        return np.maximum(cosine, 0) * np.float32(1 / np.pi)

    def irradiance(self, position, normal, which=None):
        return np.full((1, position.shape[1]), np.float32(np.pi) * self._brightness[0])

    def hits(self, position, directions, lights=None):
        n = position.shape[1]
        yield LightHits(np.arange(n), np.zeros(n, np.intp), np.ones(n, np.float32), None)


class ImageWorldEmitter(_World):
    """Radiance by a picture: directions follow its luminance times the cosine.

    Points in space have no cosine: for them directions follow the luminance alone.
    """

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

    def in_space(self, u):
        direction, density = self._map.sample(u)
        return direction.astype(np.float32), _measure(density)

    def pdf_in_space(self, direction):
        return self._map.pdf(direction)

    def _on_surface(self, normal, u):
        if not self._alone:
            direction, density = self._by_cosine.sample(normal, u)
            return direction.astype(np.float32), _measure(density)
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
        return direction, _measure(density)

    def _pdf_on_surface(self, normal, direction):
        density = self._by_cosine.pdf(normal, direction)
        if self._alone:
            density = (1 - self._alone) * density + self._alone * self._map.pdf(direction)
        return density

    def tint(self, which, to_light):
        return self._map.radiance(to_light)

    def hits(self, position, directions, lights=None):
        n = position.shape[1]
        yield LightHits(
            np.arange(n), np.zeros(n, np.intp), np.ones(n, np.float32), self._map.radiance(directions)
        )

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


def _measure(density: np.ndarray) -> np.ndarray:
    """(M,) 1 / density. Where that is 0, so is the light."""
    return np.where(density > 0, 1 / np.maximum(density, _LEAST), 0)
