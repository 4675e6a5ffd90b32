# SPDX-License-Identifier: GPL-3.0-or-later
"""The materials of a batch of hits: closures evaluated once a hit, their lobes gathered.

Hits of one material are shaded together; lobes of one class become one lobe, whatever materials they are
of, so that a light sample meets a handful of array calls however many materials there are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..bsdf.lobe import Lobe
from ..geometry.frame import Frame
from ..geometry.surfaces import SurfacePoints
from ..geometry.triangles import Triangles
from ..geometry.vectors import dot, inverse_length, take
from ..scene import Material
from ..shading.abilities import Abilities, abilities
from ..shading.closures import Add, Diffuse, Emission
from ..shading.points import ShadingPoints
from ..shading.terms import SurfaceTerms

MEAN_POINTS = 1 << 14
"""Points of a material at which its emission is looked up to know its mean."""

LEAST_EMISSION = 1e-6
"""Mean radiance that a material is thought to have whose emission varies, and was 0 at all of these."""

ROUGH = 0.3
"""alpha above which a lobe is served by sampling the lights alone."""


@dataclass(eq=False)
class Slot:
    """A lobe that some of P hits have.

    row : (P,) int32 its lane at each hit, -1 where there is none; None if lane i belongs to hit i.
    sampled : whether directions are sampled by the lobe, too, not by the lights alone.
    """

    lobe: Lobe
    row: np.ndarray | None
    sampled: bool

    def of(self, at: np.ndarray) -> tuple[np.ndarray | None, np.ndarray]:
        """Of samples at hits ``at`` (K,): which (J,) meet the lobe (None: all), and its lane at each (J,)."""
        if self.row is None:
            return None, at
        row = self.row.take(at)
        lanes = np.flatnonzero(row >= 0)
        return (None, row) if len(lanes) == len(row) else (lanes, row.take(lanes))


class SurfaceShader:
    """All materials of a scene.

    lambertian : every one is, with constant reflectance and emission; nothing needs to be evaluated.
    emits, transmits : (number of materials,) bool, whether one can.
    varying_emission : (number of materials,) bool, whether it may not be the same everywhere and to all
        sides.
    """

    def __init__(self, materials: Sequence[Material], triangles: Triangles, frame: Frame) -> None:
        self._triangles = triangles
        self._origin = frame.origin.astype(np.float32)[:, None]
        self._unscale = np.float32(1 / frame.scale)
        used = np.zeros(len(materials), bool)
        used[np.unique(triangles.material)] = True
        self._used = used
        self.lambertian = not any(m.surface is not None for m, u in zip(materials, used, strict=True) if u)
        self._closures = [_closure_of(material) for material in materials]
        able = [abilities(c) if u else Abilities() for c, u in zip(self._closures, used, strict=True)]
        self.emits, self.varying_emission, self.transmits, self._holds_out = (
            np.array([getattr(a, name) for a in able], bool)
            for name in ("emits", "varies", "transmits", "holds_out")
        )

    @property
    def any_holdout(self) -> bool:
        return bool(self._holds_out.any())

    def terms(
        self,
        points: SurfacePoints,
        towards_viewer: np.ndarray,
        wants_lobes: bool = True,
        ray: str = "camera",
    ) -> Iterator[tuple[np.ndarray | None, SurfaceTerms]]:
        """For each material among M points: which of them (ascending, None for all), and what it says there.

        towards_viewer : (3, M) float32, of any length but 0. ray : of `ShadingPoints`.
        """
        material = self._triangles.material.take(points.triangle)
        for number, rows in _groups(material, self._used):
            if self._closures[number] is None:
                continue
            some = points if rows is None else points.take(rows)
            viewer = towards_viewer if rows is None else take(towards_viewer, rows)
            terms = SurfaceTerms(wants_lobes)
            self._closures[number].shade(self._asked(some, viewer, ray), np.float32(1), terms)
            yield rows, terms

    def _asked(self, points: SurfacePoints, towards_viewer: np.ndarray, ray: str) -> ShadingPoints:
        def attribute(name: str, width: int) -> np.ndarray:
            return self._triangles.attribute(name, width, points.triangle, points.u, points.v)

        return ShadingPoints(
            points.position * self._unscale + self._origin,
            points.normal,
            points.geometric,
            towards_viewer * inverse_length(towards_viewer),
            points.flipped,
            attribute,
            ray,
        )

    def with_mean_emission(self, materials: Sequence[Material]) -> list[Material]:
        """The materials, those of closures with what they emit in the mean as `Material.emission`."""
        result = list(materials)
        for number in np.flatnonzero(self.emits):
            if materials[number].surface is not None:
                result[number] = replace(materials[number], emission=self._mean_emission(int(number)))
        return result

    def _mean_emission(self, number: int) -> np.ndarray:
        """(3,) over the triangles of a material, by area, from points of a lattice on each."""
        row = np.flatnonzero(self._triangles.material == number)
        per_triangle = max(1, MEAN_POINTS // len(row))
        row = row[:: max(1, len(row) // MEAN_POINTS)]
        corners = (self._triangles.vertices[self._triangles.indices[row, k]] for k in range(3))
        # Large triangles' areas overflow float32.
        corner, a, b = (vertices.astype(np.float64) for vertices in corners)
        normal = np.cross(a - corner, b - corner)
        area = np.repeat(np.linalg.norm(normal, axis=1), per_triangle)
        # The R2 sequence (M. Roberts, 2018), folded into the triangle.
        uv = np.outer((0.7548776662466927, 0.5698402909980532), np.arange(1, per_triangle + 1)) % 1
        uv = np.where(uv.sum(axis=0) > 1, 1 - uv, uv)
        u, v = (np.tile(x, len(row)).astype(np.float32) for x in uv)
        points = self.points_on(np.repeat(row, per_triangle).astype(np.int32), u, v)
        emission = self.emission(points, points.geometric)
        # What no point has met may still be there: never nothing, or the light would be left out.
        least = LEAST_EMISSION if self.varying_emission[number] else 0.0
        return np.maximum((emission @ area) / max(area.sum(), 1e-300), least)

    def points_on(
        self, triangle: np.ndarray, u: np.ndarray, v: np.ndarray, towards_viewer: np.ndarray | None = None
    ) -> SurfacePoints:
        """Points (M,) of triangles, as seen from ``towards_viewer`` (3, M), or else from their front."""
        corner, a, b = (self._triangles.vertices[self._triangles.indices[triangle, k]].T for k in range(3))
        a, b = a - corner, b - corner
        normal = np.cross(a, b, axis=0)
        normal *= inverse_length(normal)
        back = np.zeros(len(triangle), bool)
        if towards_viewer is not None:
            back = dot(normal, towards_viewer) < 0
            normal *= np.where(back, np.float32(-1), np.float32(1))
        return SurfacePoints(None, triangle, corner + u * a + v * b, normal, normal, u, v, None, back)

    def transparency(self, points: SurfacePoints, towards_viewer: np.ndarray) -> np.ndarray:
        """(3, M) what of shadow rays passes straight through M points."""
        through = np.zeros((3, len(points)), np.float32)
        for rows, terms in self.terms(points, towards_viewer, False, "shadow"):
            through[:, slice(None) if rows is None else rows] = terms.transparency
        return through

    def emission(self, points: SurfacePoints, towards_viewer: np.ndarray) -> np.ndarray:
        """(3, M) radiance with which M points light others."""
        radiance = np.zeros((3, len(points)), np.float32)
        for rows, terms in self.terms(points, towards_viewer, False, "light"):
            radiance[:, slice(None) if rows is None else rows] = terms.emission
        return np.maximum(radiance, 0, out=radiance)


def _closure_of(material: Material):
    if material.surface is not None:
        return material.surface
    lambert = Diffuse(tuple(material.reflectance)) if material.reflectance.any() else None
    if not (material.emission > 0).any():
        return lambert
    emission = Emission(tuple(np.maximum(material.emission, 0)), 1.0)
    return emission if lambert is None else Add(lambert, emission)


def _groups(material: np.ndarray, used: np.ndarray) -> Iterator[tuple[int, np.ndarray | None]]:
    """The numbers that occur in ``material`` (M,), each with its rows, ascending."""
    if len(material) == 0:
        return
    if np.count_nonzero(used) == 1:
        yield int(np.argmax(used)), None
        return
    order = np.argsort(material.astype(np.min_scalar_type(len(used))), kind="stable")
    ordered = material.take(order)
    starts = np.flatnonzero(np.diff(ordered, prepend=-1))
    for low, high in zip(starts, np.append(starts[1:], len(ordered)), strict=True):
        yield int(ordered[low]), None if high - low == len(ordered) else order[low:high]


class LobeGatherer:
    """Gathers lobes of hits into slots."""

    def __init__(self) -> None:
        self._found: dict[tuple[type, bool, int], list[tuple[np.ndarray, Lobe]]] = {}

    def add(self, rows: np.ndarray, lobes: Sequence[Lobe], throughput: np.ndarray | None) -> None:
        """Lobes of the hits numbered ``rows``; what they reflect is multiplied with ``throughput`` (3, N)."""
        place: dict[tuple[type, bool], int] = {}
        for lobe in lobes:
            if throughput is not None:
                lobe.weight = lobe.weight * throughput
            lit = (lobe.weight > 0).any(axis=0)
            by_lights = (
                np.ones(len(rows), bool) if lobe.smooth else lobe.alpha[0] * lobe.alpha[1] > ROUGH * ROUGH
            )
            for sampled, chosen in ((False, lit & by_lights), (True, lit & ~by_lights)):
                kept = np.flatnonzero(chosen)
                if kept.size == 0:
                    continue
                every = kept.size == len(rows)
                # A material's own lobes of a class can't share a slot; another material's can.
                kind = type(lobe), sampled
                number = place[kind] = place.get(kind, -1) + 1
                part = (rows, lobe) if every else (rows.take(kept), lobe.take(kept))
                self._found.setdefault((*kind, number), []).append(part)

    def reflecting(self, count: int) -> np.ndarray:
        """(count,) bool, which hits have a lobe."""
        has = np.zeros(count, bool)
        for parts in self._found.values():
            for rows, _ in parts:
                has[rows] = True
        return has

    def slots(self, renumbered: np.ndarray | None, count: int) -> list[Slot]:
        """The slots of ``count`` hits.

        renumbered : new number of each hit, -1 for one that is dropped (and has no lobe); None keeps all.
        """
        slots = []
        for (kind, sampled, _), parts in self._found.items():
            rows = parts[0][0] if len(parts) == 1 else np.concatenate([rows for rows, _ in parts])
            lobe = parts[0][1] if len(parts) == 1 else kind.concatenate([lobe for _, lobe in parts])
            rows = rows if renumbered is None else renumbered.take(rows)
            if len(rows) == count and (np.diff(rows) == 1).all():
                slots.append(Slot(lobe, None, sampled))
                continue
            row = np.full(count, -1, np.int32)
            row[rows] = np.arange(len(rows), dtype=np.int32)
            slots.append(Slot(lobe, row, sampled))
        return slots
