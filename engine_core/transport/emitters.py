# SPDX-License-Identifier: GPL-3.0-or-later
"""Light sources as functions of a point in primary space: every map beside its measure.

Lights of one kind form a group that is sampled at once. A light has a *strength*, its radiance times
its size (the area that faces a viewer; a sun's solid angle), which is finite for a light without size.
A sample is a vector to a point of the light and a *measure*: what the strength must be multiplied with,
besides the surface's cosine, to give irradiance; that is the light's own cosine, the change of variables
to solid angle and one over pdf and size, together, so that nothing singular is ever formed. Here, and
nowhere else, watts become radiance, as Cycles has it:

    point, spot   L = P / (4 pi^2 r^2), or intensity I = P / (4 pi) for r = 0
    area          L = P / (pi A)
    sun           L = E / (pi sin^2 a), a the half angle, or irradiance E for a = 0

and without ``normalize`` the same for unit size: L = P / pi (I = P / pi, L = E). All lengths are in
the frame's units.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..geometry.frame import Frame
from ..geometry.raytracer import FAR
from ..geometry.triangles import Triangles
from ..geometry.vectors import dot, length, take
from ..scene import AreaLight, Light, Material, PointLight, SpotLight, SunLight, World
from .warps import basis, cap, concentric_disk, sin_sqr_to_one_minus_cos

Sample = tuple[np.ndarray, np.ndarray]

_LARGEST = 1e37
"""What no strength or radiance exceeds, so that float32 has room for a few factors."""


class Emitters:
    """A group of lights of one kind.

    strength : (3, L) float32, radiance times size.
    size : (L,) float64, 0 where a light has none.
    casts_shadow : (L,) bool.
    at_infinity : no distance. is_mesh : part of the traced triangles. is_point : none has a size.
    """

    at_infinity = False
    is_mesh = False
    is_point = False

    def __init__(self, strength: np.ndarray, size: np.ndarray, casts_shadow: Sequence[bool]) -> None:
        """strength : (L, 3) float64. size : (L,) float64, 0 where a light has none."""
        self.strength = np.minimum(strength, _LARGEST).T.astype(np.float32)
        self.casts_shadow = np.array(casts_shadow, bool)
        self._brightness = (self.strength / 3).sum(axis=0)
        self.size = np.asarray(size, np.float64)
        with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
            self._radiance = np.minimum(np.asarray(strength).T / self.size, _LARGEST).astype(np.float32)

    def __len__(self) -> int:
        return self.strength.shape[1]

    def sample(
        self, which: np.ndarray | None, position: np.ndarray, normal: np.ndarray, w: np.ndarray, u: np.ndarray
    ) -> Sample:
        """Vectors to the light (3, M) and measures (M,).

        which : (M,) index into the group, None if it has but one light.
        position, normal : (3, M) shaded points.
        w : (M,) and u : (2, M), uniform in (0, 1).
        """
        raise NotImplementedError

    def irradiance(
        self, position: np.ndarray, normal: np.ndarray, which: np.ndarray | None = None
    ) -> np.ndarray:
        """(L', M) quick, generous estimates of unshadowed irradiance, for choosing among the lights.

        Of all lights, or of ``which`` (L',). Positive wherever a light might reach the point.
        """
        raise NotImplementedError

    def seen(self, origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray | None:
        """(3, N) radiance of lights that camera rays see before ``distance`` (N,), None if there are none."""
        return None

    def _column(self, table: np.ndarray, which: np.ndarray | None) -> np.ndarray:
        """Rows of a table (..., L) as a column (..., L', 1), to be met with points (..., 1, M)."""
        return _of(table, which)[..., None]


def _of(table: np.ndarray, which: np.ndarray | None) -> np.ndarray:
    """Rows of a group's table (..., L) for each lane; a single light is broadcast."""
    return table if which is None else take(table, which)


class _Cone:
    """The attenuation of spot lights; a point light is a spot open on all sides."""

    def __init__(self, lights: Sequence[Light]) -> None:
        spots = [isinstance(light, SpotLight) for light in lights]
        self.any = any(spots)
        if not self.any:
            return
        self._inverse = np.zeros((3, 3, len(lights)), np.float32)
        self._cos = np.full(len(lights), -2.0, np.float32)
        self._sharpness = np.full(len(lights), 1e12, np.float32)
        for i, light in enumerate(lights):
            if spots[i]:
                matrix = light.light_to_world[:3, :3]
                # A scale common to all axes changes no direction, but would underflow.
                inverse = np.linalg.inv(matrix / np.abs(matrix).max())
                self._inverse[:, :, i] = inverse / np.abs(inverse).max()
                cos = np.cos(light.angle / 2)
                self._cos[i] = cos
                self._sharpness[i] = 1 / max((1 - cos) * light.blend, 1e-12)

    def attenuation(self, which: np.ndarray | None, to_light: np.ndarray, slack: float = 0.0) -> np.ndarray:
        """(M,) in [0, 1]: smoothstep of the cosine to the axis, in the light's own (scaled) space.

        slack : added to the cosine; makes an estimate generous.
        """
        inverse = _of(self._inverse, which)
        x, y, z = (dot(inverse[i], to_light) for i in range(3))
        # to_light points at the light: along its +Z for what the spot faces.
        cosine = z / np.maximum(np.sqrt(x * x + y * y + z * z), np.float32(1e-30))
        t = np.clip((cosine + slack - _of(self._cos, which)) * _of(self._sharpness, which), 0, 1)
        return t * t * (3 - 2 * t)


class _Points(Emitters):
    """Point and spot lights: position, radius and cone."""

    def __init__(self, lights: Sequence[PointLight | SpotLight], frame: Frame) -> None:
        radius = np.array([light.radius for light in lights])
        strength = np.array([light.power for light in lights]) * frame.scale**2
        for row, light in zip(strength, lights, strict=True):
            row /= 4 * np.pi if light.normalize else (1 / light.radius**2 if light.radius > 0 else np.pi)
        size = np.pi * (radius * frame.scale) ** 2
        super().__init__(strength, size, [light.casts_shadow for light in lights])
        self._position = frame.positions([_position(light) for light in lights]).T.copy()
        self._radius = np.array([light.radius * frame.scale for light in lights], np.float32)
        self._any_size = bool((self._radius > 0).any())
        self._cone = _Cone(lights)
        self._visible = [i for i, light in enumerate(lights) if light.visible_to_camera and light.radius > 0]

    def _attenuate(self, measure: np.ndarray, which: np.ndarray | None, to_light: np.ndarray) -> np.ndarray:
        return measure * self._cone.attenuation(which, to_light) if self._cone.any else measure

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
        if self._cone.any:
            light = np.arange(len(self)) if which is None else which
            light = np.broadcast_to(light[:, None], square.shape)
            cone = self._cone.attenuation(light, to_light, size + np.float32(1e-3))
            estimate *= np.where(cone > 0, np.maximum(cone, np.float32(1e-3)), 0)
        return estimate


class PointEmitters(_Points):
    """Lights without size. Measure: 1 / d^2."""

    is_point = True

    def sample(self, which, position, normal, w, u):
        to_light = _of(self._position, which) - position
        measure = 1 / np.maximum(dot(to_light, to_light), np.float32(1e-30))
        return to_light, self._attenuate(measure, which, to_light)


class DiskEmitters(_Points):
    """Blender's "soft falloff": disks that face the shaded point, sampled by the cone that they fill.

    Measure: the cone's solid angle over the disk's area, 2 (1 - cos) / r^2 with tan = r / d.
    """

    def sample(self, which, position, normal, w, u):
        centre = _of(self._position, which) - position
        radius = _of(self._radius, which)
        square = np.maximum(dot(centre, centre), np.float32(1e-30))
        whole = square + radius * radius
        one_minus_cos = sin_sqr_to_one_minus_cos(radius * radius / whole)
        axis = centre / np.sqrt(square)
        x, y, below = cap(u[0], u[1], one_minus_cos)
        s, t = basis(axis)
        stretch = np.sqrt(square) / (1 - below)
        to_light = centre + (x * stretch) * s + (y * stretch) * t
        return to_light, self._attenuate(2 / (whole * (2 - one_minus_cos)), which, to_light)

    def seen(self, origins, directions, distance):
        def intersect(i: int) -> tuple[np.ndarray, np.ndarray]:
            centre = self._position[:, i][:, None] - origins.T
            along = dot(centre, directions.T)
            t = dot(centre, centre) / np.where(along > 0, along, np.float32(1))
            gap = directions.T * t - centre
            return t, (along > 0) & (dot(gap, gap) <= self._radius[i] ** 2)

        return _seen(self, self._visible, intersect, directions, distance)


class SphereEmitters(_Points):
    """Spheres, sampled by the cone that they fill. Measure: its solid angle over pi r^2.

    That is 2 (1 - cos) / r^2 with sin = r / d. From inside a cosine-weighted direction, 1 / (r^2 cos).
    """

    def sample(self, which, position, normal, w, u):
        centre = _of(self._position, which) - position
        radius = _of(self._radius, which)
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
            d, out = _cosine_hemisphere(normal[:, lanes], u[:, lanes])
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

    def seen(self, origins, directions, distance):
        def intersect(i: int) -> tuple[np.ndarray, np.ndarray]:
            centre = self._position[:, i][:, None] - origins.T
            inverse = 1 / length(directions.T)
            d = directions.T * inverse
            along = dot(centre, d)
            gap = along * d - centre
            half = self._radius[i] ** 2 - dot(gap, gap)
            half = np.where(half >= 0, np.sqrt(np.maximum(half, 0)), np.nan)
            t = np.where(along - half > 0, along - half, along + half) * inverse
            return t, np.isfinite(t) & (t > 0)

        return _seen(self, self._visible, intersect, directions, distance)


# A rectangle seen under more than this solid angle is sampled by it; a smaller one's area will do.
_SMALL = np.float32(0.3)


class AreaEmitters(Emitters):
    """Rectangles and ellipses, one-sided. Measure times the spread's grid, where there is one.

    Sampled by area, measure cos / d^2; a rectangle that is large for the shaded point by its solid
    angle, which over its area is the measure: nothing peaks however near it is.
    """

    def __init__(self, lights: Sequence[AreaLight], frame: Frame) -> None:
        rows = []
        for light in lights:
            axes = light.light_to_world[:3, :3]
            edges = [axes[:, k] * light.size[k] for k in range(2)]
            lengths = [np.linalg.norm(edge) for edge in edges]
            area = lengths[0] * lengths[1] * (np.pi / 4 if light.ellipse else 1)
            strength = light.power / np.pi * (1 if light.normalize else area) * frame.scale**2
            half = 0.5 * max(light.spread, 2e-3)
            open_grid = light.spread >= np.pi - 1e-5
            tan_half = np.inf if open_grid else np.tan(half)
            # Integral of cos (1 - tan / tan half) over the cone, divided by tan half (Cycles' own).
            normalise = 0 if open_grid else (1 / (tan_half - half) if half > 0.05 else 3 / half**3)
            facing = -axes[:, 2] / np.linalg.norm(axes[:, 2])
            rows.append((edges, facing, area * frame.scale**2, tan_half, normalise, strength))
        size = np.array([row[2] for row in rows])
        super().__init__(np.array([row[5] for row in rows]), size, [light.casts_shadow for light in lights])
        self._centre = frame.positions([light.light_to_world[:3, 3] for light in lights]).T.copy()
        self._edge_x, self._edge_y = (
            np.array([row[0][k] * frame.scale for row in rows], np.float32).T.copy() for k in range(2)
        )
        self._facing = np.array([row[1] for row in rows], np.float32).T.copy()
        self._area = size.astype(np.float32)
        self._ellipse = np.array([light.ellipse for light in lights])
        self._tan_half = np.array([min(row[3], 1e30) for row in rows], np.float32)
        self._normalise = np.array([row[4] for row in rows], np.float32)
        self._any_grid = bool(self._normalise.any())
        lengths = length(self._edge_x), length(self._edge_y)
        self._reach = 0.5 * (lengths[0] + lengths[1])
        sheared = np.abs(dot(self._edge_x, self._edge_y)) > 1e-4 * lengths[0] * lengths[1]
        # No solid angle for what is no rectangle.
        self._large = np.where(sheared | self._ellipse, np.float32(0), self._area / _SMALL)
        self._visible = [i for i, light in enumerate(lights) if light.visible_to_camera]

    def _grid(self, which: np.ndarray | None, cosine: np.ndarray) -> np.ndarray:
        """The part of the light that a soft box's grid lets through at an angle (Cycles' "spread")."""
        tan = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(cosine, np.float32(1e-12))
        normalise = _of(self._normalise, which)
        part = np.maximum(_of(self._tan_half, which) - tan, 0) * normalise
        return np.where(normalise > 0, part, np.float32(1))

    def sample(self, which, position, normal, w, u):
        ellipse = _of(self._ellipse, which)
        x, y = u[0] - np.float32(0.5), u[1] - np.float32(0.5)
        if ellipse.any():
            dx, dy = concentric_disk(u[0], u[1])
            x, y = np.where(ellipse, 0.5 * dx, x), np.where(ellipse, 0.5 * dy, y)
        edge_x, edge_y, facing = (_of(t, which) for t in (self._edge_x, self._edge_y, self._facing))
        centre = _of(self._centre, which) - position
        to_light = centre + x * edge_x
        to_light += y * edge_y
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        cosine_d = np.maximum(-dot(facing, to_light), 0)
        inverse = 1 / np.sqrt(square)
        measure = cosine_d * inverse / square
        near = np.flatnonzero(dot(centre, centre) < _of(self._large, which))
        if near.size:
            edges = [e if e.shape[1] == 1 else take(e, near) for e in (edge_x, edge_y, facing)]
            vector, solid_angle = _spherical_rectangle(take(centre, near), *edges, take(u, near))
            use = np.flatnonzero(solid_angle > 0)
            near = near.take(use)
            to_light[:, near] = take(vector, use)
            area = self._area if which is None else self._area.take(which.take(near))
            measure[near] = solid_angle.take(use) / area
            if self._any_grid:
                cosine_d[near] = np.maximum(-dot(np.broadcast_to(facing, to_light.shape), to_light), 0)[near]
                inverse[near] = 1 / np.sqrt(np.maximum(dot(to_light, to_light), np.float32(1e-30)))[near]
        if self._any_grid:
            measure *= self._grid(which, np.minimum(cosine_d * inverse, 1))
        return to_light, measure

    def irradiance(self, position, normal, which=None):
        to_light = self._column(self._centre, which) - position[:, None, :]
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        reach = self._column(self._reach, which)
        inverse = 1 / np.sqrt(square)
        size = np.minimum(reach * inverse, 1)
        estimate = dot(to_light, normal[:, None, :])
        estimate *= inverse
        estimate += size
        estimate /= 1 + size
        np.clip(estimate, 0, 1, out=estimate)
        # A light's own plane can't be smoothed over: what lies behind all of it stays dark.
        height = -dot(self._column(self._facing, which), to_light)
        size *= np.float32(0.5)
        light = height * inverse
        light += size
        light /= 1 + size
        estimate *= np.clip(light, 0, 1, out=light)
        estimate *= height > np.float32(-1e-5) * reach
        estimate *= self._column(self._brightness, which)
        square += self._column(self._area, which) * np.float32(1 / np.pi)
        estimate /= square
        return estimate

    def seen(self, origins, directions, distance):
        def intersect(i: int) -> tuple[np.ndarray, np.ndarray]:
            facing = self._facing[:, i]
            towards = -(directions @ facing)
            centre = self._centre[:, i] - origins
            t = -(centre @ facing) / np.where(towards > 0, towards, np.float32(1))
            gap = directions * t[:, None] - centre
            ex, ey = self._edge_x[:, i], self._edge_y[:, i]
            a, b = gap @ ex / max(ex @ ex, 1e-37), gap @ ey / max(ey @ ey, 1e-37)
            inside = (a * a + b * b <= 0.25) if self._ellipse[i] else (np.abs(a) <= 0.5) & (np.abs(b) <= 0.5)
            return t, (towards > 0) & (t > 0) & inside

        def weight(i: int) -> np.ndarray | float:
            if not self._normalise[i]:
                return 1.0
            cosine = -(directions @ self._facing[:, i]) / length(directions.T)
            return self._grid(np.array([i]), np.clip(cosine, 0, 1))

        return _seen(self, self._visible, intersect, directions, distance, weight)


class SunEmitters(Emitters):
    """Suns, sampled by their cone. Measure: 1."""

    at_infinity = True

    def __init__(self, lights: Sequence[SunLight]) -> None:
        half = np.array([light.angle / 2 for light in lights])
        size = 4 * np.pi * np.sin(half / 2) ** 2
        strength = np.array([light.power for light in lights])
        for row, light, solid_angle, angle in zip(strength, lights, size, half, strict=True):
            # Solid angle over pi sin^2, without the quotient of two that vanish.
            row *= 2 / (1 + np.cos(angle)) if light.normalize else solid_angle if angle > 0 else 1
        super().__init__(strength, size, [light.casts_shadow for light in lights])
        self._axis = np.array([-light.direction for light in lights], np.float32).T.copy()
        self._one_minus_cos = (2 * np.sin(half / 2) ** 2).astype(np.float32)
        self._sin = np.sin(half).astype(np.float32)
        self._frames = basis(self._axis)
        self._any_size = bool((half > 0).any())
        self.is_point = not self._any_size
        self._visible = [i for i, light in enumerate(lights) if light.visible_to_camera and light.angle > 0]

    def sample(self, which, position, normal, w, u):
        m = position.shape[1]
        axis = _of(self._axis, which)
        measure = np.ones(m, np.float32)
        if not self._any_size:
            return np.broadcast_to(axis, (3, m)), measure
        s, t = (_of(f, which) for f in self._frames)
        x, y, below = cap(u[0], u[1], _of(self._one_minus_cos, which))
        return x * s + y * t + (1 - below) * axis, measure

    def irradiance(self, position, normal, which=None):
        cosine = dot(self._column(self._axis, which), normal[:, None, :])
        size = self._column(self._sin, which)
        return self._column(self._brightness, which) * np.clip((cosine + size) / (1 + size), 0, 1)

    def seen(self, origins, directions, distance):
        def intersect(i: int) -> tuple[np.ndarray, np.ndarray]:
            unit = directions / length(directions.T)[:, None]
            gap = unit - self._axis[:, i]
            # |unit - axis|^2 = 2 (1 - cos) keeps its digits for the half degree of a real sun.
            inside = 0.5 * (gap * gap).sum(axis=1) <= self._one_minus_cos[i]
            return np.full(len(directions), FAR, np.float32), inside

        return _seen(self, self._visible, intersect, directions, distance)


class WorldEmitter(Emitters):
    """Constant radiance from everywhere, by a cosine-weighted direction. Measure: pi / cos."""

    at_infinity = True

    def __init__(self, world: World) -> None:
        super().__init__(world.radiance[None], np.ones(1), [True])

    def sample(self, which, position, normal, w, u):
        return _cosine_hemisphere(normal, u)

    def irradiance(self, position, normal, which=None):
        return np.full((1, position.shape[1]), np.float32(np.pi) * self._brightness[0])


class MeshEmitters(Emitters):
    """Meshes with an emissive material, by area and from both sides. Measure: |cos| / d^2.

    A light is a cluster of neighbouring triangles of one material; ``w`` chooses among them.
    """

    is_mesh = True

    def __init__(
        self, radiance: Sequence[np.ndarray], rows: Sequence[np.ndarray], triangles: Triangles
    ) -> None:
        row = np.concatenate(rows)
        corner, a, b = (triangles.vertices[triangles.indices[row, k]].astype(np.float64) for k in range(3))
        a -= corner
        b -= corner
        normal = np.cross(a, b)
        double_area = np.linalg.norm(normal, axis=1)
        self._corner, self._a, self._b = (np.ascontiguousarray(x.T, np.float32) for x in (corner, a, b))
        with np.errstate(invalid="ignore", divide="ignore"):
            self._normal = np.nan_to_num(normal.T / double_area).astype(np.float32)
        counts = np.array([len(r) for r in rows])
        self._start = np.concatenate([[0], np.cumsum(counts)])
        light = np.repeat(np.arange(len(rows)), counts)
        area = np.bincount(light, 0.5 * double_area, minlength=len(rows))
        super().__init__(np.asarray(radiance) * area[:, None], area, [True] * len(rows))
        # One ascending table for all lights: light number + share of its area.
        share = np.cumsum(0.5 * double_area) - np.concatenate([[0], np.cumsum(area)])[light]
        self._table = light + np.clip(share / np.maximum(area[light], 1e-300), 0, 1)
        middle = (corner + (a + b) / 3).T
        total = np.maximum(area, 1e-300)
        self._centre = np.stack(
            [np.bincount(light, 0.5 * double_area * m, minlength=len(rows)) / total for m in middle]
        ).astype(np.float32)
        far = np.zeros(len(rows))
        for offset in (0, a, b):
            gap = np.linalg.norm(corner + offset - self._centre.T[light], axis=1)
            np.maximum.at(far, light, gap)
        self._reach = far.astype(np.float32)

    def sample(self, which, position, normal, w, u):
        light = np.zeros(position.shape[1], np.intp) if which is None else which
        triangle = np.searchsorted(self._table, light + w.astype(np.float64), side="right")
        np.clip(triangle, self._start[light], self._start[light + 1] - 1, out=triangle)
        root = np.sqrt(u[0])
        b1, b2 = 1 - root, root * u[1]
        to_light = take(self._corner, triangle) - position
        to_light += b1 * take(self._a, triangle)
        to_light += b2 * take(self._b, triangle)
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        cosine_d = np.abs(dot(take(self._normal, triangle), to_light))
        return to_light, cosine_d / (square * np.sqrt(square))

    def irradiance(self, position, normal, which=None):
        to_light = self._column(self._centre, which) - position[:, None, :]
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        reach = self._column(self._reach, which)
        inverse = 1 / np.sqrt(square)
        size = np.minimum(reach * inverse, 1)
        estimate = np.clip((dot(to_light, normal[:, None, :]) * inverse + size) / (1 + size), 0, 1)
        # Seen from a random side, a flat light shows half of its area.
        estimate *= np.float32(0.5) * self._column(self._brightness, which)
        return estimate / (square + reach * reach)


def _spherical_rectangle(
    centre: np.ndarray, edge_x: np.ndarray, edge_y: np.ndarray, facing: np.ndarray, u: np.ndarray
) -> Sample:
    """Vectors (3, M) to points of a rectangle, uniform in solid angle, and that angle (M,).

    C. Urena, M. Fajardo, A. King, "An Area-Preserving Parametrization for Spherical Rectangles",
    2013. The angle is 0 where it is too small for this map, or the rectangle turns its back.
    """
    length_x, length_y = length(edge_x), length(edge_y)
    x, y = edge_x / length_x, edge_y / length_y
    z0 = dot(facing, centre)
    height = np.maximum(-z0, np.float32(1e-30))
    xc, yc = dot(x, centre), dot(y, centre)
    x0, x1 = xc - 0.5 * length_x, xc + 0.5 * length_x
    y0, y1 = yc - 0.5 * length_y, yc + 0.5 * length_y
    squared = height * height
    # z components of the normals of the four planes through the edges.
    n0, n1, n2, n3 = (a / np.sqrt(a * a + squared) for a in (-y0, x1, y1, -x0))
    # Inner angles less pi / 2, whose sum is the solid angle without cancellation.
    g0, g1, g2, g3 = (np.arcsin(a * b) for a, b in ((n0, n1), (n1, n2), (n2, n3), (n3, n0)))
    solid_angle = g0 + g1 + g2 + g3
    usable = (z0 < 0) & (solid_angle > np.float32(1e-3))
    phi = u[0] * solid_angle - g2 - g3
    sin = np.sin(phi)
    sin = np.where(np.abs(sin) < 1e-12, np.float32(1e-12), sin)
    f = (np.cos(phi) * n0 + n2) / sin
    c = np.copysign(1 / np.sqrt(f * f + n0 * n0), f)
    c = np.clip(c, -1, 1)
    xu = np.clip(c * height / np.sqrt(np.maximum(1 - c * c, np.float32(1e-14))), x0, x1)
    d = np.sqrt(xu * xu + squared)
    h0, h1 = y0 / np.sqrt(d * d + y0 * y0), y1 / np.sqrt(d * d + y1 * y1)
    h = h0 + u[1] * (h1 - h0)
    yu = np.clip(h * d / np.sqrt(np.maximum(1 - h * h, np.float32(1e-14))), y0, y1)
    vector = xu * x + yu * y - height * facing
    return vector, np.where(usable, solid_angle, 0)


def _cosine_hemisphere(normal: np.ndarray, u: np.ndarray) -> Sample:
    """Directions about ``normal`` with pdf cos / pi, and their measure pi / cos."""
    x, y = concentric_disk(u[0], u[1])
    z = np.sqrt(np.maximum(1 - x * x - y * y, np.float32(1e-12)))
    s, t = basis(normal)
    return x * s + y * t + z * normal, np.float32(np.pi) / z


def _seen(
    group: Emitters,
    visible: Sequence[int],
    intersect: Callable[[int], tuple[np.ndarray, np.ndarray]],
    directions: np.ndarray,
    distance: np.ndarray,
    weight: Callable[[int], np.ndarray | float] | None = None,
) -> np.ndarray | None:
    """Radiance of the visible lights of a group; lights hide nothing, they add (as in Cycles)."""
    if not visible:
        return None
    total = np.zeros((3, len(distance)), np.float32)
    for i in visible:
        t, inside = intersect(i)
        share = (inside & (t <= distance)).astype(np.float32)
        if weight is not None:
            share = share * weight(i)
        cone = getattr(group, "_cone", None)
        if cone is not None and cone.any:
            share = share * cone.attenuation(np.full(len(distance), i), directions.T)
        total += share * group._radiance[:, i][:, None]
    return total


def _position(light: PointLight | SpotLight) -> np.ndarray:
    return light.light_to_world[:3, 3] if isinstance(light, SpotLight) else light.position


def _problem(light: Light) -> str | None:
    """Why a light can't be used, or None."""
    if (light.power < 0).any():
        return "has negative power; give it a positive one"
    if not (light.power > 0).any():
        return "has no power"
    if isinstance(light, SpotLight):
        matrix = light.light_to_world[:3, :3]
        largest = np.abs(matrix).max()
        if not largest > 0 or abs(np.linalg.det(matrix / largest)) < 1e-12:
            return "has a scale of 0 on one of its axes"
        if light.angle <= 0:
            return "has a cone of angle 0"
    if isinstance(light, AreaLight):
        axes = light.light_to_world[:3, :3] * np.append(light.size, 1.0)
        if not np.linalg.norm(axes, axis=0).min() > 0:
            return "has no area; make it larger, or use a point light"
    return None


def emitter_groups(
    lights: Sequence[Light],
    world: World,
    materials: Sequence[Material],
    triangles: Triangles,
    frame: Frame,
) -> tuple[list[Emitters], list[str]]:
    """All that lights the scene, by kind, and messages about lights that are left out."""
    messages, usable = [], []
    for light in lights:
        problem = _problem(light)
        if problem:
            messages.append(f'Light "{light.name}" {problem}; it is left out.')
        else:
            usable.append(light)
    points = [light for light in usable if isinstance(light, PointLight | SpotLight)]
    kinds: list[tuple[type, list]] = [
        (PointEmitters, [p for p in points if p.radius == 0]),
        (DiskEmitters, [p for p in points if p.radius > 0 and not p.sphere]),
        (SphereEmitters, [p for p in points if p.radius > 0 and p.sphere]),
        (AreaEmitters, [light for light in usable if isinstance(light, AreaLight)]),
    ]
    groups: list[Emitters] = [kind(members, frame) for kind, members in kinds if members]
    suns = [light for light in usable if isinstance(light, SunLight)]
    if suns:
        groups.append(SunEmitters(suns))
    if (world.radiance < 0).any():
        messages.append(f'World "{world.name}" has a negative colour; it lights nothing.')
    elif (world.radiance > 0).any():
        groups.append(WorldEmitter(world))
    clusters = _emissive_clusters(materials, triangles)
    if clusters:
        radiance = [materials[triangles.material[rows[0]]].emission for rows in clusters]
        groups.append(MeshEmitters(np.maximum(radiance, 0), clusters, triangles))
    return groups, messages


CLUSTERS = 256
"""About how many clusters all emissive triangles of a scene are parted into."""


def _emissive_clusters(materials: Sequence[Material], triangles: Triangles) -> list[np.ndarray]:
    """Triangles (rows) of each cluster: of one material, and near each other along a Morton curve."""
    emissive = np.array([(material.emission > 0).any() for material in materials])
    if not emissive.any():
        return []
    row = np.flatnonzero(emissive[triangles.material])
    corners = triangles.vertices[triangles.indices[row]].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    row, corners = row[area > 0], corners[area > 0]
    if row.size == 0:
        return []
    middle = corners.mean(axis=1)
    low, high = middle.min(axis=0), middle.max(axis=0)
    cell = ((middle - low) / np.maximum((high - low).max(), 1e-300) * 1023).astype(np.int64)
    code = sum(((cell[:, k] >> bit) & 1) << (3 * bit + k) for bit in range(10) for k in range(3))
    material = triangles.material[row]
    order = np.lexsort((code, material))
    row, material = row[order], material[order]
    size = max(8, -(-row.size // CLUSTERS))
    first_of_material = np.flatnonzero(np.diff(material, prepend=-1))
    place = np.arange(row.size) - np.repeat(first_of_material, np.diff(first_of_material, append=row.size))
    cuts = np.flatnonzero(place % size == 0)
    return np.split(row, cuts[1:])
