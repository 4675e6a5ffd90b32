# SPDX-License-Identifier: GPL-3.0-or-later
"""How the emissive triangles of a scene are parted into pieces, none of them long, and these into lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...geometry.closed_meshes import outer_sides
from ...geometry.triangles import Triangles
from ...scene import Material

ALONE = 8
"""Up to how many emissive triangles of a scene are a light each: then none has to be chosen of a light."""

CLUSTERS, FEWEST = 256, 128
"""About how many lights all emissive triangles of a scene are parted into, and what no light has more of them
than one in."""

LONG, MOST_CUT = 4.0, 1024
"""Edges over heights of triangles that are cut, and about how many pieces are gained at most."""

LEVELS = 20
"""Of the octree that pieces are sorted by."""

# Shifts of the upper halves of 21 bits, of these again, and so on, and the bits that may be set then.
_SPREADING = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)

MOST_PAIRS = 1 << 22
"""Of meshes, of which one may enclose the other, that are looked at."""

TIP = 0.05
"""Of the longest edge, how near its ends the third corner may be for the triangle to be a needle."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """E emissive triangles, or parts of long ones, light after light.

    row : (E,) int32, the scene's triangle of each. corners : (E, 3, 3) float64.
    weights : (E, 3, 2) float32, weights of the corners 1 and 2 of that triangle at each of these.
    side : (E,) int8, of a triangle of a closed body into which nobody looks, 1 if its corners run
        counter-clockwise as seen from outside, -1 if clockwise; 0 of others, which are seen from both sides.
    first : (L + 1,) where each light begins.
    code : (E,) int64, of the pieces' middles along a Morton curve, ascending in each light.
    """

    row: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    side: np.ndarray
    first: np.ndarray
    code: np.ndarray


def emissive_pieces(
    materials: Sequence[Material], triangles: Triangles, transmits: np.ndarray | None = None
) -> Pieces | None:
    """The pieces of all triangles that emit; None if none does.

    A light is of one material, linked in one way, and of pieces near each other along a Morton curve.
    transmits : (number of materials,) bool, which let light straight through; None for none.
    """
    emissive = np.array([(material.emission > 0).any() for material in materials])
    if not emissive.any():
        return None
    row = np.flatnonzero(emissive[triangles.material])
    corners = _corners(triangles, row)
    row, corners = (x[_areas(corners) > 0] for x in (row, corners))
    if row.size == 0:
        return None
    side, weights = _sides(row, triangles, transmits), _whole(len(row))
    alone = row.size <= ALONE
    if not alone:
        row, side, corners, weights = _cut(row, side, corners, weights)
    code = morton_codes(corners.mean(axis=1))
    kind = triangles.material[row] + len(materials) * triangles.linked(row)[0]
    order = np.lexsort((code, kind))
    row, side, corners, weights, kind, code = (x[order] for x in (row, side, corners, weights, kind, code))
    of_kind = np.append(np.flatnonzero(np.diff(kind, prepend=-1)), row.size)
    first = np.arange(row.size + 1) if alone else _parted(code, of_kind, max(ALONE, -(-row.size // FEWEST)))
    return Pieces(row.astype(np.int32), corners, weights, side, first, code)


def morton_codes(middle: np.ndarray) -> np.ndarray:
    """(E,) int64 of places (E, 3) along a Morton curve: three bits a level of an octree about them all."""
    low, high = middle.min(axis=0), middle.max(axis=0)
    most = (1 << LEVELS) - 1
    cell = ((middle - low) / np.maximum((high - low).max(), 1e-300) * most).astype(np.int64)
    # Two bits of 0 between any two, by halves.
    for shift, mask in _SPREADING:
        cell = (cell | (cell << shift)) & mask
    return cell[:, 0] | (cell[:, 1] << 1) | (cell[:, 2] << 2)


def highest_bit(x: np.ndarray) -> np.ndarray:
    """Of int64 x (N,) >= 0, the highest bit alone; 0 of 0."""
    for shift in (1, 2, 4, 8, 16, 32):
        x = x | (x >> shift)
    return x ^ (x >> 1)


def _parted(code: np.ndarray, first: np.ndarray, most: int) -> np.ndarray:
    """Where runs (R + 1,) of ``first`` begin when they are halved until none has more than ``most`` pieces.

    By what their codes (E,) first differ in, so that what is far from the others is not with them.
    """
    while True:
        start, stop = first[:-1], first[1:]
        long = np.flatnonzero(stop - start > most)
        if long.size == 0:
            return first
        start, stop = start[long], stop[long]
        bit = highest_bit(code[start] ^ code[stop - 1])
        many = stop - start
        begins = np.cumsum(many) - many
        number = np.arange(many.sum()) + np.repeat(start - begins, many)
        beyond = np.add.reduceat(code[number] & np.repeat(bit, many) > 0, begins, dtype=np.intp)
        middle = np.where(bit > 0, stop - beyond, start + many // 2)
        first = np.sort(np.append(first, middle))


def _corners(triangles: Triangles, row: np.ndarray) -> np.ndarray:
    return triangles.vertices[triangles.indices[row]].astype(np.float64)


def _whole(count: int) -> np.ndarray:
    return np.tile(np.array([[0, 0], [1, 0], [0, 1]], np.float32), (count, 1, 1))


def _areas(corners: np.ndarray) -> np.ndarray:
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.linalg.norm(np.cross(a, b), axis=1) / 2


def _sides(row: np.ndarray, triangles: Triangles, transmits: np.ndarray | None) -> np.ndarray:
    """(E,) as `Pieces.side`, of emissive triangles ``row`` (E,)."""
    count = np.diff(triangles.first)
    mesh = np.repeat(np.arange(len(count)), count)
    glowing = np.bincount(mesh[row], minlength=len(count))
    clear = ~np.broadcast_to(triangles.casts_shadow & triangles.visible_to_camera, len(triangles))
    if transmits is not None:
        clear = clear | transmits[triangles.material]
    # Rooms with a ceiling that glows are no lamps.
    body = (glowing > 0) & (2 * glowing >= count) & (np.bincount(mesh, clear, len(count)) == 0)
    body[body] = ~_enclosing(np.flatnonzero(body), triangles)
    whole = np.flatnonzero(body[mesh])
    side = np.zeros(len(triangles), np.int8)
    number = np.cumsum(body) - 1
    side[whole] = outer_sides(triangles.vertices, triangles.indices[whole], number[mesh[whole]])
    return side[row]


def _enclosing(some: np.ndarray, triangles: Triangles) -> np.ndarray:
    """(K,) bool, whether the camera, which is the frame's origin, or all of another mesh may be within meshes
    ``some`` (K,): is in their bounding boxes."""
    first = triangles.first
    filled = np.flatnonzero(np.diff(first))
    low, high = np.full((2, len(first) - 1, 3), np.nan)
    corners = [triangles.vertices[triangles.indices[:, k]] for k in range(3)]
    low[filled] = np.min([np.minimum.reduceat(c, first[filled]) for c in corners], axis=0)
    high[filled] = np.max([np.maximum.reduceat(c, first[filled]) for c in corners], axis=0)
    found = ((low[some] <= 0) & (high[some] >= 0)).all(axis=1)
    # Only what begins between a mesh's ends along x can be within.
    order = np.argsort(low[:, 0])
    start = np.searchsorted(low[order, 0], low[some, 0])
    count = np.searchsorted(low[order, 0], high[some, 0], side="right") - start
    # Of too many, those among most others may as well be taken for enclosing.
    crowded = np.empty(len(some), bool)
    by_count = np.argsort(count, kind="stable")
    crowded[by_count] = np.cumsum(count[by_count]) > MOST_PAIRS
    found |= crowded
    count[found] = 0
    which = np.repeat(np.arange(len(some)), count)
    other = order[np.arange(len(which)) + np.repeat(start - (np.cumsum(count) - count), count)]
    mesh = some[which]
    within = ((low[other] >= low[mesh]) & (high[other] <= high[mesh])).all(axis=1) & (other != mesh)
    return found | (np.bincount(which, within, len(some)) > 0)


def _cut(
    row: np.ndarray, side: np.ndarray, corners: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What is long in strips across, of two triangles each but at the tips."""
    edges = np.roll(corners, -1, axis=1) - corners
    lengths = np.sqrt((edges * edges).sum(axis=2))
    longest = lengths.max(axis=1)
    areas = _areas(corners)
    # What is shorter than a light is wide is not long.
    limit = np.maximum(LONG * 2 * areas / longest, 2 * np.sqrt(areas.sum() / CLUSTERS))
    # Strips are no shorter than what makes so many of them.
    low, high = 0.0, float(longest.max())
    for _ in range(40):
        least = (low + high) / 2
        many = 2 * (np.ceil(longest / np.maximum(limit, least)) - 1).sum() > MOST_CUT
        low, high = (least, high) if many else (low, least)
    limit = np.maximum(limit, high)
    long = np.flatnonzero(longest > limit)
    # From A to B is the longest edge; C is above F on it.
    order = (lengths[long].argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(
        np.take_along_axis(np.concatenate([corners, weights], axis=2)[long], order[..., None], axis=1), 1, 0
    )
    along = (b - a)[:, :3]
    foot = ((c - a)[:, :3] * along).sum(axis=1) / (longest[long] ** 2)
    f = a + foot[:, None] * (b - a)
    # A tip, the ends of a short edge, and how long that is; next to the ends there is no second one.
    whole = np.minimum(foot, 1 - foot) < TIP
    parts = (
        (whole & (foot > 0.5), a, b, c, np.ones_like(foot)),
        (whole & (foot <= 0.5), b, c, a, np.ones_like(foot)),
        (~whole, a, f, c, foot),
        (~whole, b, c, f, 1 - foot),
    )
    found = []
    for some, tip, x, y, share in parts:
        tip, x, y = tip[some], x[some], y[some]
        count = np.ceil(share[some] * longest[long][some] / limit[long][some]).astype(int)
        which = np.repeat(np.arange(len(count)), count)
        number = np.arange(len(which)) - np.repeat(np.cumsum(count) - count, count)
        near, far = (((number + i) / count[which])[:, None] for i in (0, 1))
        tip, x, y = tip[which], (x - tip)[which], (y - tip)[which]
        from_, numbers = long[some][which], number > 0
        found.append((from_, np.stack([tip + near * x, tip + far * x, tip + far * y], axis=1)))
        second = np.stack([tip + near * x, tip + far * y, tip + near * y], axis=1)
        found.append((from_[numbers], second[numbers]))
    source, cut = (np.concatenate(x) for x in zip(*found, strict=True))
    rest = np.flatnonzero(longest <= limit)
    return (
        np.concatenate([row[rest], row[source]]),
        np.concatenate([side[rest], side[source]]),
        np.concatenate([corners[rest], cut[..., :3]]),
        np.concatenate([weights[rest], cut[..., 3:].astype(np.float32)]),
    )
