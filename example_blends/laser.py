# SPDX-License-Identifier: GPL-3.0-or-later
"""LASER: a magenta beam through rings and past columns, in a fog that its own scattered light fills."""

from __future__ import annotations

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import Shape, ball, block, grid_faces, joined, revolved

HEIGHT = 1.25
START, END = np.array([-4.3, 1.1, HEIGHT]), np.array([3.6, -0.3, HEIGHT])


def turned(shape: Shape, centre: np.ndarray) -> Shape:
    """A shape about the z axis, about the beam."""
    axis = (END - START) / np.linalg.norm(END - START)
    side = np.cross((0, 0, 1), axis)
    return shape[0] @ np.stack([side, (0, 0, 1), axis]) + centre, shape[1]


def torus(radius: float, thickness: float) -> Shape:
    turn, round_ = (np.linspace(0, 2 * np.pi, n, endpoint=False) for n in (64, 20))
    out = radius + thickness * np.cos(round_)
    across, up = np.cos(turn)[:, None], np.sin(turn)[:, None]
    vertices = np.stack(np.broadcast_arrays(out * across, out * up, thickness * np.sin(round_)), -1)
    return vertices.reshape(-1, 3), grid_faces(65, 20, around=True) % (64 * 20)


def model() -> Model:
    floor = np.array([(-12, -9, 0), (12, -9, 0), (12, 12, 0), (-12, 12, 0)], float)
    wall = np.array([(-12, 5, 0), (12, 5, 0), (12, 5, 9), (-12, 5, 9)], float)
    quad = np.array([(0, 1, 2, 3)])
    steel, dark = diffuse("Steel", (0.55, 0.56, 0.60)), diffuse("Iron", (0.12, 0.12, 0.14))
    white = diffuse("White", (0.82, 0.82, 0.82))
    tube = [(0, -0.9), (0.2, -0.9), (0.22, -0.86), (0.22, -0.2), (0.13, -0.1), (0.13, -0.02), (0.05, -0.02)]
    stands = [block((x - 0.06, y - 0.06, 0), (x + 0.06, y + 0.06, HEIGHT - drop)) for x, y, drop in _feet()]
    things = [
        Thing("Floor", (floor, quad), diffuse("Floor", (0.34, 0.34, 0.38))),
        Thing("Wall", (wall, quad), diffuse("Wall", (0.30, 0.30, 0.36))),
        Thing("Device", turned(revolved(tube, 40), START), dark, smooth=True),
        Thing("Stands", joined(*stands), dark),
        Thing("Ball", ball(0.55, END + (0.53, -0.1, 0), cells=20), white, smooth=True),
    ]
    for i, part in enumerate((0.3, 0.52, 0.74)):
        centre = START + part * (END - START)
        things.append(Thing(f"Ring {i}", turned(torus(0.52 - 0.07 * i, 0.06), centre), steel, smooth=True))
    for i, (x, y) in enumerate(((-2.4, -0.7), (0.1, 2.3), (1.5, -1.5), (-3.4, 2.8), (3.1, 2.2))):
        shaft = [(0.3, 0), (0.3, 0.12), (0.2, 0.16), (0.17, 2.5), (0.26, 2.56), (0.26, 2.7), (0, 2.7)]
        column = revolved(shaft, 40)
        things.append(Thing(f"Column {i}", (column[0] + (x, y, 0), column[1]), steel, smooth=True))
    things.append(Thing("Bounds of the fog", block((-7, -6, -0.1), (7, 5.1, 5)), Fog("Fog", 0.25)))
    beam = Lamp(
        "Laser", "LASER", START, 600, (1.0, 0.06, 0.75), END, properties={"radius": 0.012, "length": 0.0}
    )
    return Model(View((0.3, -7.2, 2.5), (0.0, 0, 1.15), lens=34), things, [beam], size=(1280, 720))


def _feet() -> list[tuple[float, float, float]]:
    """x, y, and how far below the beam each stand ends."""
    places = [(START - 0.5 * (END - START) / 8, 0.21), (END + (0.53, -0.1, 0), 0.5)]
    places += [(START + part * (END - START), 0.5 - 0.07 * i) for i, part in enumerate((0.3, 0.52, 0.74))]
    return [(x, y, drop) for (x, y, _), drop in places]
