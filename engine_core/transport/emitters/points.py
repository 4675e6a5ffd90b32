# SPDX-License-Identifier: GPL-3.0-or-later
"""Point and spot lights: points, spheres, and disks that face the shaded point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry.frame import Frame
from ...geometry.vectors import dot, take
from ...geometry.warps import (
    basis,
    cap,
    cosine_hemisphere,
    sin_sqr_to_one_minus_cos,
    uniform_sphere,
)
from ...scene import Light, PointLight, SpotLight
from .base import FEW, Emitters, of, vectors_to
from .bounds import Bounds


class Cone:
    """The attenuation of spot lights; a point light is a spot open on all sides.

    inverse : (3, 3, L) float32, rows of the maps to the lights' own spaces, whose +Z a spot shines against.
    cos, sharpness : (L,) float32 of half the cone's angle, and 1 over the width of its edge in cosines.
    stretch : (L,) float32, by how much at most those spaces widen an angle.
    round_axis, round_cos : (3, L) and (L,) float64, round cones that hold what the scale makes of these.
    """

    def __init__(self, lights: Sequence[Light]) -> None:
        spots = [isinstance(light, SpotLight) for light in lights]
        self.any = any(spots)
        if not self.any:
            return
        self.inverse = np.zeros((3, 3, len(lights)), np.float32)
        self.cos = np.full(len(lights), -2.0, np.float32)
        self.sharpness = np.full(len(lights), 1e12, np.float32)
        self.stretch = np.ones(len(lights), np.float32)
        self.round_axis, self.round_cos = np.zeros((3, len(lights))), np.full(len(lights), -1.0)
        for i, light in enumerate(lights):
            if spots[i]:
                matrix = light.light_to_world[:3, :3]
                # A scale common to all axes changes no direction, but would underflow.
                inverse = np.linalg.inv(matrix / np.abs(matrix).max())
                self.inverse[:, :, i] = inverse / np.abs(inverse).max()
                widths = np.linalg.svd(inverse, compute_uv=False)
                self.stretch[i] = min(widths[0] / max(widths[-1], 1e-30), 1e30)
                cos = np.cos(light.angle / 2)
                self.cos[i] = cos
                self.sharpness[i] = 1 / max((1 - cos) * light.blend, 1e-12)
                whole = _round_cone(matrix / np.abs(matrix).max(), light.angle / 2)
                self.round_axis[:, i], self.round_cos[i] = whole

    def attenuation(self, which: np.ndarray | None, to_light: np.ndarray) -> np.ndarray:
        """(M,) in [0, 1]: smoothstep of the cosine to the axis, in the light's own (scaled) space."""
        return self.edge(which, self.inside(which, to_light))

    def inside(self, which: np.ndarray | None, to_light: np.ndarray) -> np.ndarray:
        """(M,) by how much the cosine to the axis exceeds the cone's."""
        inverse = of(self.inverse, which)
        x, y, z = (dot(inverse[i], to_light) for i in range(3))
        # to_light points at the light: along its +Z for what the spot faces.
        cosine = z / np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-30))
        cosine -= of(self.cos, which)
        return cosine

    def edge(self, which: np.ndarray | None, inside: np.ndarray) -> np.ndarray:
        """(M,) attenuation by what `inside` returns."""
        t = np.clip(inside * of(self.sharpness, which), 0, 1)
        return t * t * (3 - 2 * t)


