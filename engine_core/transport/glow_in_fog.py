# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of glowing fog that fog scatters once, the same or another: an integral beside that of lights.

    L = integral along the ray of T(t) integral over directions sum_g sigma_g p_g(cos) E dw dt

E is the radiance of glowing fog that a point of the ray sees in a direction, which needs no dimension of its
own: `Media` integrate it. A sample is of one technique: distances by free paths and directions by the phase
functions, or, as fire in fog wants it, both by a body that glows: distances about it, directions to a ball
around it. The balance heuristic weighs them: its values are divided by the density of all together.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.vectors import dot, take
from . import phase
from .direct_light import SHADOW, _inset
from .distance_maps import EquiAngular, FreePath, within_depth
from .glowing_bodies import Cap, brightest, chosen
from .shadows import Shadows
from .single_scattering import FogRays, Scattered, SingleScattering

BALLS = 8
"""Of the bodies that glow, those that samples look for: the brightest."""


class ScatteredGlow(Scattered):
    """The integrand: one point of a camera ray, and one direction there, at a time."""

    rest_dimensions = 3

    def __init__(
        self, scattering: SingleScattering, shadows: Shadows, check: Callable[[], None] = lambda: None
    ) -> None:
        """shadows : that know of the fog. check : called before every batch; may raise, to give up."""
        super().__init__(scattering, np.zeros(0, np.intp), check)
        self._shadows = shadows
        # Where only what glows scatters, there is light from everywhere.
        self._balls = brightest(scattering.media)[:BALLS] if scattering.media.glowing()[1] else []
        bright = np.array([ball[2] for ball in self._balls])
        self._chances = np.append(0.5, 0.5 * bright / bright.sum()) if self._balls else np.ones(1)

    def rest(self, rays: FogRays, lane: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Which (J,) of points u (3, M, S), of distance and direction, of M rays get radiance (3, J).

        u : (3, N) for rays ``lane`` (N,).
        """
        self._check()
        ray = np.repeat(np.arange(len(rays)), u.shape[2]) if lane is None else lane
        u = _inset(u).reshape(3, -1)
        if ray.size == 0:
            return np.zeros(0, np.intp), np.zeros((3, 0), np.float32)
        media, fog = rays.media, self._scattering.media
        place = self._segment(rays, ray, None, u[0][:, None])
        row = place.row
        mixture, start = media.mixture.take(row), media.start.take(row)
        direction, origin = take(rays.direction, ray), take(rays.origin, ray)
        origin = origin + direction * start
        technique, u = chosen(self._chances[:, None], u[1:])

        sigma = self._scattering.thinnest.take(mixture)
        length = within_depth(sigma, media.end.take(row) - start)
        maps = [FreePath(sigma, length)] + [
            _about(centre, radius, origin, direction, length) for centre, radius, _ in self._balls
        ]
        t = np.choose(technique, [of.sample(place.u[:, 0]) for of in maps])
        position = origin + direction * t

        lobes = _Lobes(fog.scattering.take(mixture, axis=2), fog.anisotropy, direction)
        ways = [lobes] + [Cap(centre, radius, position) for centre, radius, _ in self._balls]
        towards = np.empty_like(position)
        for number, way in enumerate(ways):
            rows = np.flatnonzero(technique == number)
            towards[:, rows] = way.sample(rows, take(u, rows))
        density = np.zeros(len(ray))
        for chance, of, way in zip(self._chances, maps, ways, strict=True):
            density += chance * of.pdf(t) * way.pdf(towards)

        depth = take(media.depth, row) + take(fog.extinction, mixture) * t
        value = np.exp(-depth) * lobes.scattered(towards) / (density * place.chance)
        if rays.through is not None:
            value *= take(rays.through, row)
        lit = np.flatnonzero(value.any(axis=0))
        origins, directions = (np.ascontiguousarray(take(x, lit).T, np.float32) for x in (position, towards))
        self._count(SHADOW, len(lit))
        glow = self._shadows.glow(origins, directions, media.inside.take(row.take(lit)))
        return lit, self._bounded(take(value, lit) * glow)


def _about(
    centre: np.ndarray, radius: float, origin: np.ndarray, direction: np.ndarray, length: np.ndarray
) -> EquiAngular:
    """Distances along rays (3, N) about a ball, which softens the peak."""
    vector = centre[:, None] - origin
    foot = dot(vector, direction)
    vector -= foot * direction
    return EquiAngular(foot, np.sqrt(dot(vector, vector) + radius * radius), length)


class _Lobes:
    """Directions by N mixtures of phase functions, each as often as it scatters of grey light.

    Where light comes from is as far from where the camera ray goes to as its two directions of travel are.
    """

    def __init__(self, coefficients: np.ndarray, anisotropy: np.ndarray, direction: np.ndarray) -> None:
        """coefficients : (G, 3, N). anisotropy : (G,). direction : (3, N) of the camera rays."""
        self._coefficients, self._anisotropy, self._direction = coefficients, anisotropy, direction
        self._share = coefficients.mean(axis=1)
        self._share /= self._share.sum(axis=0)

    def sample(self, rows: np.ndarray, u: np.ndarray) -> np.ndarray:
        which, u = chosen(self._share.take(rows, axis=1), u)
        return phase.sample(take(self._direction, rows), self._anisotropy.take(which), u)

    def pdf(self, towards: np.ndarray) -> np.ndarray:
        return (self._share * self._values(towards)).sum(axis=0)

    def scattered(self, towards: np.ndarray) -> np.ndarray:
        """(3, N) of light from there, per length and solid angle."""
        return (self._coefficients * self._values(towards)[:, None]).sum(axis=0)

    def _values(self, towards: np.ndarray) -> np.ndarray:
        angle = phase.half_angle(towards, self._direction)
        return np.stack([phase.value(*angle, g) for g in self._anisotropy])
