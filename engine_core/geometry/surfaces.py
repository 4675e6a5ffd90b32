# SPDX-License-Identifier: GPL-3.0-or-later
"""Points on surfaces: what a camera ray hits, and whether a light can be seen from there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from ..scene import NO_SHADOW
from .raytracer import FAR, ClosestHits, RayTracer
from .triangles import Triangles
from .vectors import dot, inverse_length, take

ALL_CAST, NONE_CAST = 0, 1
"""Numbers of blockers: all surfaces that cast shadows, and none, nor fog."""

# A shadow ray to a point that may lie on a surface, which is no light itself, ends this fraction short of it.
SHORTFALL = np.float32(1.0 - 1e-4)


@dataclass(eq=False)
class SurfacePoints:
    """M points on triangles, seen along rays; component first.

    lane : (M,) int, which of the rays that were cast; None if every ray hit.
    triangle : (M,) int32.
    position : (3, M) float32.
    geometric : (3, M) float32, unit normal of the triangle, towards the viewer.
    normal : (3, M) float32, unit shading normal, on the same side of the surface as ``geometric``.
    u, v : (M,) float32, barycentric weights of corners 1 and 2.
    smooth : (M,) int32, row of `Triangles.normals` or -1; None if all are flat.
    flipped : (M,) bool, seen from the back.
    """

    lane: np.ndarray | None
    triangle: np.ndarray
    position: np.ndarray
    geometric: np.ndarray
    normal: np.ndarray
    u: np.ndarray
    v: np.ndarray
    smooth: np.ndarray | None
    flipped: np.ndarray

    def __len__(self) -> int:
        return len(self.triangle)

    def take(self, rows: np.ndarray) -> SurfacePoints:
        """The points at ``rows``."""
        return SurfacePoints(
            rows if self.lane is None else self.lane.take(rows),
            self.triangle.take(rows),
            take(self.position, rows),
            take(self.geometric, rows),
            take(self.normal, rows),
            self.u.take(rows),
            self.v.take(rows),
            None if self.smooth is None else self.smooth.take(rows),
            self.flipped.take(rows),
        )

    def turned(self) -> SurfacePoints:
        """The same points on the far side of their surfaces."""
        return replace(self, geometric=-self.geometric, normal=-self.normal, flipped=~self.flipped)

    @staticmethod
    def concatenate(parts: Sequence[SurfacePoints]) -> SurfacePoints:
        """Points of several kinds of rays, one after the other; ``lane`` must be known in all."""
        if len(parts) == 1:
            return parts[0]
        joined = (
            None if getattr(parts[0], f.name) is None
            else np.concatenate([getattr(part, f.name) for part in parts], axis=-1)
            for f in fields(SurfacePoints)
        )  # fmt: skip
        return SurfacePoints(*joined)


class Surfaces:
    """The triangles of a scene with their ray tracers; further ones only where shadows differ.

    any_transparent : whether a shadow may be one that lets something through.
    """

    def __init__(
        self,
        triangles: Triangles,
        transmits: np.ndarray | None = None,
        blockers: Sequence[frozenset[int] | None] = (None, NO_SHADOW),
    ) -> None:
        """transmits : (T,) bool, triangles that let light straight through; None if none does.

        blockers : what casts shadows in the light of lights (`Linking.blockers`), with `ALL_CAST` and
            `NONE_CAST` first. Methods take their numbers.
        """
        self.triangles = triangles
        seen, casts = triangles.visible_to_camera, triangles.casts_shadow
        camera = _tracer_of(triangles, seen)
        self._camera_tracer, self._camera_rows = camera
        clear = None if transmits is None else np.broadcast_to(casts, transmits.shape) & transmits
        self.any_transparent = clear is not None and bool(clear.any())
        known = [(seen, camera)]

        def tracer_of(which: np.ndarray | bool) -> tuple[RayTracer, np.ndarray | None]:
            for other, tracer in known:
                if np.array_equal(other, which):
                    return tracer
            known.append((which, _tracer_of(triangles, which)))
            return known[-1][1]

        self._opaque, self._clear = [], []
        for of_light in blockers:
            which = _in_sets(triangles.shadow_set, of_light)
            opaque = casts & which
            if self.any_transparent:
                self._clear.append(tracer_of(clear & which))
                opaque = opaque & ~clear
            self._opaque.append(tracer_of(opaque)[0])

    def first_hit(
        self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray = FAR
    ) -> tuple[SurfacePoints, np.ndarray]:
        """What camera rays meet.

        origins, directions : (N, 3) float32; the direction of an orthographic camera may be (1, 3).
        reach : in lengths of the direction, one number or (N,) float32.

        Returns the points, and (M,) float32 their distances in lengths of the direction.
        """
        return self._hit(self._camera_tracer, self._camera_rows, origins, directions, reach)

    def distance(self, origins: np.ndarray, directions: np.ndarray, reach: float | np.ndarray) -> np.ndarray:
        """(N,) float32 lengths of the direction to what camera rays (N, 3) meet, ``reach`` if nothing.

        directions : (N, 3) or (1, 3). reach : a number or (N,) float32.
        """
        return self._camera_tracer.distance(origins, directions, reach)

    def _hit(
        self,
        tracer: RayTracer,
        rows: np.ndarray | None,
        origins: np.ndarray,
        directions: np.ndarray,
        reach: float | np.ndarray,
    ) -> tuple[SurfacePoints, np.ndarray]:
        hits = tracer.closest_hit(origins, directions, reach)
        found = hits.triangle >= 0
        lane = None
        if not found.all():
            lane = np.flatnonzero(found)
            hits = ClosestHits(
                hits.triangle.take(lane),
                hits.distance.take(lane),
                hits.u.take(lane),
                hits.v.take(lane),
                hits.normal.take(lane, axis=0),
            )
            origins = origins.take(lane, axis=0)
            directions = directions if len(directions) == 1 else directions.take(lane, axis=0)
        triangle = hits.triangle if rows is None else rows[hits.triangle]
        position = np.empty((3, len(triangle)), np.float32)
        for i in range(3):
            np.multiply(hits.distance, directions[:, i], out=position[i])
            position[i] += origins[:, i]
        geometric = np.ascontiguousarray(hits.normal.T)
        flip = _dot_rows(geometric, directions) > 0
        scale = inverse_length(geometric)
        geometric *= np.where(flip, -scale, scale)
        points = SurfacePoints(lane, triangle, position, geometric, geometric, hits.u, hits.v, None, flip)
        if self.triangles.smooth is not None:
            points.smooth = self.triangles.smooth.take(triangle)
            points.normal = self._shading_normal(points)
        return points, hits.distance

    def beyond(self, points: SurfacePoints) -> np.ndarray:
        """(M, 3) origins of rays that go on behind the points, as seen by whoever sees them."""
        origins = points.position - points.geometric * self.triangles.offset.take(points.triangle)
        return np.ascontiguousarray(origins.T)

    def next_transparent(
        self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray, blockers: int = ALL_CAST
    ) -> tuple[SurfacePoints, np.ndarray]:
        """Like `first_hit`, of shadow rays, with surfaces that let light straight through; reach (N,)."""
        return self._hit(*self._clear[blockers], origins, directions, reach)

    def _shading_normal(self, points: SurfacePoints) -> np.ndarray:
        """Interpolated normals (3, M), the geometric ones where a triangle is flat or they vanish."""
        lanes = np.flatnonzero(points.smooth >= 0)
        if lanes.size == 0:
            return points.geometric
        everywhere = lanes.size == len(points)
        smooth, u, v, flipped = points.smooth, points.u, points.v, points.flipped
        if not everywhere:
            smooth, u, v, flipped = (a.take(lanes) for a in (smooth, u, v, flipped))
        rows = self.triangles.normals.take(smooth, axis=0)
        normal = np.empty((3, len(smooth)), np.float32)
        for i in range(3):
            normal[i] = rows[:, i] + u * rows[:, 3 + i] + v * rows[:, 6 + i]
        length = inverse_length(normal)
        normal *= np.where(flipped, -length, length)
        vanished = length == 0
        if vanished.any():
            where = np.flatnonzero(vanished)
            normal[:, where] = points.geometric[:, lanes[where]]
        if everywhere:
            return normal
        out = points.geometric.copy()
        out[:, lanes] = normal
        return out

    def shadow_rays(
        self,
        points: SurfacePoints,
        index: np.ndarray,
        to_light: np.ndarray,
        cos_shading: np.ndarray,
        at_infinity: np.ndarray | bool,
        short: bool = False,
    ) -> tuple[np.ndarray, np.ndarray, float | np.ndarray]:
        """Rays from points[index] to where ``to_light`` leads: origins, directions (K, 3), and their reach.

        index : (K,) into ``points``.
        to_light : (3, K) float32, from the point to the light (any length if ``at_infinity``).
        cos_shading : (K,) float32, cosine of it to the shading normal.
        at_infinity : (K,) bool, or a bool for all: a light without a distance.
        short : whether there may be a surface where rays end.
        """
        geometric = take(points.geometric, index)
        triangle = points.triangle.take(index)
        offset = geometric * self.triangles.offset.take(triangle)
        if points.smooth is not None:
            self._lift_terminator(points, index, triangle, to_light, cos_shading, geometric, offset)
        origins = np.empty((len(index), 3), np.float32)
        directions = np.empty((len(index), 3), np.float32)
        finite = np.logical_not(at_infinity)
        for i in range(3):
            np.add(points.position[i].take(index), offset[i], out=origins[:, i])
            if np.ndim(finite) == 0:
                if finite:
                    offset_i = offset[i]
                    np.subtract(to_light[i], offset_i, out=directions[:, i])
                else:
                    directions[:, i] = to_light[i]
            else:
                np.subtract(to_light[i], offset[i] * finite, out=directions[:, i])
        reach = np.where(at_infinity, FAR, SHORTFALL if short else 1).astype(np.float32)
        return origins, directions, float(reach) if reach.ndim == 0 else reach

    def occluded(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        reach: float | np.ndarray,
        blockers: np.ndarray | int = ALL_CAST,
    ) -> np.ndarray:
        """(K,) bool: does a surface that lets nothing through lie in the way of shadow rays?

        blockers : (K,) of each ray, or of all.
        """
        if np.ndim(blockers) == 0:
            return self._opaque[blockers].occluded(origins, directions, reach)
        result = np.zeros(len(origins), bool)
        for number, rows in by_number(blockers):
            some = reach if np.ndim(reach) == 0 else reach.take(rows)
            rays = origins.take(rows, axis=0), directions.take(rows, axis=0)
            result[rows] = self._opaque[number].occluded(*rays, some)
        return result

    def blocked_at(
        self,
        origins: np.ndarray,
        directions: np.ndarray,
        reach: float | np.ndarray,
        blockers: int = ALL_CAST,
    ) -> np.ndarray:
        """(K,) distances at which shadow rays meet what lets nothing through, inf where they do not."""
        hits = self._opaque[blockers].closest_hit(origins, directions, reach)
        return np.where(hits.triangle >= 0, hits.distance, np.inf)

    def _lift_terminator(
        self,
        points: SurfacePoints,
        index: np.ndarray,
        triangle: np.ndarray,
        to_light: np.ndarray,
        cos_shading: np.ndarray,
        geometric: np.ndarray,
        offset: np.ndarray,
    ) -> None:
        """Where light grazes a smooth triangle, start on the smooth surface that it stands for.

        As in Cycles (after J. Hanika, "Hacking the shadow terminator", Ray Tracing Gems II, 2021): a
        parabolic estimate of the surface's height over the triangle, faded in below a cosine.
        Adds to ``offset`` (3, K).
        """
        smooth = points.smooth.take(index)
        cutoff = self.triangles.terminator_offset
        cutoff = cutoff if cutoff.ndim == 0 else cutoff[triangle]
        # The distance only sets the scale of the cosine to the geometric normal.
        inverse = inverse_length(to_light)
        cos_geometric = dot(geometric, to_light) * inverse
        near = (smooth >= 0) & (np.minimum(cos_geometric, cos_shading) < 2 * cutoff)
        lanes = np.flatnonzero(near)
        if lanes.size == 0:
            return
        cutoff = cutoff if cutoff.ndim == 0 else cutoff[lanes]
        cos_g, cos_s = cos_geometric[lanes], cos_shading[lanes]
        fade = np.where(
            cos_s < cutoff,
            2 - (cos_g + cos_s) / np.maximum(cutoff, 1e-20),
            1 - cos_g / np.maximum(cutoff, 1e-20),
        )
        fade = np.where(cutoff > 0, np.clip(fade, 0, 1), 0)
        lanes = lanes[fade > 0]
        if lanes.size == 0:
            return
        fade = fade[fade > 0]
        at = index[lanes]
        flipped = points.flipped[at]
        height, normal = self._smooth_height(
            triangle[lanes], smooth[lanes], points.u[at], points.v[at], flipped
        )
        offset[:, lanes] += normal * (height * fade)

    def _smooth_height(
        self, triangle: np.ndarray, smooth: np.ndarray, b1: np.ndarray, b2: np.ndarray, flipped: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Height (K,) of the smooth surface over its triangle, along its unit-less normal (3, K)."""
        rows = self.triangles.normals[smooth].T
        n0 = rows[0:3]
        n1, n2 = n0 + rows[3:6], n0 + rows[6:9]
        v0, v1, v2 = (self.triangles.vertices[self.triangles.indices[triangle, k]].T for k in range(3))
        b0 = 1 - b1 - b2
        normal = n0 * b0 + n1 * b1 + n2 * b2
        p = v0 * b0 + v1 * b1 + v2 * b2
        a = dot(n2 - n0, v0 - v2)
        b = dot(n2 - n1, v1 - v2)
        c = dot(n1 - n0, v1 - v0)
        parabola = 0.5 * (a * b0 * (b0 - 1) + (a + b + c) * b0 * b1 + b * b1 * (b1 - 1))
        # The surface lies within the tangent planes at the corners: on the outside for a viewer in
        # front (sign +1), on the inside for one behind.
        sign = np.where(flipped, np.float32(-1), np.float32(1))

        def envelope(near: np.ndarray, n: np.ndarray, others: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
            reach = np.maximum(sign * dot(others[0] - near, n), sign * dot(others[1] - near, n))
            return np.maximum(sign * dot(near - p, n) + np.maximum(reach, 0), 0)

        bound = np.minimum(
            np.minimum(envelope(v0, n0, (v1, v2)), envelope(v1, n1, (v0, v2))), envelope(v2, n2, (v0, v1))
        )
        height = sign * np.maximum(bound, sign * parabola)
        return height, normal

    @cached_property
    def any_holdout(self) -> bool:
        return bool(np.any(self.triangles.holdout))


def by_number(blockers: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
    """The different ``blockers`` of (K,) rays, and which rays have each."""
    for number in np.unique(blockers):
        yield int(number), np.flatnonzero(blockers == number)


def _in_sets(of_triangle: np.ndarray | int, sets: frozenset[int] | None) -> np.ndarray | bool:
    """(T,) bool, whether triangles are of some sets, None for all; a bool if all are, or none."""
    if not sets:
        return sets is None
    if np.ndim(of_triangle) == 0:
        return of_triangle in sets
    found = np.isin(of_triangle, list(sets))
    return bool(found.all()) if found.all() or not found.any() else found


def _tracer_of(triangles: Triangles, which: np.ndarray | bool) -> tuple[RayTracer, np.ndarray | None]:
    """A tracer of the triangles for which ``which`` holds, and their rows (None: all, in order)."""
    if np.all(which):
        return RayTracer(triangles.vertices, triangles.indices), None
    rows = np.flatnonzero(np.broadcast_to(which, len(triangles))).astype(np.int32)
    used, compact = np.unique(triangles.indices[rows], return_inverse=True)
    return RayTracer(triangles.vertices[used], compact.reshape(-1, 3).astype(np.int32)), rows


def _dot_rows(a: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Inner products of (3, N) with (N, 3) or (1, 3)."""
    return a[0] * rows[:, 0] + a[1] * rows[:, 1] + a[2] * rows[:, 2]