class _Points(Emitters):
    """Point and spot lights: position, radius and ``cone``."""

    def __init__(self, lights: Sequence[PointLight | SpotLight], frame: Frame) -> None:
        radius = np.array([light.radius for light in lights])
        strength = np.array([light.power for light in lights]) * frame.scale**2
        for row, light in zip(strength, lights, strict=True):
            row /= 4 * np.pi if light.normalize else (1 / light.radius**2 if light.radius > 0 else np.pi)
        size = np.pi * (radius * frame.scale) ** 2
        super().__init__(strength, size, [light.links for light in lights])
        self._position = frame.positions([_position(light) for light in lights]).T.copy()
        self._radius = np.array([light.radius * frame.scale for light in lights], np.float32)
        self.centre, self.reach = self._position.astype(np.float64), self._radius.astype(np.float64)
        self._any_size = bool((self._radius > 0).any())
        self.cone = Cone(lights)
        if self.cone.any:
            self.cone_axis, self.cone_cos = self.cone.round_axis, self.cone.round_cos
        sized = [light.radius > 0 for light in lights]
        self._sized = np.flatnonzero(sized)
        if self._sized.size > FEW:
            centre, reach = take(self._position, self._sized), self._radius.take(self._sized)
            self._bounds = Bounds(centre - reach, centre + reach)
        self._visible = [i for i, light in enumerate(lights) if light.visible_to_camera and sized[i]]

    def _attenuate(self, measure: np.ndarray, which: np.ndarray | None, to_light: np.ndarray) -> np.ndarray:
        return measure * self.cone.attenuation(which, to_light) if self.cone.any else measure

    def _gain(self, light, position, directions):
        return self.cone.attenuation(light, directions) if self.cone.any else None

    def irradiance(self, position, normal, which=None):
        to_light = self._column(self._position, which) - position[:, None, :]
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        inverse = 1 / np.sqrt(square)
        cosine = dot(to_light, normal[:, None, :])
        cosine *= inverse
        if self._any_size:
            radius = self._column(self._radius, which)
            size = np.minimum(radius * inverse, 1)
            cosine += size
            cosine /= 1 + size
            square += radius * radius
        else:
            size = np.float32(0)
        estimate = np.clip(cosine, 0, 1, out=cosine)
        estimate *= self._column(self._brightness, which)
        estimate /= square
        if self.cone.any:
            light = np.arange(len(self)) if which is None else which
            light = np.broadcast_to(light[:, None], square.shape)
            inside = self.cone.inside(light, to_light)
            inside += np.float32(1e-3)
            # As far as any point of the light can be off its middle, in the light's own space.
            widest = np.float32(np.pi / 2) * self._column(self.cone.stretch, which)
            most = np.where(size < 1, np.minimum(size * widest, 2), np.float32(2))
            least = np.float32(1e-3) * (inside + most > 0)
            cone = self.cone.edge(light, inside + size)
            estimate *= np.maximum(cone, least)
        return estimate


class PointEmitters(_Points):
    """Lights without size. Measure: 1 / d^2."""

    is_point = True

    def sample(self, which, position, normal, w, u):
        to_light = vectors_to(self._position, which, position)
        measure = 1 / np.maximum(dot(to_light, to_light), np.float32(1e-30))
        return to_light, self._attenuate(measure, which, to_light)


class DiskEmitters(_Points):
    """Blender's "soft falloff": disks that face the shaded point, sampled by the cone that they fill.

    Measure: the cone's solid angle over the disk's area, 2 (1 - cos) / r^2 with tan = r / d.
    """

    def sample(self, which, position, normal, w, u):
        centre = vectors_to(self._position, which, position)
        radius = of(self._radius, which)
        square = np.maximum(dot(centre, centre), np.float32(1e-30))
        whole = square + radius * radius
        one_minus_cos = sin_sqr_to_one_minus_cos(radius * radius / whole)
        axis = centre / np.sqrt(square)
        x, y, below = cap(u[0], u[1], one_minus_cos)
        s, t = basis(axis)
        stretch = np.sqrt(square) / (1 - below)
        to_light = centre + (x * stretch) * s + (y * stretch) * t
        return to_light, self._attenuate(2 / (whole * (2 - one_minus_cos)), which, to_light)

    def pdf(self, which, position, normal, to_light):
        centre = vectors_to(self._position, which, position)
        square_radius = of(self._radius, which) ** 2
        sin_sqr = square_radius / (np.maximum(dot(centre, centre), np.float32(1e-30)) + square_radius)
        return _cone_pdf(sin_sqr_to_one_minus_cos(sin_sqr))

    def _meet(self, light, position, directions):
        centre, radius = take(self._position, light) - position, self._radius.take(light)
        along = dot(centre, directions)
        front = along > 0
        t = dot(centre, centre) / np.where(front, along, np.float32(1))
        gap = directions * t
        gap -= centre
        return t, front & (dot(gap, gap) <= radius * radius)


