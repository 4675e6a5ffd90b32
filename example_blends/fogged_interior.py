# SPDX-License-Identifier: GPL-3.0-or-later
"""A nave in the morning: the sun's shafts fall through barred windows onto the pews."""

from __future__ import annotations

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import Shape, ball, block, grid_faces, joined, revolved

WIDTH, LENGTH, HEIGHT = 6.4, 14.0, 6.2
BAYS = 5
SILL, SPRING, HALF = 1.6, 4.0, 0.58
"""Of each window: z of its sill and of where its arch begins, and half its width."""
THICK = 0.35


def windowed_wall(x: float) -> Shape:
    """A wall of `LENGTH` along y, one arched window a bay."""
    bay = LENGTH / BAYS
    turn = np.linspace(0, np.pi, 17)
    arch = np.stack([-HALF * np.cos(turn), SPRING + HALF * np.sin(turn)], -1)
    parts = []
    for middle in (np.arange(BAYS) + 0.5) * bay:
        low, high = middle - bay / 2, middle + bay / 2
        parts += [
            block((x - THICK, low, 0), (x, high, SILL)),
            block((x - THICK, low, SILL), (x, middle - HALF, HEIGHT)),
            block((x - THICK, middle + HALF, SILL), (x, high, HEIGHT)),
        ]
        # Above the arch: a strip of squares between it and the vault, inside, outside and below.
        ring = np.concatenate([arch, np.stack([arch[:, 0], np.full(17, HEIGHT)], -1)])
        sides = np.concatenate([np.insert(ring, 0, side, axis=1) for side in (x - THICK, x)])
        faces = grid_faces(2, 17)
        under = np.stack([np.arange(16), np.arange(1, 17), np.arange(35, 51), np.arange(34, 50)], -1)
        parts.append((sides + (0, middle, 0), np.concatenate([faces, faces[:, ::-1] + 34, under])))
        for y in (-HALF / 3, HALF / 3):
            top = SPRING + np.sqrt(HALF**2 - y**2)
            parts.append(block((x - 0.2, middle + y - 0.02, SILL), (x - 0.16, middle + y + 0.02, top)))
        for z in np.arange(SILL + 0.46, SPRING + 0.4, 0.46):
            parts.append(block((x - 0.2, middle - HALF, z - 0.018), (x - 0.16, middle + HALF, z + 0.018)))
    return joined(*parts)


def column() -> Shape:
    foot = [(0.42, 0), (0.42, 0.18), (0.34, 0.24), (0.36, 0.34), (0.27, 0.42)]
    head = [(0.25, 4.1), (0.30, 4.16), (0.27, 4.24), (0.42, 4.5), (0.42, 4.66), (0.3, 4.66), (0.3, HEIGHT)]
    return revolved([*foot, *head], 40)


def pew() -> Shape:
    """About the origin, faced to +y."""
    seat = [block((-0.95, -0.2, 0.4), (0.95, 0.2, 0.45)), block((-0.95, -0.24, 0.4), (0.95, -0.2, 0.95))]
    return joined(*seat, *(block((x - 0.03, -0.26, 0), (x + 0.03, 0.24, 0.62)) for x in (-0.95, 0.95)))


def model() -> Model:
    half, bay = WIDTH / 2, LENGTH / BAYS
    stone, wood = diffuse("Stone", (0.62, 0.57, 0.50)), diffuse("Oak", (0.26, 0.15, 0.08))
    tiles = ([], [])
    for i in range(14):
        for j in range(29):
            low = np.array([-half + WIDTH * i / 14, 0.5 * (j - 1), -0.1])
            tiles[(i + j) % 2].append(block(low, low + (WIDTH / 14, 0.5, 0.1)))
    vault = np.linspace(0, np.pi, 25)
    curve = np.stack([half * np.cos(vault), HEIGHT - 0.01 + 0.5 * half * np.sin(vault)], -1)
    ceiling = np.array([(x, y, z) for y in (-1.0, LENGTH) for x, z in curve])
    shell, faces = column()
    columns = joined(*((shell + (x, y * bay, 0), faces) for x in (-half, half) for y in range(1, BAYS)))
    seats, seat_faces = pew()
    pews = joined(
        *((seats + (x, y, 0), seat_faces) for x in (-1.45, 1.45) for y in np.arange(3.0, 9.5, 1.05))
    )
    altar = joined(block((-0.9, 12.1, 0), (0.9, 12.9, 0.95)), block((-1.5, 11.6, 0), (1.5, 13.4, 0.16)))
    walls = joined(
        block((-half, LENGTH, 0), (half, LENGTH + 0.3, 9)),
        block((-half, -1.3, 0), (half, -1, 9)),
        block((-half - THICK, -1, 0), (-half, 0, 9)),
        block((half, -1, 0), (half + THICK, 0, 9)),
    )
    # Ends within the walls: no two faces in one place.
    bounds = block((-half - 0.1, -1.1, -0.05), (half + 0.1, LENGTH + 0.1, 8.2))
    gold = diffuse("Gold", (0.80, 0.56, 0.18))
    things = [
        Thing("Tiles", joined(*tiles[0]), diffuse("Pale tile", (0.50, 0.46, 0.40))),
        Thing("Dark tiles", joined(*tiles[1]), diffuse("Dark tile", (0.26, 0.23, 0.21))),
        Thing("Windows", joined(windowed_wall(-half), windowed_wall(half + THICK)), stone),
        Thing("Vault", (ceiling, grid_faces(2, 25)), diffuse("Plaster", (0.66, 0.62, 0.56)), smooth=True),
        Thing("Walls", walls, stone),
        Thing("Columns", columns, stone, smooth=True),
        Thing("Pews", pews, wood),
        Thing("Altar", altar, diffuse("Marble", (0.74, 0.72, 0.68))),
        Thing("Globe", ball(0.34, (0, 12.5, 1.3), cells=14), gold, smooth=True),
        Thing("Bounds of the fog", bounds, Fog("Fog", 0.06)),
    ]
    sun = Lamp(
        "Sun", "SUN", (-12, 9.4, 9.4), 40, (1.0, 0.84, 0.62), (0, 7.2, 1.2), properties={"angle": 0.0092}
    )
    view = View((2.7, -0.7, 2.3), (-1.5, 7.0, 2.2), lens=20)
    return Model(view, things, [sun], world=(0.55, 0.72, 1.0), size=(1280, 720))
