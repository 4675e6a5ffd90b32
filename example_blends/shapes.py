# SPDX-License-Identifier: GPL-3.0-or-later
"""Shapes as arrays: (V, 3) vertices and (F, 3 or 4) faces, counterclockwise seen from outside."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Shape = tuple[np.ndarray, np.ndarray]


def grid_faces(rows: int, columns: int, around: bool = False) -> np.ndarray:
    """(F, 4) squares between ``rows`` x ``columns`` vertices; ``around`` closes every row to a ring."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - (not around)), indexing="ij")
    k = (j + 1) % columns
    corners = (i * columns + j, i * columns + k, (i + 1) * columns + k, (i + 1) * columns + j)
    return np.stack(corners, -1).reshape(-1, 4)


def box(size: Sequence[float]) -> Shape:
    """A box of ``size`` that stands on z = 0, centred in x and y."""
    corners = np.array([(x, y, z) for z in (0, 1) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (1, 3, 7, 5), (3, 2, 6, 7), (2, 0, 4, 6)]
    return corners * size, np.array(faces)


def block(low: Sequence[float], high: Sequence[float]) -> Shape:
    """A box between two corners."""
    low, high = np.array(low, float), np.array(high, float)
    vertices, faces = box(high - low)
    x, y, _ = (low + high) / 2
    return vertices + (x, y, low[2]), faces


def ball(radius: float, centre: Sequence[float] = (0, 0, 0), cells: int = 12) -> Shape:
    """A ball of 12 ``cells``^2 triangles: a cube of ``cells``^2 squares a side, blown up."""
    t = np.tan(np.linspace(-np.pi / 4, np.pi / 4, cells + 1))
    u, v = (a.ravel() for a in np.meshgrid(t, t, indexing="ij"))
    one, square = np.ones_like(u), grid_faces(cells + 1, cells + 1)[:, ::-1]
    sides = [(one, u, v), (-one, v, u), (v, one, u), (u, -one, v), (u, v, one), (v, u, -one)]
    vertices = np.concatenate([np.stack(side, -1) for side in sides])
    faces = np.concatenate([square + i * len(u) for i in range(6)])
    # The six sides share their edges: weld them, or the ball would show seams.
    vertices, welded = np.unique(vertices.round(9), axis=0, return_inverse=True)
    vertices *= radius / np.linalg.norm(vertices, axis=1, keepdims=True)
    return vertices + np.asarray(centre, float), welded.reshape(-1)[faces]


def revolved(profile: Sequence[tuple[float, float]], segments: int = 48) -> Shape:
    """The surface that a ``profile`` of (radius, height) sweeps about the z axis, from bottom to top."""
    radius, height = np.array(profile, float).T[..., None]
    turn = np.linspace(0, 2 * np.pi, segments, endpoint=False)
    vertices = np.stack(np.broadcast_arrays(radius * np.cos(turn), radius * np.sin(turn), height), -1)
    return vertices.reshape(-1, 3), grid_faces(len(profile), segments, around=True)


def extruded(profile: Sequence[tuple[float, float]], width: float) -> Shape:
    """The sheet over a ``profile`` of (y, z), ``width`` wide along x."""
    y, z = np.array(profile, float).T
    x = np.array([[width / 2], [-width / 2]])
    vertices = np.stack(np.broadcast_arrays(x, y, z), -1).reshape(-1, 3)
    return vertices, grid_faces(2, len(y))


def backdrop(width: float = 60.0, depth: float = 9.0) -> Shape:
    """A photographer's sheet: a floor that rises behind the scene in one curve."""
    turn = np.linspace(0, np.pi / 2, 24)
    curve = np.stack([depth + 4 * np.sin(turn), 4 - 4 * np.cos(turn)], -1)
    return extruded(np.concatenate([[(-30.0, 0.0)], curve, [(depth + 4, 30.0)]]), width)


def joined(*parts: Shape) -> Shape:
    """Several shapes as one."""
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts[:-1])])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=True)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def corner_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, K, 3) unit normals of smooth faces at their corners, faces weighed by their angles there."""
    corners = vertices[faces]
    to_next = np.roll(corners, -1, axis=1) - corners
    to_next /= np.maximum(np.linalg.norm(to_next, axis=-1, keepdims=True), 1e-30)
    cosine = -(to_next * np.roll(to_next, 1, axis=1)).sum(axis=-1)
    angle = np.arccos(np.clip(cosine, -1, 1))
    diagonals = corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1]
    normal = np.cross(*diagonals)
    normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-30)
    total = np.zeros_like(vertices)
    np.add.at(total, faces, angle[..., None] * normal[:, None])
    total /= np.maximum(np.linalg.norm(total, axis=-1, keepdims=True), 1e-30)
    return total[faces]
