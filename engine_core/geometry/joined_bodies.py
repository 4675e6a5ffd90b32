# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed meshes of one fog that keep clear of each other, as one body: what is done once for a body is done
less often, and more of them are followed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .closed_meshes import outer_sides


def joined(
    meshes: Sequence[tuple[np.ndarray, np.ndarray]], kinds: Sequence[int]
) -> tuple[list[tuple[np.ndarray, np.ndarray]], list[int]]:
    """Meshes (vertices (V, 3), triangles (T, 3)) as bodies, and the kind of each: in one are meshes of one of
    the ``kinds`` whose boxes do not meet, with all their triangles facing outwards.

    What is open, or not finite, is a body of its own.
    """
    closed = np.array([np.isfinite(vertices).all() for vertices, _ in meshes], bool)
    sides = [0] * len(meshes)
    some = np.flatnonzero(closed)
    if some.size:
        count = [len(meshes[i][0]) for i in some]
        first = np.cumsum(count) - count
        number = np.repeat(np.arange(len(some)), [len(meshes[i][1]) for i in some])
        triangles = np.concatenate([meshes[i][1] for i in some]) + first[number][:, None]
        sides_of = outer_sides(np.concatenate([meshes[i][0] for i in some]), triangles, number)
        for i, side in zip(some, sides_of[np.searchsorted(number, np.arange(len(some)))], strict=True):
            sides[i] = int(side)
    groups = [[i] for i, side in enumerate(sides) if side == 0]
    for kind in dict.fromkeys(kinds):
        rows = [i for i, (of, side) in enumerate(zip(kinds, sides, strict=True)) if side and of == kind]
        boxes = np.array([[f(meshes[i][0], axis=0) for f in (np.min, np.max)] for i in rows])
        groups += [[rows[i] for i in some] for some in apart(boxes)]
    groups.sort()
    return [_one([meshes[i] for i in group], [sides[i] for i in group]) for group in groups], [
        kinds[group[0]] for group in groups
    ]


def _one(meshes: list[tuple[np.ndarray, np.ndarray]], sides: list[int]) -> tuple[np.ndarray, np.ndarray]:
    if len(meshes) == 1:
        return meshes[0]
    first, vertices, triangles = 0, [], []
    for (corners, indices), side in zip(meshes, sides, strict=True):
        vertices.append(corners)
        triangles.append((np.asarray(indices) if side > 0 else np.asarray(indices)[:, ::-1]) + first)
        first += len(corners)
    return np.concatenate(vertices), np.concatenate(triangles)


def apart(boxes: np.ndarray) -> list[list[int]]:
    """Numbers of (I, 2, 3) ``boxes`` in as few sets as come easily, none of which has two that meet."""
    sets: list[list[int]] = []
    chosen = np.zeros(len(boxes), int)
    for i, (low, high) in enumerate(boxes):
        met = ((boxes[:i, 0] <= high) & (low <= boxes[:i, 1])).all(axis=1)
        taken = set(chosen[:i][met].tolist())
        chosen[i] = next(k for k in range(len(sets) + 1) if k not in taken)
        if chosen[i] == len(sets):
            sets.append([])
        sets[chosen[i]].append(i)
    return sets
