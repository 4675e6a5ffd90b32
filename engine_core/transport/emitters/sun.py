# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns: disks at infinity."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry.vectors import dot, take
from ...geometry.warps import basis, cap
from ...scene import SunLight
from .base import Emitters, of


class SunEmitters(Emitters):
    """Suns, sampled by their cone. Measure: 1.

    axis : (3, L) float32, unit, towards them. sine : (L,) float32, of half the angles that they fill.
    """

    at_infinity = True

    def __init__(self, lights: Sequence[SunLight]) -> None:
        half = np.array([light.angle / 2 for light in lights])
        size = 4 * np.pi * np.sin(half / 2) ** 2
        strength = np.array([light.power for light in lights])
        for row, light, solid_angle, angle in zip(strength, lights, size, half, strict=True):
            # Solid angle over pi sin^2, without the quotient of two that vanish.
            row *= 2 / (1 + np.cos(angle)) if light.normalize else solid_angle if angle > 0 else 1
        super().__init__(strength, size, [light.links for light in lights])
        self.axis = np.array([-light.direction for light in lights], np.float32).T.copy()
        self._one_minus_cos = (2 * np.sin(half / 2) ** 2).astype(np.float32)
        self.sine = np.sin(half).astype(np.float32)
        self._frames = basis(self.axis)
        self._any_size = bool((half > 0).any())
        self.is_point = not self._any_size
        self._sized = np.flatnonzero(half > 0)
        self._visible = [i for i, light in enumerate(lights) if light.visible_to_camera and half[i] > 0]

    def sample(self, which, position, normal, w, u):
        m = position.shape[1]
        axis = of(self.axis, which)
        measure = np.ones(m, np.float32)
        if not self._any_size:
            return np.broadcast_to(axis, (3, m)), measure
        s, t = (of(f, which) for f in self._frames)
        x, y, below = cap(u[0], u[1], of(self._one_minus_cos, which))
        return x * s + y * t + (1 - below) * axis, measure

    def irradiance(self, position, normal, which=None):
        cosine = dot(self._column(self.axis, which), normal[:, None, :])
        size = self._column(self.sine, which)
        return self._column(self._brightness, which) * np.clip((cosine + size) / (1 + size), 0, 1)

    def pdf(self, which, position, normal, to_light):
        one_minus_cos = of(self._one_minus_cos, which)
        sized = one_minus_cos > 0
        density = np.where(sized, np.float32(0.5 / np.pi) / np.where(sized, one_minus_cos, 1), 0)
        return np.broadcast_to(density, position.shape[1])

    def _meet(self, light, position, directions):
        gap = directions - take(self.axis, light)
        # |unit - axis|^2 = 2 (1 - cos) keeps its digits for the half degree of a real sun.
        met = dot(gap, gap) <= 2 * self._one_minus_cos.take(light)
        return np.ones(met.shape, np.float32), met
