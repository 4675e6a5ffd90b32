# SPDX-License-Identifier: GPL-3.0-or-later
"""Which side of a triangle is the outside of its mesh."""

from __future__ import annotations

import numpy as np

_FLAT = 1e-6
"""Of its area to the power 3/2, volume up to which a closed mesh has no inside."""


def outer_sides(corners: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """(T,) int8: 1 where a triangle's corners run counter-clockwise as seen from outside of its mesh, -1 where
    clockwise; 0 for all of a mesh that encloses nothing.

    corners : (T, 3, 3) of whole meshes. mesh : (T,) their numbers from 0 on, ascending.
    """
    if len(corners) == 0:
        return np.zeros(0, np.int8)
    corners = np.asarray(corners, np.float64)
    vertex, count = _welded(corners.reshape(-1, 3), np.repeat(mesh, 3))
    ends = vertex.reshape(-1, 3)
    following = np.roll(ends, -1, axis=1)
    # Closed, if each edge is run through as often in either direction. Meshes have vertices of their own.
    there, back = np.sort((ends * count + following).ravel()), np.sort((following * count + ends).ravel())
    meshes = int(mesh[-1]) + 1
    unlike = np.bincount(np.repeat(mesh, 3), there != back, meshes)
    number = np.maximum(np.bincount(mesh, minlength=meshes), 1)
    middle = np.stack([np.bincount(mesh, x, meshes) / number for x in corners.mean(axis=1).T], axis=1)
    a, b, c = np.moveaxis(corners - middle[mesh][:, None], 1, 0)
    volume = np.bincount(mesh, (a * np.cross(b, c)).sum(axis=1) / 6, meshes)
    area = np.bincount(mesh, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, meshes)
    encloses = (unlike == 0) & (np.abs(volume) > _FLAT * area**1.5)
    return (np.sign(volume) * encloses).astype(np.int8)[mesh]


def _welded(points: np.ndarray, mesh: np.ndarray) -> tuple[np.ndarray, int]:
    """(N,) numbers of points (N, 3), the same for the same places of a mesh, in the order of meshes; and how
    many there are."""
    order = np.lexsort((*points.T, mesh))
    new = (np.diff(points[order], axis=0) != 0).any(axis=1) | (np.diff(mesh[order]) != 0)
    number = np.empty(len(points), np.int64)
    number[order] = np.append(0, np.cumsum(new))
    return number, int(new.sum()) + 1
