# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rays are inside closed meshes, which may be nested, overlap or touch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np

from .closed_meshes import edges
from .near_balls import NearBalls
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
    """K stretches of rays inside bodies: from ``start`` to ``end`` (K,) float64, in lengths of the direction.

    body, ray : (K,). Those of one ray in one body do not overlap, and come in their order along it. A span
    that begins at 0 or ends at the ray's reach may go on there.
    """

    body: np.ndarray
    ray: np.ndarray
    start: np.ndarray
    end: np.ndarray

    @staticmethod
    def joined(spans: list[Spans]) -> Spans:
        if len(spans) == 1:
            return spans[0]
        return Spans(*(np.concatenate([getattr(x, f.name) for x in spans]) for f in fields(Spans)))


class Boundaries:
    """Closed meshes as bodies that rays enter and leave.

    Only the sides of triangles decide what is inside: a body's first crossing tells whether the ray began
    there. So no state need be handed from ray to ray, and none can be wrong. A mesh turned inside out is
    taken the other way round. In an open mesh, what is entered and not left is inside to the ray's end.

    convex : whether all bodies are known to be. balls : centre (3,) and radius of a ball around each.
    """

    def __init__(self, bodies: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """bodies : vertices (V, 3) float32 and triangles (T, 3) of each, at most `MOST`."""
        self.balls = [_ball_around(vertices) for vertices, _ in bodies]
        shapes = [_shape_of(vertices, triangles) for vertices, triangles in bodies]
        clipped = [i for i, shape in enumerate(shapes) if isinstance(shape, _Planes)]
        traced = [i for i, shape in enumerate(shapes) if isinstance(shape, _Triangles)]
        self.convex = not traced
        self._kinds = [
            kind(np.array(rows), [shapes[i] for i in rows], NearBalls([self.balls[i] for i in rows]))
            for kind, rows in ((_Clipped, clipped), (_Traced, traced))
            if rows
        ]

    def __len__(self) -> int:
        return len(self.balls)

    def spans(
        self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray, inside: np.ndarray | None
    ) -> Spans:
        """Where rays are inside bodies, between 0 and their ``reach`` (N,).

        origins, directions : (N, 3) float32, of any length.
        inside : (N,) uint64, the bodies in which rays begin, a bit each; None if unknown. Needed of an open
            body alone, which a ray may not meet any more; of others it saves work.
        """
        return Spans.joined([kind.spans(origins, directions, reach, inside) for kind in self._kinds])


def _ball_around(vertices: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) and radius of a ball that holds vertices (V, 3), not the smallest one."""
    corners = vertices[np.isfinite(vertices).all(axis=1)].astype(np.float64)
    if len(corners) == 0:
        return np.zeros(3), 0.0
    centre = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return centre, float(np.sqrt(((corners - centre) ** 2).sum(axis=1).max()))


class _Planes:
    """A closed convex body of few faces: slabs, between planes that are parallel.

    normals : (S, 3) float64. low, high : (S, 1) along them.
    """

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
        self.normals = np.array([normal for normal, _, _ in slabs])
        self.low, self.high = np.array([slab[1:] for slab in slabs]).T[..., None]

    def clip(
        self, origins: np.ndarray, directions: np.ndarray, reach: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (K,) of rays that meet the body, where they begin to be inside, and where they end to be."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            along = 1 / _along(self.normals, directions)
            height = _along(self.normals, origins)
            low, high = self.low - height, self.high - height
            low *= along
            high *= along
        # A ray along a slab is between its planes for good, or outside: both are infinite, of one sign. One
        # within a plane, where there is a NaN, counts as outside.
        start = np.fmin(low, high).max(axis=0)
        end = np.fmax(low, high).min(axis=0)
        np.fmax(start, 0, out=start)
        np.fmin(end, reach, out=end)
        some = np.flatnonzero(end > start)
        return some, start.take(some), end.take(some)


class _Clipped:
    """Bodies that rays are clipped against."""

    def __init__(self, numbers: np.ndarray, bodies: list[_Planes], near: NearBalls) -> None:
        """numbers : (B,) of the bodies, among all. near : balls around them."""
        self._numbers, self._bodies, self._near = numbers, bodies, near

    def spans(self, origins, directions, reach, inside) -> Spans:
        if len(self._bodies) == 1:  # to clip is to find out what is near
            found = self._bodies[0].clip(origins, directions, reach)
            return Spans(np.full(len(found[0]), self._numbers[0]), *found)
        body, ray = self._near.pairs(origins, directions, reach)
        found = []
        for number, planes, of_body in zip(
            self._numbers, self._bodies, _runs(body, len(self._bodies)), strict=True
        ):
            rows = ray[of_body]
            some, start, end = planes.clip(
                origins.take(rows, axis=0), directions.take(rows, axis=0), reach.take(rows)
            )
            found.append(Spans(np.full(len(some), number), rows.take(some), start, end))
        return Spans.joined(found)


def _runs(body: np.ndarray, count: int) -> list[slice]:
    """Where each of ``count`` bodies is in ascending numbers (P,)."""
    bounds = np.searchsorted(body, np.arange(count + 1))
    return [slice(*bound) for bound in pairwise(bounds)]


def _along(normals: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """(P, N) inner products of (P, 3) and (N, 3). Not by ``@``, as `integration.rules.weighted`."""
    out = normals[:, :1] * vectors[:, 0]
    out += normals[:, 1:2] * vectors[:, 1]
    out += normals[:, 2:] * vectors[:, 2]
    return out


@dataclass(eq=False)
class _Triangles:
    """Any body, by its triangles.

    sign : -1 if they face inwards. closed : whether every edge joins two of them. convex : whether rays leave
    it but once.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    sign: int
    closed: bool
    convex: bool


class _Traced:
    """Bodies that rays are traced against: a tracer each, of what comes near it."""

    def __init__(self, numbers: np.ndarray, bodies: list[_Triangles], near: NearBalls) -> None:
        """numbers : (B,) of the bodies, among all. near : balls around them."""
        self._numbers, self._near = numbers, near
        self._tracers = [RayTracer(body.vertices, body.triangles) for body in bodies]
        self._sign = np.array([body.sign for body in bodies], np.float32)
        self._convex = np.array([body.convex for body in bodies])
        closed = np.array([body.closed for body in bodies])
        self._closed, self._open = closed, np.flatnonzero(~closed)
        none = np.zeros((1, 3), np.float32)
        used = [body.vertices[body.triangles.ravel()] if len(body.triangles) else none for body in bodies]
        self._low, self._high = (
            np.array([f(vertices, axis=0) for vertices in used], np.float64) for f in (np.min, np.max)
        )
        self._size = np.maximum(np.maximum(-self._low, self._high).max(axis=1), 0.0)

    def spans(self, origins, directions, reach, inside) -> Spans:
        body, ray = self._near.pairs(origins, directions, reach)
        known = np.zeros(len(ray), bool)
        if inside is not None:
            known = _bit(inside.take(ray), self._numbers.take(body))
        rays = reach
        origins, directions, reach = origins.take(ray, axis=0), directions.take(ray, axis=0), reach.take(ray)
        # Off the surface just crossed, by what the arithmetic can be wrong by.
        size = np.maximum(np.abs(origins).max(axis=1, initial=0), self._size.take(body))
        # In float64: a length that overflows makes no step at all, and rays meet one triangle for ever.
        length = np.sqrt(np.square(directions, dtype=np.float64).sum(axis=1))
        offset = _ULPS * size / np.maximum(length, 1e-37)
        last, step = np.zeros((2, len(ray)))
        within = np.zeros(len(ray), bool)  # behind the last crossing, by the side of its triangle
        first, crossed = True, (body[:0], ray[:0])
        nothing = np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0), np.zeros(0)
        found = [Spans(*nothing)]

        def add(which: np.ndarray, start: np.ndarray, end: np.ndarray | float) -> None:
            end = np.minimum(end, reach)
            some = np.flatnonzero(which & (end > start))
            numbers = self._numbers.take(body.take(some))
            found.append(Spans(numbers, ray.take(some), start.take(some), end.take(some)))

        while ray.size:
            met, distance, normal = self._closest(body, _at(origins, directions, last + step), directions)
            if first:
                crossed = body[met], ray[met]
            at = last + step + distance
            entering = self._sign.take(body) * (normal * directions).sum(axis=1) < 0
            # Through an edge, or a sliver, a ray may meet but one of two sides of a closed body: the point
            # between tells.
            inside_between = ~entering
            doubted = met & (inside_between & ~known if first else inside_between != within)
            if self._open.size:
                closed = self._closed.take(body)
                add(~met & within & ~closed, last, np.inf)
                doubted &= closed
                if not first:
                    inside_between = np.where(closed, inside_between, within)
            rows = np.flatnonzero(doubted)
            if rows.size:
                middle = ((last + at) / 2).take(rows)
                inside_between[rows] = self._contain(
                    body.take(rows), _at(origins.take(rows, axis=0), directions.take(rows, axis=0), middle)
                )
            add(met & inside_between, last, at)
            on = np.flatnonzero(met & (at < reach) & (entering | ~self._convex.take(body)))
            # Along an edge, or a triangle seen edge-on, hits may repeat: ever further then.
            step = np.where(distance < 4 * step, 2 * step, offset)
            body, ray, origins, directions, reach, known, offset, last, step, within = (
                x.take(on, axis=0)
                for x in (body, ray, origins, directions, reach, known, offset, at, step, entering)
            )
            first = False
        for k in self._open if inside is not None else ():
            never = _bit(inside, self._numbers[k])
            never[crossed[1][crossed[0] == k]] = False
            rows = np.flatnonzero(never)
            found.append(
                Spans(np.full(len(rows), self._numbers[k]), rows, np.zeros(len(rows)), rays.take(rows))
            )
        return Spans.joined(found)

    def _closest(
        self, body: np.ndarray, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of rays (P, 3) whether they meet their body (P,), at what distance, and the triangle's normal."""
        hits = [
            tracer.closest_hit(origins[rows], directions[rows])
            for tracer, rows in zip(self._tracers, _runs(body, len(self._tracers)), strict=True)
            if rows.stop > rows.start
        ]
        triangle, distance, normal = (
            np.concatenate([getattr(hit, name) for hit in hits]) if len(hits) > 1 else getattr(hits[0], name)
            for name in ("triangle", "distance", "normal")
        )
        return triangle >= 0, distance, normal

    def _contain(self, body: np.ndarray, points: np.ndarray) -> np.ndarray:
        """(P,) bool, which points (P, 3) are in their body, by what a ray in some direction meets first."""
        within = (points >= self._low.take(body, axis=0)) & (points <= self._high.take(body, axis=0))
        met, _, normal = self._closest(body, points, np.tile(_SOME_DIRECTION, (len(points), 1)))
        return met & within.all(axis=1) & (self._sign.take(body) * (normal * _SOME_DIRECTION).sum(axis=1) > 0)


def _bit(sets: np.ndarray, body: np.ndarray) -> np.ndarray:
    """(K,) bool, whether a body, or each of some (K,), is in sets of bits (K,)."""
    return (sets >> body.astype(np.uint64)) & np.uint64(1) > 0


def _at(origins: np.ndarray, directions: np.ndarray, distance: np.ndarray) -> np.ndarray:
    """(K, 3) float32 points of rays."""
    return (origins + directions * distance[:, None]).astype(np.float32)


def _shape_of(vertices: np.ndarray, triangles: np.ndarray) -> _Planes | _Triangles:
    """The body that triangles enclose; those with a corner that is not finite are left out."""
    vertices = np.ascontiguousarray(vertices, np.float32)
    finite = np.isfinite(vertices).all(axis=1)
    triangles = np.asarray(triangles)[finite[triangles].all(axis=1)]
    used, compact = np.unique(triangles, return_inverse=True)
    vertices, welded = np.unique(vertices[used], axis=0, return_inverse=True)
    triangles = welded.reshape(-1)[compact.reshape(-1, 3)].astype(np.int32)
    a, b, c = triangles.T
    triangles = np.ascontiguousarray(triangles[(a != b) & (b != c) & (c != a)])
    closed = len(triangles) > 0 and np.array_equal(*edges(triangles, len(vertices)))
    corners = vertices.astype(np.float64)
    corners -= corners.mean(axis=0) if len(corners) else 0
    a, b, c = (corners[triangles[:, k]] for k in range(3))
    sign = -1 if (a * np.cross(b, c)).sum() < 0 else 1
    if not closed:
        return _Triangles(vertices, triangles, sign, closed, False)
    corners = vertices.astype(np.float64)
    planes = _planes_of(corners, triangles, sign)
    if planes is None:
        return _Triangles(vertices, triangles, sign, closed, _is_convex(corners, triangles, sign))
    return _Planes(*planes)


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
