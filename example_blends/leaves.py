# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp in fog behind a tree of 5,000 leaves and a fence: shadows of thin things, by the thousand."""

from __future__ import annotations

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import Shape, block, joined, revolved

LEAVES = 5000
CROWN = np.array([-0.6, 0.6, 3.1])


def bough(start: np.ndarray, end: np.ndarray, thick: float, thin: float) -> Shape:
    """A tapered stick."""
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, (0.3, 1.0, 0.2))
    side /= np.linalg.norm(side)
    length = np.linalg.norm(end - start)
    vertices, faces = revolved([(thick, 0), (thin, length), (0, length)], 10)
    return vertices @ np.stack([side, np.cross(axis, side), axis]) + start, faces


def tree(random: np.random.Generator) -> tuple[Shape, np.ndarray]:
    """Trunk and boughs, and (B, 3) the ends of the boughs, where leaves grow."""
    fork = np.array([CROWN[0] + 0.1, CROWN[1], 1.7])
    boughs, ends = [bough(np.array([*CROWN[:2], 0.0]), fork, 0.17, 0.11)], []
    for turn in 2 * np.pi * np.arange(9) / 9 + random.uniform(0, 0.5, 9):
        far = random.uniform(0.55, 1.0)
        tip = CROWN + far * np.array([1.15 * np.cos(turn), 0.9 * np.sin(turn), random.uniform(-0.45, 0.9)])
        boughs.append(bough(fork, tip, 0.06, 0.025))
        for _ in range(4):
            twig = tip + random.normal(scale=(0.42, 0.36, 0.34))
            boughs.append(bough(fork + (tip - fork) * random.uniform(0.6, 0.95), twig, 0.022, 0.01))
            ends.append(twig)
        ends.append(tip)
    return joined(*boughs), np.array(ends)


def foliage(random: np.random.Generator, ends: np.ndarray) -> Shape:
    """Kites of four corners in clouds about the ends."""
    centre = ends[random.integers(0, len(ends), LEAVES)] + random.normal(scale=0.15, size=(LEAVES, 3))
    along, across = random.normal(size=(2, LEAVES, 3))
    along[:, 2] -= 0.6  # hanging
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across -= along * (along * across).sum(axis=1, keepdims=True)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    size = random.uniform(0.07, 0.12, (LEAVES, 1))
    widest, half = centre + 0.45 * size * along, 0.32 * size * across
    corners = np.stack([centre, widest + half, centre + 1.2 * size * along, widest - half], 1)
    return corners.reshape(-1, 3), np.arange(4 * LEAVES).reshape(-1, 4)


def fence(random: np.random.Generator) -> Shape:
    """Pickets, not quite upright, on two rails."""
    parts = [block((-7, -0.62, z), (7, -0.58, z + 0.07)) for z in (0.25, 0.72)]
    for x in np.arange(-7, 7, 0.2):
        vertices, faces = block((-0.055, -0.58, 0.05), (0.055, -0.555, 1.0 + random.uniform(-0.03, 0.03)))
        lean = random.normal(scale=0.02)
        parts.append((vertices + np.stack([x + lean * vertices[:, 2], *np.zeros((2, 8))], -1), faces))
    return joined(*parts)


def model() -> Model:
    random = np.random.default_rng(5)
    wood, ends = tree(random)
    ground = np.array([(-14, -12, 0), (14, -12, 0), (14, 14, 0), (-14, 14, 0)], float)
    things = [
        Thing("Ground", (ground, np.array([(0, 1, 2, 3)])), diffuse("Ground", (0.16, 0.17, 0.11))),
        Thing("Tree", wood, diffuse("Bark", (0.16, 0.11, 0.08)), smooth=True),
        Thing("Leaves", foliage(random, ends), diffuse("Leaf", (0.20, 0.36, 0.08))),
        Thing("Fence", fence(random), diffuse("Paint", (0.55, 0.53, 0.48))),
        Thing("Bounds of the fog", block((-8, -7, -0.1), (8, 7, 7)), Fog("Fog", 0.16)),
    ]
    point = {"shadow_soft_size": 0.0}
    lamps = [
        Lamp("Lamp", "POINT", (-0.5, 1.9, 3.2), 1300, (1.0, 0.80, 0.52), properties=point),
        Lamp("Lantern", "POINT", (3.7, 1.4, 0.62), 120, (0.45, 0.62, 1.0), properties=point),
    ]
    return Model(View((0.3, -7.6, 1.6), (0.1, 0, 2.35), lens=34), things, lamps, size=(1280, 720))
