# SPDX-License-Identifier: GPL-3.0-or-later
"""A stage before the concert: twelve coloured spots on two trusses, their cones crossing in the haze."""

from __future__ import annotations

import colorsys

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import Shape, block, grid_faces, joined, revolved

SPOTS = 12
DRUMS = (
    (0, 2.2, 0.5, 0.42, 0.75), (-0.75, 2.0, 0.5, 0.3, 0.55), (0.75, 2.0, 0.5, 0.3, 0.55),
    (-0.3, 1.75, 1.25, 0.2, 0.2), (0.3, 1.75, 1.25, 0.2, 0.2),
)  # fmt: skip
"""x, y, z, radius and height of each."""
HUES = (0.93, 0.08, 0.55, 0.78, 0.40, 0.62)


def truss(y: float, z: float) -> Shape:
    """Two tubes and what holds them together."""
    tubes = [block((-5.6, y - 0.03, z + up), (5.6, y + 0.03, z + up + 0.06)) for up in (0.0, 0.34)]
    struts = [
        block((x - 0.02, y - 0.02, z), (x + 0.02, y + 0.02, z + 0.4)) for x in np.linspace(-5.6, 5.6, 29)
    ]
    return joined(*tubes, *struts)


def lantern(position: np.ndarray, target: np.ndarray) -> Shape:
    """A can behind the light, open to its front."""
    axis = (target - position) / np.linalg.norm(target - position)
    side = np.cross(axis, (0, 1, 0))
    side /= np.linalg.norm(side)
    can = [(0, -0.42), (0.12, -0.4), (0.15, -0.3), (0.15, -0.02), (0.13, -0.02), (0.1, -0.06), (0, -0.06)]
    vertices, faces = revolved(can, 24)
    return vertices @ np.stack([side, np.cross(axis, side), axis]) + position, faces


def steps() -> Shape:
    """The stage itself, of five of them."""
    edges = [(0.15 * i, 0.4 * i, 0.1 * i) for i in range(5)]
    return joined(*(block((x - 6, y - 2, z), (6 - x, 4, z + 0.1)) for x, y, z in edges))


def curtain() -> Shape:
    """In folds, behind the stage."""
    x = np.linspace(-9, 9, 361)
    y = 4.2 + 0.12 * np.sin(5 * x)
    vertices = np.stack([np.stack([x, y, np.full(361, z)], -1) for z in (7.5, 0.0)])
    return vertices.reshape(-1, 3), grid_faces(2, 361)


def speaker(x: float) -> Shape:
    return joined(*(block((x - 0.5, 1.5, z), (x + 0.5, 2.3, z + 0.72)) for z in (0.5, 1.24, 1.98)))


def drums() -> Shape:
    parts = []
    for x, y, z, radius, height in DRUMS:
        vertices, faces = revolved([(0, 0), (radius, 0), (radius, height), (0, height)], 32)
        parts.append((vertices + (x, y, z), faces))
    return joined(*parts)


def microphone() -> Shape:
    foot, head = [(0, 0.5), (0.2, 0.5), (0.2, 0.53), (0.02, 0.56)], [(0.05, 1.98), (0.055, 2.1), (0, 2.14)]
    vertices, faces = revolved([*foot, (0.015, 1.95), *head], 24)
    return vertices + (0, 0.2, 0), faces


def model() -> Model:
    floor = np.array([(-14, -14, 0), (14, -14, 0), (14, 9, 0), (-14, 9, 0)], float)
    black = diffuse("Black", (0.06, 0.06, 0.06))
    things = [
        Thing("Hall", (floor, np.array([(0, 1, 2, 3)])), diffuse("Hall", (0.16, 0.15, 0.16))),
        Thing("Steps", steps(), diffuse("Boards", (0.40, 0.36, 0.33))),
        Thing("Curtain", curtain(), diffuse("Velvet", (0.30, 0.10, 0.12)), smooth=True),
        Thing("Speakers", joined(speaker(-4.3), speaker(4.3)), black),
        Thing("Microphone", microphone(), diffuse("Chrome", (0.6, 0.6, 0.62)), smooth=True),
        Thing("Drums", drums(), diffuse("Drums", (0.72, 0.70, 0.66))),
    ]
    iron = diffuse("Truss", (0.20, 0.20, 0.21))
    things.append(Thing("Trusses", joined(truss(-0.6, 5.2), truss(3.2, 5.6)), iron))
    lamps, cans = [], []
    for i in range(SPOTS):
        row, column = divmod(i, SPOTS // 2)
        x = (column - 2.5) * (1.75 if row else 1.6)
        position = np.array([x, (3.2 if row else -0.6), (5.2 if row else 4.85)])
        # The front row is aimed at the drums and the curtain, the row behind fans out towards the hall.
        if row:
            target = np.array([-0.55 * x, -3.2, 0.3])
        else:
            target = np.array([0.25 * x, 1.6, 0.5] if i % 2 else [-0.7 * x, 4.2, 1.6])
        properties = {
            "spot_size": np.radians(13 if row else 19),
            "spot_blend": 0.2 if row else 0.35,
            "shadow_soft_size": 0.0,
        }
        colour = colorsys.hsv_to_rgb(HUES[(column + 3 * row) % 6], 0.82, 1.0)
        power = 6500 if row else 4500
        lamps.append(Lamp(f"Spot {i}", "SPOT", position, power, colour, target, properties=properties))
        cans.append(lantern(position, target))
    things.append(Thing("Lanterns", joined(*cans), black))
    things.append(Thing("Bounds of the haze", block((-8, -9, -0.1), (8, 4.5, 7)), Fog("Haze", 0.09)))
    return Model(View((0, -12.0, 2.2), (0, 0, 2.95), lens=42), things, lamps, size=(1280, 720))
