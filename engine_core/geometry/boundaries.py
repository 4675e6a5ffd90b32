# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rays are inside closed meshes, which may be nested, overlap or touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .raytracer import RayTracer

MOST = 63
"""Bodies: a bit of a set each."""

FEW_PLANES = 24
"""A convex body with no more is clipped against its planes, exactly; other bodies are ray traced."""

_ULPS = 8 * 2.0**-24

_MOST_HEIGHTS = 1 << 26
"""Of vertices above triangles, looked at to tell whether a body is convex."""

_SOME_DIRECTION = np.array([0.4289, 0.6719, 0.6037], np.float32)
"""Along no edge of what people build."""


@dataclass(eq=False)
class Spans:
    """K stretches of rays inside a body: from ``start`` to ``end`` (K,) float64, in lengths of the direction.

    ray : (K,) which of the rays. Those of one ray do not overlap. A span that begins at 0 or ends at the
    ray's reach may go on there.
    """

    ray: np.ndarray
    start: np.ndarray
    end: np.ndarray


class Boundaries:
    """Closed meshes as bodies that rays enter and leave.

    Only the sides of triangles decide what is inside: a body's first crossing tells whether the ray began
    there. So no state need be handed from ray to ray, and none can be wrong. A mesh turned inside out is
    taken the other way round. In an open mesh, what is entered and not left is inside to the ray's end.

    balls : centre (3,) and radius of a ball around each.
    """

    def __init__(self, bodies: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """bodies : vertices (V, 3) float32 and triangles (T, 3) of each, at most `MOST`."""
        self.bodies = [_body_of(vertices, triangles) for vertices, triangles in bodies]
        self.balls = [_ball_around(vertices) for vertices, _ in bodies]

    def __len__(self) -> int:
        return len(self.bodies)

    @property
    def convex(self) -> bool:
        """Whether all bodies are known to be convex."""
        return all(isinstance(body, _Convex) for body in self.bodies)

    def spans(
        self,
        body: int,
        origins: np.ndarray,
        directions: np.ndarray,
        reach: np.ndarray,
        inside: np.ndarray | None,
    ) -> Spans:
        """Where rays are inside one body, between 0 and their ``reach`` (N,).

        origins, directions : (N, 3) float32, of any length.
        inside : (N,) bool, which rays begin inside; None if unknown. Needed of an open body alone, which a
            ray may not meet any more; of others it saves work.
        """
        return self.bodies[body].spans(origins, directions, reach, inside)


def _ball_around(vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of a ball that holds vertices (V, 3), not the smallest one."""
    corners = vertices[np.isfinite(vertices).all(axis=1)].astype(np.float64)
    if len(corners) == 0:
        return np.zeros(3), 0.0
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return centre, float(np.sqrt(((corners - centre) ** 2).sum(axis=1).max()))


class _Convex:
    """A closed convex body of few faces: rays are clipped against slabs, between planes that are parallel."""

    def __init__(self, normals: np.ndarray, offsets: np.ndarray) -> None:
        """normals : (P, 3) float64, outwards. offsets : (P,) of the planes along them."""
        slabs = []  # normal, low, high
        rest = list(range(len(normals)))
        while rest:
            i = rest.pop(0)
            opposite = next((j for j in rest if (normals[j] == -normals[i]).all()), None)
            if opposite is not None:
                rest.remove(opposite)
            slabs.append((normals[i], -np.inf if opposite is None else -offsets[opposite], offsets[i]))
        self._normals = np.array([normal for normal, _, _ in slabs])
        self._low, self._high = np.array([slab[1:] for slab in slabs]).T[..., None]

    def spans(self, origins, directions, reach, inside) -> Spans:
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            along = 1 / _along(self._normals, directions)
            height = _along(self._normals, origins)
            low, high = self._low - height, self._high - height
            low *= along
            high *= along
        # A ray along a slab is between its planes for good, or outside: both are infinite, of one sign. One
        # within a plane, where there is a NaN, counts as outside.
        start = np.fmin(low, high).max(axis=0)
        end = np.fmax(low, high).min(axis=0)
        np.fmax(start, 0, out=start)
        np.fmin(end, reach, out=end)
        ray = np.flatnonzero(end > start)
        return Spans(ray, start.take(ray), end.take(ray))


def _along(normals: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(P, N) inner products of (P, 3) and (N, 3). Not by ``@``, as `integration.rules.weighted`."""
    out = normals[:, :1] * vectors[:, 0]
    out += normals[:, 1:2] * vectors[:, 1]
    out += normals[:, 2:] * vectors[:, 2]
    return out


class _Traced:
    """Any body: a tracer of its triangles, which rays that miss its bounding box never meet.

    sign : -1 if its triangles face inwards. closed : whether every edge joins two triangles.
    convex : whether rays leave it but once.
    """

    def __init__(
        self, vertices: np.ndarray, triangles: np.ndarray, sign: int, closed: bool, convex: bool
    ) -> None:
        self._convex = convex
        self._tracer = RayTracer(vertices, triangles)
        self._sign, self._closed = np.float32(sign), closed
        used = vertices[triangles.ravel()] if len(triangles) else np.zeros((1, 3), np.float32)
        self._low, self._high = used.min(axis=0).astype(np.float64), used.max(axis=0).astype(np.float64)
        self._size = max(-self._low.min(), self._high.max(), 0.0)

    def spans(self, origins, directions, reach, inside) -> Spans:
        ray, whole = self._near(origins, directions, reach), reach
        crossed = np.zeros(len(origins), bool)
        known = np.zeros(len(ray), bool) if inside is None else inside.take(ray)
        origins, directions, reach = origins.take(ray, axis=0), directions.take(ray, axis=0), reach.take(ray)
        # Off the surface just crossed, by what the arithmetic can be wrong by.
        size = np.maximum(np.abs(origins).max(axis=1, initial=0), self._size)
        # In float64: a length that overflows makes no step at all, and rays meet one triangle for ever.
        length = np.sqrt(np.square(directions, dtype=np.float64).sum(axis=1))
        offset = _ULPS * size / np.maximum(length, 1e-37)
        last, step = np.zeros((2, len(ray)))
        within = np.zeros(len(ray), bool)  # behind the last crossing, by the side of its triangle
        found = [Spans(np.zeros(0, np.intp), np.zeros(0), np.zeros(0))]

        def add(which: np.ndarray, start: np.ndarray, end: np.ndarray | float) -> None:
            start, end = start[which], np.minimum(end, reach)[which]
            some = end > start
            found.append(Spans(ray[which][some], start[some], end[some]))

        while ray.size:
            hits = self._tracer.closest_hit(_at(origins, directions, last + step), directions)
            met = hits.triangle >= 0
            if not self._closed:
                add(~met & within, last, np.inf)
            ray, origins, directions, reach, known, offset, last, step, within, distance, normal = (
                x.compress(met, axis=0)
                for x in (
                    ray, origins, directions, reach, known, offset, last, step, within,
                    hits.distance, hits.normal,
                )
            )  # fmt: skip
            at = last + step + distance
            entering = self._sign * (normal * directions).sum(axis=1) < 0
            first = ~crossed.take(ray)
            crossed[ray] = True
            if self._closed:
                # Through an edge, or a sliver, a ray may meet but one of two sides: the point between tells.
                inside_between = ~entering
                doubted = np.flatnonzero(np.where(first, inside_between & ~known, inside_between != within))
                middle = ((last + at) / 2).take(doubted)
                inside_between[doubted] = self.contains(
                    _at(origins.take(doubted, axis=0), directions.take(doubted, axis=0), middle)
                )
            else:
                inside_between = np.where(first, ~entering, within)
            add(inside_between, last, at)
            # Along an edge, or a triangle seen edge-on, hits may repeat: ever further then.
            step = np.where(distance < 4 * step, 2 * step, offset)
            last, within, on = at, entering, at < reach
            if self._convex:
                on &= entering
            ray, origins, directions, reach, known, offset, last, step, within = (
                x.compress(on, axis=0)
                for x in (ray, origins, directions, reach, known, offset, last, step, within)
            )
        if inside is not None and not self._closed:
            never = np.flatnonzero(inside & ~crossed)
            found.append(Spans(never, np.zeros(len(never)), whole.take(never)))
        order = np.argsort(np.concatenate([spans.ray for spans in found]), kind="stable")
        return Spans(
            *(
                np.concatenate([getattr(x, name) for x in found]).take(order)
                for name in ("ray", "start", "end")
            )
        )

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(K,) bool, which points (K, 3) are inside, by what a ray in some direction meets first."""
        result = np.zeros(len(points), bool)
        near = np.flatnonzero(((points >= self._low) & (points <= self._high)).all(axis=1))
        some = np.ascontiguousarray(np.broadcast_to(_SOME_DIRECTION, (len(near), 3)))
        hits = self._tracer.closest_hit(points.take(near, axis=0), some)
        leaving = self._sign * (hits.normal * _SOME_DIRECTION).sum(axis=1) > 0
        result[near] = leaving & (hits.triangle >= 0)
        return result

    def _near(self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray) -> np.ndarray:
        """Rays that meet the bounding box within their reach."""
        margin = _ULPS * np.maximum(np.abs(origins).max(initial=0), self._size)
        near, far = np.zeros(len(origins)), reach
        for i in range(3):
            with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
                a = (self._low[i] - margin - origins[:, i]) / directions[:, i]
                b = (self._high[i] + margin - origins[:, i]) / directions[:, i]
            # They pass over NaN: a ray within the plane of a side meets it everywhere.
            near, far = np.fmax(near, np.fmin(a, b)), np.fmin(far, np.fmax(a, b))
        return np.flatnonzero(near <= far)


def _at(origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """(K, 3) float32 points of rays."""
    return (origins + directions * distance[:, None]).astype(np.float32)


def _body_of(vertices: np.ndarray, triangles: np.ndarray) -> _Convex | _Traced:
    """The body that triangles enclose; those with a corner that is not finite are left out."""
    vertices = np.ascontiguousarray(vertices, np.float32)
    finite = np.isfinite(vertices).all(axis=1)
    triangles = np.asarray(triangles)[finite[triangles].all(axis=1)]
    used, compact = np.unique(triangles, return_inverse=True)
    vertices, welded = np.unique(vertices[used], axis=0, return_inverse=True)
    triangles = welded.reshape(-1)[compact.reshape(-1, 3)].astype(np.int32)
    a, b, c = triangles.T
    triangles = np.ascontiguousarray(triangles[(a != b) & (b != c) & (c != a)])
    closed = len(triangles) > 0 and _is_closed(triangles, len(vertices))
    corners = vertices.astype(np.float64)
    corners -= corners.mean(axis=0) if len(corners) else 0
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    sign = -1 if (a * np.cross(b, c)).sum() < 0 else 1
    if not closed:
        return _Traced(vertices, triangles, sign, closed, False)
    corners = vertices.astype(np.float64)
    planes = _planes_of(corners, triangles, sign)
    if planes is None:
        return _Traced(vertices, triangles, sign, closed, _is_convex(corners, triangles, sign))
    return _Convex(*planes)


def _is_closed(triangles: np.ndarray, count: int) -> bool:
    """Whether each edge is run through once in either direction."""
    start, end = triangles.ravel().astype(np.int64), np.roll(triangles, -1, axis=1).ravel()
    return np.array_equal(np.sort(start * count + end), np.sort(end * np.int64(count) + start))


def _is_convex(vertices: np.ndarray, triangles: np.ndarray, sign: int) -> bool:
    """Whether no vertex (V, 3) is above a triangle; unknown of many, which counts as no."""
    if len(triangles) * len(vertices) > _MOST_HEIGHTS:
        return False
    tolerance = _ULPS * np.abs(vertices).max()
    for start in range(0, len(triangles), 256):
        a, b, c = (vertices[triangles[start : start + 256, k]] for k in range(3))
        normals = sign * np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
        if ((normals @ vertices.T).max(axis=1) > (normals * a).sum(axis=1) + tolerance).any():
            return False
    return True


def _planes_of(
    vertices: np.ndarray, triangles: np.ndarray, sign: int
) -> tuple[np.ndarray, np.ndarray] | None:
    """Normals (P, 3) and offsets (P,) of the faces of a convex body; None if it is none, or has many."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normals = sign * np.cross(b - a, c - a)
    area = np.linalg.norm(normals, axis=1)
    tolerance = _ULPS * np.abs(vertices).max()
    if not area.max() > 0:
        return None
    faces, offsets = [], []
    rest = np.flatnonzero(area > 0)
    while rest.size:
        if len(faces) == FEW_PLANES:
            return None
        largest = rest[area[rest].argmax()]
        normal = normals[largest] / area[largest]
        height = vertices @ normal
        offset = height[triangles[largest]].mean()
        if height.max() > offset + tolerance:
            return None
        faces.append(normal)
        offsets.append(height.max())
        rest = rest[np.abs(height[triangles[rest]] - offset).max(axis=1) > tolerance]
    return np.array(faces), np.array(offsets)
