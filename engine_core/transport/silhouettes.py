# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels in which one thing ends before another, found without a look at any light.

Over a plane 1 / depth is an affine function of the picture, so its second differences are 0; across an
outline they are not. What a camera ray brings through fog jumps there, and no polynomial follows. Nor does
one where a body of fog ends: there the way through it is steep as a root.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry.raytracer import FAR
from ..geometry.surfaces import Surfaces
from ..integration.mapping import Map
from .camera_rays import CameraRays
from .media import Media

BEND = 0.03
"""Second difference of 1 / depth, relative to it, that is an outline."""

ROWS = 32
"""Of the picture, traced at once."""

MARGIN = 2
"""Pixels about the image of a box, for what rounding does."""

BETWEEN = np.array([0.25, 0.5, 0.75], np.float32)
"""Places between the corners of a pixel beside an outline, where more of it may pass."""

ROUNDS = 8
"""Pixels that an outline is followed between corners."""


def silhouettes(
    rays: CameraRays,
    surfaces: Surfaces,
    region: tuple[int, int, int, int],
    map_: Map,
    media: Media | None = None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """(W, H) bool, pixels of ``region`` (x0, y0, x1, y1) that an outline of surfaces crosses; and
    (W + 1, H + 1) uint64, a bit for each body of ``media`` that is seen at pixels' corners, None without any.

    map_ : runs a function over items on the workers, and returns the results in order.
    """
    x0, y0, x1, y1 = region

    def look(
        column: np.ndarray, row: np.ndarray, place: np.ndarray, media: Media | None = None
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """1 / distance (N, S) at places (2, N, S) of pixels' unit squares; bodies of ``media`` (N * S,)."""
        u = np.full((rays.dimensions, *place.shape[1:]), 0.5, np.float32)  # the lens' middle
        u[:2] = place
        origins, directions = rays.rays(column, row, u)
        distance = surfaces.distance(origins, directions, rays.reach)
        # What the far plane hides is as far as nothing: the world's fog goes on behind it.
        seen = np.where(distance < np.float32(rays.reach), distance, FAR)
        with np.errstate(divide="ignore"):
            inverse = (1 / (seen + np.float32(rays.clip_start))).reshape(place.shape[1:])
        return inverse, None if media is None else media.met(origins, directions, distance)

    foggy = media if media is not None and media.bodies else None
    if foggy is not None and _through_all(rays, region, foggy):
        foggy = None
    # Corners, and one more beyond each side for the differences.
    low, high = np.array([[x0, y0], [x1, y1]]) + [[-1], [2]]
    shape = tuple(high - low)
    met = np.zeros(shape, np.uint64, order="F") if foggy is not None else None
    inverse = np.full(shape, 1 / FAR, np.float32, order="F")
    if foggy is None:
        low, high = _about_all(rays, surfaces.triangles.vertices, low, high)
    x = np.arange(low[0], high[0])

    def trace(first: int) -> None:
        y = np.arange(first, min(first + ROWS, high[1]))
        column, row = (a.ravel() for a in np.meshgrid(x, y))
        found = look(column, row, np.zeros((2, len(column), 1), np.float32), foggy)
        at = tuple(slice(a[0] - start, a[-1] + 1 - start) for a, start in ((x, x0 - 1), (y, y0 - 1)))
        for whole, part in zip((inverse, met), found, strict=True):
            if part is not None:
                whole[at] = part.reshape(len(y), len(x)).T

    if len(x):
        map_(trace, range(low[1], high[1], ROWS))
    bent = map_(lambda row: _bent(inverse[:, row : row + ROWS + 3]), range(0, y1 - y0, ROWS))
    found = np.concatenate(bent, axis=1)
    fresh = np.stack(np.nonzero(found & ~_surrounded(found)))
    for _ in range(ROUNDS):
        along = _follow(found, fresh, inverse, 0, region[:2], look)
        across = _follow(found, np.concatenate([fresh, along], axis=1), inverse, 1, region[:2], look)
        fresh = np.concatenate([along, across], axis=1)
        if not fresh.size:
            break
    return found, None if met is None else met[1:-1, 1:-1]


def _about_all(
    rays: CameraRays, vertices: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Of corners of pixels, those from ``low`` (2,) to before ``high`` about what of ``vertices`` (V, 3) is
    in the picture: nothing is met elsewhere.
    """
    if not len(vertices):
        return low, low
    # By columns, as reductions over rows of three are slow.
    ends = np.array([[column.min(), column.max()] for column in vertices.T]).T
    box = np.stack([ends[list(corner), range(3)] for corner in np.ndindex(2, 2, 2)], axis=1)
    image, depth = rays.image_of(box)
    if not (depth > 0).all() or not np.isfinite(image).all():
        return low, high
    image = np.clip(image, low[:, None] - MARGIN, high[:, None] + MARGIN)
    first = np.floor(image.min(axis=1)).astype(int) - MARGIN
    last = np.ceil(image.max(axis=1)).astype(int) + MARGIN
    first = np.clip(first, low, high)
    return first, np.clip(last, first, high)


def _bent(inverse: np.ndarray) -> np.ndarray:
    """(W, H) bool, pixels with an outline between two of their corners. inverse : (W + 3, H + 3) of corners,
    and of one more beyond each side.
    """
    found = np.zeros([n - 3 for n in inverse.shape], bool, order="F")
    for axis in range(2):
        q = np.moveaxis(inverse, axis, 0)
        bend = np.abs(q[:-2] - 2 * q[1:-1] + q[2:])
        sharp = bend > BEND * np.maximum(np.maximum(q[:-2], q[2:]), q[1:-1])
        # An edge between two corners bends the line at both.
        crossed = np.moveaxis(sharp[:-1] & sharp[1:], 0, axis)
        other = [slice(None)] * 2
        other[1 - axis] = slice(1, -1)
        crossed = crossed[tuple(other)]
        first, last = [slice(None)] * 2, [slice(None)] * 2
        first[1 - axis], last[1 - axis] = slice(None, -1), slice(1, None)
        found |= crossed[tuple(first)] | crossed[tuple(last)]
    return found


def _through_all(rays: CameraRays, region: tuple[int, int, int, int], media: Media) -> bool:
    """Whether all rays of ``region`` run through all bodies, as those at its corners tell of convex ones."""
    if not media.convex:
        return False
    x, y = (a.ravel() for a in np.meshgrid([region[0] - 1, region[2] + 1], [region[1] - 1, region[3] + 1]))
    u = np.full((rays.dimensions, len(x), 1), 0.5, np.float32)  # the lens' middle
    u[:2] = 0
    met = media.met(*rays.rays(x, y, u), rays.reach)
    return bool((met == np.uint64((1 << media.bodies) - 1)).all())


def of_bodies(met: np.ndarray) -> np.ndarray:
    """(W, H) bool, pixels whose corners (W + 1, H + 1) see not all the same bodies."""
    width, height = (n - 1 for n in met.shape)
    first, *others = (met[x : x + width, y : y + height] for x, y in np.ndindex(2, 2))
    return np.logical_or.reduce([first != other for other in others])


def _surrounded(found: np.ndarray) -> np.ndarray:
    """(W, H) bool, pixels whose four neighbours, as far as there are any, are all ``found`` (W, H)."""
    whole = np.ones_like(found)
    for axis in range(2):
        inner, known = (np.moveaxis(a, axis, 0) for a in (whole, found))
        inner[1:] &= known[:-1]
        inner[:-1] &= known[1:]
    return whole


def _follow(
    found: np.ndarray,
    fresh: np.ndarray,
    inverse: np.ndarray,
    axis: int,
    corner: tuple[int, int],
    look: Callable,
) -> np.ndarray:
    """Mark pixels that an outline enters from ``fresh`` (2, N) ones next to them along an axis, and leaves
    again through the same side; returns them (2, M).

    inverse : 1 / distance at corners, from the one before the first on. look : the same between them.
    """
    others, sides = [], []
    for step in (-1, 1):
        other = fresh.copy()
        other[axis] += step
        inside = np.flatnonzero((other[axis] >= 0) & (other[axis] < found.shape[axis]))
        inside = inside[~found[tuple(other[:, inside])]]
        others.append(other[:, inside])
        # Of both pixels the later one begins where they meet.
        sides.append(np.maximum(fresh, other)[:, inside])
    x, y = np.concatenate(sides, axis=1)
    first, last = inverse[x + 1, y + 1], inverse[x + 1 + axis, y + 2 - axis]
    place = np.zeros((2, len(x), len(BETWEEN)), np.float32)
    place[1 - axis] = BETWEEN
    there = look((x + corner[0]).astype(np.int32), (y + corner[1]).astype(np.int32), place)[0]
    straight = first[:, None] + BETWEEN * (last - first)[:, None]
    most = np.maximum(np.maximum(first, last)[:, None], there)
    crossed = (np.abs(there - straight) > BEND * most).any(axis=1)
    entered = np.concatenate(others, axis=1)[:, crossed]
    found[tuple(entered)] = True
    return entered


class Silhouettes:
    """The same of one picture, traced once for whoever asks."""

    def __init__(self, rays: CameraRays, surfaces: Surfaces, media: Media | None) -> None:
        self._rays, self._surfaces, self._media = rays, surfaces, media
        self._found: dict[tuple[int, int, int, int], tuple[np.ndarray, np.ndarray | None]] = {}

    def __call__(self, region: tuple[int, int, int, int], map_: Map) -> np.ndarray:
        """Outlines of surfaces, as `silhouettes`; the caller's own copy."""
        return self._traced(region, map_)[0].copy()

    def bodies(self, region: tuple[int, int, int, int], map_: Map) -> np.ndarray | None:
        """What is seen of fog, as `silhouettes`."""
        return self._traced(region, map_)[1]

    def with_fog(self, region: tuple[int, int, int, int], map_: Map) -> np.ndarray:
        """Outlines of surfaces and of bodies of fog."""
        found, met = self(region, map_), self.bodies(region, map_)
        return found if met is None else found | of_bodies(met)

    def _traced(self, region: tuple[int, int, int, int], map_: Map) -> tuple[np.ndarray, np.ndarray | None]:
        if region not in self._found:
            self._found[region] = silhouettes(self._rays, self._surfaces, region, map_, self._media)
        return self._found[region]
