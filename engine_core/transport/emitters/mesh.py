# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes that emit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry.triangles import Triangles
from ...geometry.vectors import dot, take
from ...scene import Material
from .base import Emitters, area_to_solid_angle, vectors_to
from .spherical import SphericalTriangle

# Triangles are near within this times their longest edge.
_NEAR = 0.3


class MeshEmitters(Emitters):
    """Meshes with an emissive material, from both sides: by area, measure |cos| / d^2.

    A triangle that is large for the shaded point is sampled by its solid angle; that over its area is the
    measure.

    A light is a cluster of neighbouring triangles of one material; ``w`` chooses among them.

    chooses : whether a light has several triangles, so that ``w`` matters.
    row : (E,) int32, the scene's number of each emissive triangle.
    light_of : (T,) int32, the light in this group that each triangle of the scene is part of, or -1.
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
        self.chooses = bool(counts.max() > 1)
        self.row = row.astype(np.int32)
        self.light_of, self._number = np.full((2, len(triangles)), -1, np.int32)
        self.light_of[row] = light
        self._number[row] = np.arange(len(row))
        area = np.bincount(light, 0.5 * double_area, minlength=len(rows))
        super().__init__(np.asarray(radiance) * area[:, None], area, [True] * len(rows))
        self._area, self._area_of = area.astype(np.float32), (0.5 * double_area).astype(np.float32)
        # How far off a triangle counts as near, from its first corner (surely) and from its middle.
        third = (a + b) / 3
        longest = np.max([np.linalg.norm(edge, axis=1) for edge in (a, b, b - a)], axis=0)
        reach = np.max([np.linalg.norm(point - third, axis=1) for point in (0 * a, a, b)], axis=0)
        self._near_middle = ((reach + _NEAR * longest) ** 2).astype(np.float32)
        to_middle = np.linalg.norm(third, axis=1)
        self._near_corner = ((reach + _NEAR * longest + to_middle) ** 2).astype(np.float32)
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
        self.centre, self.reach = self._centre.astype(np.float64), far

    @property
    def far_fluence(self):
        # Seen from a random side, a flat light shows half of its area.
        return np.float32(0.5) * self._brightness

    def sample(self, which, position, normal, w, u):
        triangle = self._chosen(which, w)
        corner = vectors_to(self._corner, triangle, position)
        root = np.sqrt(u[0])
        b1, b2 = 1 - root, root * u[1]
        to_light = corner + b1 * take(self._a, triangle)
        to_light += b2 * take(self._b, triangle)
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        measure = np.abs(dot(take(self._normal, triangle), to_light))
        measure /= square * np.sqrt(square)
        near, seen = self._near(triangle, corner, normal is None)
        if near.size:
            for out, values in zip(to_light, seen.sample(take(u, near)), strict=True):
                out[near] = np.where(seen.usable, values, out[near])
            by_angle = seen.solid_angle / self._area_of.take(triangle.take(near))
            measure[near] = np.where(seen.usable, by_angle, measure[near])
        return to_light, measure

    def _near(
        self, triangle: np.ndarray, corner: np.ndarray, precise: bool
    ) -> tuple[np.ndarray, SphericalTriangle | None]:
        """Lanes of ``triangle`` (M,) that are near enough for their solid angle, and these as seen.

        corner : (3, M) vectors to the first corners. precise : for points in space, which come so near that a
        triangle fills the half space.
        """
        near = np.flatnonzero(dot(corner, corner) < self._near_corner.take(triangle))
        if near.size == 0:
            return near, None
        some, corner = triangle.take(near), take(corner, near)
        b, c = corner + take(self._a, some), corner + take(self._b, some)
        middle = (corner + b + c) * np.float32(1 / 3)
        nearer = np.flatnonzero(dot(middle, middle) < self._near_middle.take(some))
        if nearer.size == 0:
            return nearer, None
        if nearer.size < near.size:
            near, corner, b, c = near.take(nearer), take(corner, nearer), take(b, nearer), take(c, nearer)
        kind = np.float64 if precise else np.float32
        return near, SphericalTriangle(*(x.astype(kind, copy=False) for x in (corner, b, c)))

    def _chosen(self, which: np.ndarray | None, w: np.ndarray) -> np.ndarray:
        """(M,) triangles, numbered light after light."""
        light = np.zeros(len(w), np.intp) if which is None else which
        triangle = np.searchsorted(self._table, light + w.astype(np.float64), side="right")
        return np.clip(triangle, self._start[light], self._start[light + 1] - 1, out=triangle)

    def point_of(
        self, which: np.ndarray | None, w: np.ndarray, position: np.ndarray, to_light: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where on the scene's triangles a sample lies: rows (M,), weights (M,) of corners 1 and 2.

        Of what `sample` was given, and what it gave; for the few that turn out to matter.
        """
        triangle = self._chosen(which, w)
        a, b = take(self._a, triangle), take(self._b, triangle)
        gap = position + to_light - take(self._corner, triangle)
        aa, ab, bb = dot(a, a), dot(a, b), dot(b, b)
        scale = 1 / np.maximum(aa * bb - ab * ab, np.float32(1e-37))
        ga, gb = dot(gap, a), dot(gap, b)
        b1 = np.clip((bb * ga - ab * gb) * scale, 0, 1)
        b2 = np.clip((aa * gb - ab * ga) * scale, 0, 1 - b1)
        return self.row.take(triangle), b1, b2

    def pdf_of_triangle(
        self, triangle: np.ndarray, position: np.ndarray, normal: np.ndarray | None, to_light: np.ndarray
    ) -> np.ndarray:
        """(M,) density per solid angle, given its light, of points on the scene's ``triangle`` (M,).

        to_light : (3, M). 0 for a triangle that is no light.
        """
        light = self.light_of.take(triangle)
        number = np.maximum(self._number.take(triangle), 0)
        square = np.maximum(dot(to_light, to_light), np.float32(1e-30))
        cosine_d = np.abs(dot(take(self._normal, number), to_light))
        density = area_to_solid_angle(square, cosine_d, self._area.take(light, mode="clip"))
        near, seen = self._near(number, vectors_to(self._corner, number, position), normal is None)
        if near.size:
            share = self._area_of.take(number.take(near)) / self._area.take(light.take(near))
            by_angle = share / np.maximum(seen.solid_angle, np.float32(1e-30))
            density[near] = np.where(seen.usable, by_angle, density[near])
        return np.where(light >= 0, density, 0)

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


ALONE = 8
"""Up to how many emissive triangles of a scene are a light each: then none has to be chosen of a light."""

CLUSTERS = 256
"""About how many clusters all emissive triangles of a scene are parted into."""


def emissive_clusters(materials: Sequence[Material], triangles: Triangles) -> list[np.ndarray]:
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
    size = 1 if row.size <= ALONE else max(8, -(-row.size // CLUSTERS))
    first_of_material = np.flatnonzero(np.diff(material, prepend=-1))
    place = np.arange(row.size) - np.repeat(first_of_material, np.diff(first_of_material, append=row.size))
    cuts = np.flatnonzero(place % size == 0)
    return np.split(row, cuts[1:])