class SphereEmitters(_Points):
    """Spheres, sampled by the cone that they fill. Measure: its solid angle over pi r^2.

    That is 2 (1 - cos) / r^2 with sin = r / d. From inside a cosine-weighted direction, 1 / (r^2 cos), or, of
    points in space, any direction, 4 / r^2.
    """

    def sample(self, which, position, normal, w, u):
        centre = vectors_to(self._position, which, position)
        radius = of(self._radius, which)
        square = np.maximum(dot(centre, centre), np.float32(1e-30))
        inside = square <= radius * radius
        distance = np.sqrt(square)
        axis = centre / distance
        one_minus_cos = sin_sqr_to_one_minus_cos(np.minimum(radius * radius / square, 1))
        x, y, below = cap(u[0], u[1], one_minus_cos)
        s, t = basis(axis)
        direction = x * s + y * t + (1 - below) * axis
        sin_sqr = below * (2 - below)
        half_chord = np.sqrt(np.maximum(radius * radius - square * sin_sqr, 0))
        reach = distance * (1 - below) - half_chord
        measure = 2 / (square * (2 - one_minus_cos))
        if inside.any():
            lanes = np.flatnonzero(np.broadcast_to(inside, reach.shape))
            r = np.broadcast_to(radius, reach.shape)[lanes]
            if normal is None:
                d, out = uniform_sphere(u[:, lanes])
            else:
                d, out = cosine_hemisphere(normal[:, lanes], u[:, lanes])
            along = dot(d, centre[:, lanes])
            direction[:, lanes] = d
            reach[lanes] = along + np.sqrt(np.maximum(r * r - square[lanes] + along * along, 0))
            measure = self._attenuate(measure * np.ones_like(reach), which, direction)
            measure[lanes] = out / np.maximum(np.float32(np.pi) * r * r, np.float32(1e-37))
            return direction * reach, measure
        return direction * reach, self._attenuate(measure, which, direction)

    def irradiance(self, position, normal, which=None):
        estimate = super().irradiance(position, normal, which)
        to_light = self._column(self._position, which) - position[:, None, :]
        square = np.maximum(self._column(self._radius, which) ** 2, np.float32(1e-37))
        inside = dot(to_light, to_light) <= np.float32(1.0001) * square
        return np.where(inside, self._column(self._brightness, which) / square, estimate)

    def pdf(self, which, position, normal, to_light):
        centre = vectors_to(self._position, which, position)
        square_radius = of(self._radius, which) ** 2
        square = np.maximum(dot(centre, centre), np.float32(1e-30))
        pdf = _cone_pdf(sin_sqr_to_one_minus_cos(np.minimum(square_radius / square, 1)))
        inside = square <= square_radius
        if normal is None:
            pdf = np.where(inside, np.float32(0.25 / np.pi), pdf)
        elif inside.any():
            cosine = dot(normal, to_light) / np.sqrt(np.maximum(dot(to_light, to_light), np.float32(1e-30)))
            pdf = np.where(inside, np.maximum(cosine, 0) * np.float32(1 / np.pi), pdf)
        return pdf

    def _meet(self, light, position, directions):
        centre, radius = take(self._position, light) - position, self._radius.take(light)
        along = dot(centre, directions)
        gap = along * directions
        gap -= centre
        half = radius * radius - dot(gap, gap)
        met = half >= 0
        half = np.sqrt(np.maximum(half, 0))
        t = np.where(along - half > 0, along - half, along + half)
        return t, met & (t > 0)

    def _gain(self, light, position, directions):
        # Within a sphere there is no cone, as in Cycles.
        gain = super()._gain(light, position, directions)
        if gain is None:
            return None
        centre = take(self._position, light) - position
        inside = dot(centre, centre) <= take(self._radius, light) ** 2
        return np.where(inside, np.float32(1), gain)


def _position(light: PointLight | SpotLight) -> np.ndarray:
    return light.light_to_world[:3, 3] if isinstance(light, SpotLight) else light.position


def _round_cone(matrix: np.ndarray, half: float) -> tuple[np.ndarray, float]:
    """Axis and cosine of a cone that holds the one of angle ``half`` about -Z, seen through ``matrix``."""
    turn = np.linspace(0, 2 * np.pi, 64)
    rim = matrix @ np.stack(
        [np.sin(half) * np.cos(turn), np.sin(half) * np.sin(turn), 0 * turn - np.cos(half)]
    )
    axis = -matrix[:, 2] / np.linalg.norm(matrix[:, 2])
    angle = np.arccos(np.clip(axis @ rim / np.linalg.norm(rim, axis=0), -1, 1)).max()
    if angle > np.pi / 2 + 1e-6:
        return axis, -1.0
    # A little more, for what lies between two points of the rim.
    return axis, max(np.cos(1.005 * angle), 0.0)


def _cone_pdf(one_minus_cos: np.ndarray) -> np.ndarray:
    """Density of uniform directions in a cone."""
    return np.float32(0.5 / np.pi) / np.maximum(one_minus_cos, np.float32(1e-37))
