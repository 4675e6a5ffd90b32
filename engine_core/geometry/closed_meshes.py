# SPDX-License-Identifier: GPL-3.0-or-later
"""Which side of a triangle is the outside of its mesh."""

from __future__ import annotations

import numpy as np

_FLAT = 1e-6
"""Of its area to the power 3/2, volume up to which a closed mesh has no inside."""


def outer_sides(vertices: np.ndarray, indices: np.ndarray, mesh: np.ndarray) -> np.ndarray:
    """(T,) int8: 1 where a triangle's corners run counter-clockwise as seen from outside of its mesh, -1
    where clockwise; 0 for all of a mesh that encloses nothing.

    vertices : (V, 3), of which each is of one mesh. indices : (T, 3) of whole meshes. mesh : (T,) their
    numbers from 0 on, ascending.
    """
    if len(indices) == 0:
        return np.zeros(0, np.int8)
    used = np.zeros(len(vertices), bool)
    used[indices] = True
    indices = (np.cumsum(used) - 1)[indices]
    vertices = vertices[used].astype(np.float64)
    mesh_of = np.empty(len(vertices), np.int64)
    mesh_of[indices] = mesh[:, None]
    number, count = _welded(vertices, mesh_of)
    # Numbers of meshes' vertices ascend, and so do those of their edges.
    there, back = edges(number[indices], count)
    meshes = int(mesh[-1]) + 1
    unlike = np.bincount(np.repeat(mesh, 3), there != back, meshes)
    of_mesh = np.maximum(np.bincount(mesh_of, minlength=meshes), 1)
    middle = np.stack([np.bincount(mesh_of, x, meshes) / of_mesh for x in vertices.T], axis=1)
    vertices -= middle[mesh_of]
    a, b, c = (vertices[indices[:, k]] for k in range(3))
    volume = np.bincount(mesh, np.einsum("ij,ij->i", a, np.cross(b, c)) / 6, meshes)
    area = np.bincount(mesh, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2, meshes)
    encloses = (unlike == 0) & (np.abs(volume) > _FLAT * area**1.5)
    return (np.sign(volume) * encloses).astype(np.int8)[mesh]


def edges(indices: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(3 T,) int64, ascending, of triangles (T, 3) of ``count`` vertices: their edges as they run, and turned
    round. What is closed runs through each as often in either direction: both are the same."""
    start, end = indices.astype(np.int64), np.roll(indices, -1, axis=1)
    return np.sort((start * count + end).ravel()), np.sort((end * np.int64(count) + start).ravel())


def _welded(points: np.ndarray, mesh: np.ndarray) -> tuple[np.ndarray, int]:
    """(N,) numbers of points (N, 3), the same for the same places of a mesh, in the order of meshes; and how
    many there are."""
    order = np.lexsort((*points.T, mesh))
    points, mesh = points[order], mesh[order]
    new = (np.diff(points, axis=0) != 0).any(axis=1) | (np.diff(mesh) != 0)
    number = np.empty(len(points), np.int64)
    number[order] = np.append(0, np.cumsum(new))
    return number, int(new.sum()) + 1
