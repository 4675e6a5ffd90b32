# SPDX-License-Identifier: GPL-3.0-or-later
"""LIGHTHOUSE: fog at night, a beam and a round lamp in the lantern, orange and blue light on the shore.

All four lights are in the picture, three of them without any size: the thesis' open problem.
"""

from __future__ import annotations

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import Shape, ball, block, grid_faces, joined, revolved

FOOT, TOP = 1.1, 7.0
"""z of the tower's foot, and of the gallery."""
LANTERN = TOP + 0.62


def tower(low: float, high: float) -> Shape:
    """The part of it from one height to another, both of 0 to 1."""
    part = np.linspace(low, high, 6)
    return revolved([(1.0 - 0.42 * t + 0.12 * (1 - t) ** 4, FOOT + (TOP - FOOT) * t) for t in part], 48)


def rock(random: np.random.Generator, centre: np.ndarray, size: np.ndarray) -> Shape:
    """A ball with corners: cut by planes of random directions."""
    vertices, faces = ball(1.0, cells=5)
    normals = random.normal(size=(14, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    reach = np.min(random.uniform(0.62, 0.95, 14) / np.maximum(vertices @ normals.T, 1e-3), axis=1)
    return vertices * np.minimum(reach, 1)[:, None] * size + centre, faces


def shore() -> Shape:
    """Rocks below the tower, and out into the sea."""
    random = np.random.default_rng(12)
    rocks = [rock(random, np.array([0, 0.2, -0.1]), np.array([3.0, 2.6, 1.5]))]
    for _ in range(60):
        turn, far = random.uniform(0, 2 * np.pi), 1.6 + 3.4 * random.random() ** 1.5
        size = random.uniform(0.25, 0.85) * random.uniform(0.7, 1.3, 3) * (1.5 - 0.2 * far)
        place = far * np.array([1.25 * np.cos(turn), np.sin(turn), 0])
        rocks.append(rock(random, place + (0, 0, 0.25 * (3.6 - far) / 3), np.abs(size) + 0.12))
    return joined(*rocks)


def sea() -> Shape:
    """Long waves that run towards the shore."""
    x, y = np.meshgrid(np.linspace(-44, 44, 111), np.concatenate([np.linspace(-17, 12, 73), [30, 70]]))
    fade = np.clip((14 - y) / 4, 0, 1)
    z = 0.07 * np.sin(1.1 * y + 0.35 * x + np.sin(0.5 * x)) + 0.05 * np.sin(2.3 * y - 0.8 * x)
    return np.stack([x, y, z * fade - 0.05], -1).reshape(-1, 3), grid_faces(*x.shape)


def gallery() -> Shape:
    """Its floor and railing, and the lantern's bars."""
    floor = revolved([(0, TOP), (0.9, TOP), (0.96, TOP + 0.05), (0.96, TOP + 0.13), (0, TOP + 0.13)], 48)
    parts = [floor, revolved([(0.5, TOP + 0.13), (0.48, TOP + 0.3), (0, TOP + 0.3)], 32)]
    for z in (TOP + 0.28, TOP + 0.42):
        parts.append(revolved([(0.90, z), (0.93, z), (0.93, z + 0.025), (0.90, z + 0.025), (0.90, z)], 48))
    for count, radius, wide, low, high in ((24, 0.915, 0.012, 0.13, 0.44), (8, 0.45, 0.018, 0.3, 0.98)):
        for turn in 2 * np.pi * (np.arange(count) + 0.5) / count:
            x, y = radius * np.cos(turn), radius * np.sin(turn)
            parts.append(block((x - wide, y - wide, TOP + low), (x + wide, y + wide, TOP + high)))
    return joined(*parts)


def roof() -> Shape:
    z = TOP + 0.98
    curve = [(0, z), (0.56, z), (0.58, z + 0.05), (0.4, z + 0.3), (0.12, z + 0.5), (0.05, z + 0.62)]
    return revolved([*curve, (0.09, z + 0.68), (0.05, z + 0.75), (0.012, z + 0.78), (0.012, z + 1.2)], 40)


def model() -> Model:
    iron = diffuse("Iron", (0.06, 0.06, 0.07))
    things = [
        Thing("Sea", sea(), diffuse("Sea", (0.05, 0.10, 0.13)), smooth=True),
        Thing("Rocks", shore(), diffuse("Rock", (0.20, 0.18, 0.17))),
        Thing("Gallery", gallery(), iron),
        Thing("Roof", roof(), diffuse("Roof", (0.34, 0.05, 0.03)), smooth=True),
        Thing("Hut", block((-3.3, 0.1, 0.55), (-1.9, 1.5, 1.65)), diffuse("Wall", (0.62, 0.58, 0.52))),
    ]
    slope = [(-3.45, 1.62), (-2.6, 2.25), (-1.75, 1.62), (-1.75, 1.54), (-2.6, 2.15), (-3.45, 1.54)]
    gable = np.array([(x, y, z) for y in (0.0, 1.6) for x, z in slope])
    ends = [(0, 1, 4, 5), (1, 2, 3, 4), (11, 10, 7, 6), (10, 9, 8, 7)]
    sides = np.concatenate([grid_faces(2, 6, around=True), ends])
    things.append(Thing("Gable", (gable, sides), diffuse("Slate", (0.15, 0.14, 0.16))))
    bands = np.linspace(0, 1, 6)
    paints = diffuse("White paint", (0.78, 0.76, 0.72)), diffuse("Red paint", (0.55, 0.05, 0.03))
    for i, (low, high) in enumerate(zip(bands[:-1], bands[1:], strict=True)):
        things.append(Thing(f"Tower {i}", tower(low, high), paints[i % 2], smooth=True))
    point = {"shadow_soft_size": 0.0}
    lamps = [
        Lamp(
            "Beam", "SPOT", (0.5, -0.12, LANTERN), 26000, (1.0, 0.95, 0.82), (9.0, -2.6, LANTERN - 0.6),
            properties={"spot_size": np.radians(17), "spot_blend": 0.3, "shadow_soft_size": 0.0},
        ),
        Lamp(
            "Lantern", "POINT", (0, 0, LANTERN), 500, (1.0, 0.86, 0.58), seen=True,
            properties={"shadow_soft_size": 0.22, "use_soft_falloff": False},
        ),
        Lamp("Orange", "POINT", (-1.6, -0.35, 1.35), 190, (1.0, 0.42, 0.10), properties=point),
        Lamp("Blue", "POINT", (3.3, -1.5, 0.95), 190, (0.16, 0.36, 1.0), properties=point),
    ]  # fmt: skip
    view = View((2.6, -15.5, 2.3), (1.9, 0, 4.25), lens=34)
    return Model(view, things, lamps, size=(1280, 720), fog=Fog("Fog", 0.035))
