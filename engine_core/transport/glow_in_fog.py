# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of glowing fog that fog scatters once, the same or another: an integral beside that of lights.

    L = integral along the ray of T(t) integral over directions sum_g sigma_g p_g(cos) E dw dt

E is the radiance of glowing fog that a point of the ray sees in a direction, which needs no dimension of its
own: `Media` integrate it. Distances follow free paths, directions the phase functions, each as often as it
scatters of grey light; their weights are those of their mixture.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.vectors import take
from . import phase
from .direct_light import SHADOW, _inset
from .distance_maps import FreePath, within_depth
from .shadows import Shadows
from .single_scattering import FogRays, Scattered, SingleScattering


class ScatteredGlow(Scattered):
    """The integrand: one point of a camera ray, and one direction there, at a time."""

    rest_dimensions = 3

    def __init__(
        self, scattering: SingleScattering, shadows: Shadows, check: Callable[[], None] = lambda: None
    ) -> None:
        """shadows : that know of the fog. check : called before every batch; may raise, to give up."""
        super().__init__(scattering, np.zeros(0, np.intp), check)
        self._shadows = shadows

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
        sigma = self._scattering.thinnest.take(mixture)
        path = FreePath(sigma, within_depth(sigma, media.end.take(row) - start))
        t = path.sample(place.u[:, 0])
        depth = take(media.depth, row) + take(fog.extinction, mixture) * t
        value = np.exp(-depth) / (path.pdf(t) * place.chance)
        direction = take(rays.direction, ray)
        position = take(rays.origin, ray) + direction * (start + t)
        to_glow, scattered = self._scattered(direction, mixture, u[1:])
        value = value * scattered
        if rays.through is not None:
            value *= take(rays.through, row)
        lit = np.flatnonzero(value.any(axis=0))
        origins, directions = (np.ascontiguousarray(take(x, lit).T, np.float32) for x in (position, to_glow))
        self._count(SHADOW, len(lit))
        glow = self._shadows.glow(origins, directions, media.inside.take(row.take(lit)))
        return lit, self._bounded(take(value, lit) * glow)

    def _scattered(
        self, direction: np.ndarray, mixture: np.ndarray, u: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Directions (3, N) to where light comes from that goes on against ``direction`` (3, N), at u (2, N);
        and what part of it per length, over their density (3, N)."""
        fog = self._scattering.media
        coefficients = fog.scattering.take(mixture, axis=2)
        share = coefficients.mean(axis=1)
        share /= share.sum(axis=0)
        # Part of the first dimension tells which phase function.
        upper = np.cumsum(share, axis=0)
        which = np.minimum((u[0] >= upper).sum(axis=0), len(share) - 1)
        own = np.take_along_axis(share, which[None], axis=0)[0]
        below = np.take_along_axis(upper, which[None], axis=0)[0] - own
        v = np.stack([np.clip((u[0] - below) / own, 0, 1), u[1]])
        found = phase.sample(direction, fog.anisotropy.take(which), v)
        less, more = phase.half_angle(found, direction)
        values = np.stack([phase.value(less, more, g) for g in fog.anisotropy])
        density = (share * values).sum(axis=0)
        return found, (coefficients * values[:, None]).sum(axis=0) / density
