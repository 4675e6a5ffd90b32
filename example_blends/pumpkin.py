# SPDX-License-Identifier: GPL-3.0-or-later
"""PUMPKIN: a carved pumpkin in fog, a yellow light inside it and another, blue as the moon, above."""

from __future__ import annotations

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import Shape, block, grid_faces, revolved

ROWS, COLUMNS = 54, 154
RIBS = 11
WALL = 0.12
"""Thickness, as part of the radius."""
EYE = ((0.15, 0.13), (0.58, 0.17), (0.40, 0.52))
NOSE = ((-0.10, -0.08), (0.10, -0.08), (0.0, 0.11))
"""Corners: longitude from the middle of the face, latitude, in radians."""
TEETH = ((0.17, 1), (0.42, -1))
"""Longitude on either side, and whether one hangs (1) or stands."""


def shell(places: np.ndarray, part: float = 1.0) -> np.ndarray:
    """(N, 3) points of a ribbed, flat pumpkin at (N, 2) longitude and latitude; ``part`` shrinks it."""
    longitude, latitude = places.T
    ribs = 1 - 0.09 * (1 - np.abs(np.sin(RIBS / 2 * longitude)) ** 0.7) * np.cos(latitude) ** 0.5
    dent = 1 - 0.30 * np.exp(-(((np.pi / 2 - np.abs(latitude)) / 0.4) ** 2))
    around = part * ribs * np.cos(latitude)
    up = 0.82 * part * dent * np.sin(latitude)
    return np.stack([around * np.sin(longitude), -around * np.cos(longitude), up], -1)


def carving(longitude: np.ndarray, latitude: np.ndarray) -> np.ndarray:
    """Below 0 where eyes, nose and grin are cut out, about the distance to their edges."""
    side, bend = np.abs(longitude), 0.5 * longitude**2
    middle = bend - 0.38
    grin = np.abs(latitude - middle) - 0.19 + 0.5 * bend
    for place, sign in TEETH:
        tooth = np.minimum(0.065 - np.abs(side - place), sign * (latitude - middle))
        grin = np.maximum(grin, tooth)
    return np.minimum.reduce([_triangle(side, latitude, EYE), _triangle(longitude, latitude, NOSE), grin])


def _triangle(x: np.ndarray, y: np.ndarray, corners: tuple[tuple[float, float], ...]) -> np.ndarray:
    """Distance to the farthest edge's line, below 0 inside; corners are counterclockwise."""
    distances = []
    for (ax, ay), (bx, by) in zip(corners, corners[1:] + corners[:1], strict=True):
        distances.append(((by - ay) * (x - ax) - (bx - ax) * (y - ay)) / np.hypot(bx - ax, by - ay))
    return np.maximum.reduce(distances)


def carved() -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 2) longitude and latitude of what is left of the shell, (E, 2, 2) of the edges of the holes."""
    longitude, latitude = (
        np.linspace(-np.pi, np.pi, COLUMNS + 1),
        np.linspace(-np.pi / 2, np.pi / 2, ROWS + 1),
    )
    grid = np.stack(np.meshgrid(longitude, latitude), -1).reshape(-1, 2)
    squares = grid_faces(ROWS + 1, COLUMNS + 1)
    triangles = grid[np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])]
    left = carving(*np.moveaxis(triangles, -1, 0))
    count = (left > 0).sum(axis=1)
    parts, edges = [triangles[count == 3]], []
    for inside in (1, 2):
        # First the corner that is on a side of its own: the hole's edge cuts both edges that meet there.
        cut, value = triangles[count == inside], left[count == inside]
        alone = ((value > 0) == (inside == 1)).argmax(axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(cut, order[..., None], 1), 1, 0)
        fa, fb, fc = np.take_along_axis(value, order, 1).T[..., None]
        p, q = a + (b - a) * fa / (fa - fb), a + (c - a) * fa / (fa - fc)
        pieces = [(a, p, q)] if inside == 1 else [(p, b, c), (p, c, q)]
        parts += [np.stack(piece, 1) for piece in pieces]
        edges.append(np.stack((p, q) if inside == 1 else (q, p), 1))
    return np.concatenate(parts), np.concatenate(edges)


def welded(places: np.ndarray, part: float) -> Shape:
    """The shell over (F, K, 2) places, equal points made one vertex."""
    points = shell(places.reshape(-1, 2), part).round(7)
    vertices, index = np.unique(points, axis=0, return_inverse=True)
    faces = index.reshape(places.shape[:2])
    size = faces.shape[1]
    whole = np.all([faces[:, i] != faces[:, j] for i in range(size) for j in range(i)], axis=0)
    return vertices, faces[whole]


def stem() -> Shape:
    """Bent, and wider at its foot."""
    vertices, faces = revolved(
        [(0.0, -0.1), (0.2, -0.08), (0.11, 0.06), (0.085, 0.3), (0.1, 0.36), (0, 0.36)], 20
    )
    height = vertices[:, 2]
    return vertices + np.stack([0.9 * height**2, 0.3 * height**2, 0 * height], -1), faces


def model() -> Model:
    triangles, edges = carved()
    vertices, faces = welded(triangles, 1.0)
    lift = np.array([0, 0, -vertices[:, 2].min()])
    inner, inner_faces = welded(triangles, 1 - WALL)
    # From the outer end of each edge of a hole to the inner one.
    corners = np.concatenate(
        [shell(edges[:, (0, 1, 1, 0)[k]], (1, 1, 1 - WALL, 1 - WALL)[k]) for k in range(4)]
    )
    walls = np.arange(len(corners)).reshape(4, -1).T
    top = shell(np.array([[0, np.pi / 2]]))[0]
    stalk, stalk_faces = stem()
    floor = np.array([(-14, -10, 0), (14, -10, 0), (14, 14, 0), (-14, 14, 0)], float)
    flesh = diffuse("Flesh", (0.80, 0.52, 0.16))
    things = [
        Thing("Floor", (floor, np.array([(0, 1, 2, 3)])), diffuse("Planks", (0.17, 0.14, 0.12))),
        Thing("Skin", (vertices + lift, faces), diffuse("Skin", (0.78, 0.24, 0.03)), smooth=True),
        Thing("Inside", (inner + lift, inner_faces[:, ::-1]), flesh, smooth=True),
        Thing("Edges of the holes", (corners + lift, walls), flesh),
        Thing("Stem", (stalk + top + lift, stalk_faces), diffuse("Stem", (0.20, 0.22, 0.08)), smooth=True),
        Thing("Bounds of the fog", block((-7, -4.6, -0.1), (7, 6, 6)), Fog("Fog", 0.14)),
    ]
    point = {"shadow_soft_size": 0.0}
    lamps = [
        Lamp("Candle", "POINT", (0, 0.05, lift[2] - 0.1), 900, (1.0, 0.66, 0.16), properties=point),
        Lamp("Moon", "POINT", (-2.0, -1.7, 3.7), 640, (0.42, 0.60, 1.0), properties=point),
    ]
    return Model(View((1.0, -5.4, 1.25), (0.1, -0.4, 0.82), lens=42), things, lamps, size=(1280, 720))
