# SPDX-License-Identifier: GPL-3.0-or-later
"""Sixty point lights of many radii behind a screen of slats: every one draws its own stripes."""

import colorsys

import numpy as np

from .model import Lamp, Model, Thing, View, diffuse
from .shapes import ball, block, joined, revolved

LIGHTS, SLATS = 60, 22
SCREEN = -3.0
"""x of the slats; the lights are to the left."""


def model() -> Model:
    random = np.random.default_rng(11)
    floor = np.array([(-12, -14, 0), (16, -14, 0), (16, 4, 0), (-12, 4, 0)], float)
    wall = np.array([(-12, 4, 0), (16, 4, 0), (16, 4, 9), (-12, 4, 9)], float)
    quad = np.array([(0, 1, 2, 3)])
    x, places = SCREEN, np.linspace(-5.2, 3.8, SLATS)
    slats = joined(
        *(block((x - 0.04, y - 0.1, 0), (x + 0.04, y + 0.1, 3.8)) for y in places),
        block((x - 0.07, -5.4, 3.8), (x + 0.07, 4, 4.0)),
        block((x - 0.04, -14, 0), (x + 0.04, -5.3, 4.0)),
    )
    vase = [(0, 0), (0.2, 0), (0.34, 0.14), (0.42, 0.4), (0.38, 0.66), (0.2, 0.92), (0.14, 1.1), (0.2, 1.22)]
    things = [
        Thing("Floor", (floor, quad), diffuse("Boards", (0.62, 0.55, 0.47))),
        Thing("Wall", (wall, quad), diffuse("Plaster", (0.70, 0.69, 0.67))),
        Thing("Slats", slats, diffuse("Wood", (0.42, 0.25, 0.13))),
        Thing("Plinth", block((0.2, 1.3, 0), (1.5, 2.6, 0.8)), diffuse("Stone", (0.66, 0.64, 0.60))),
    ]
    vertices, faces = revolved(vase, 64)
    clay = diffuse("Clay", (0.62, 0.30, 0.18))
    things.append(Thing("Vase", (1.15 * vertices + (0.85, 1.95, 0.8), faces), clay, smooth=True))
    for i, (px, py, radius, colour) in enumerate(
        [
            (-1.3, 0.4, 0.55, (0.82, 0.80, 0.76)),
            (2.6, 0.3, 0.70, (0.30, 0.46, 0.52)),
            (0.5, -0.9, 0.36, (0.84, 0.62, 0.26)),
        ]
    ):
        shape = ball(radius, (px, py, radius), cells=20)
        things.append(Thing(f"Ball {i}", shape, diffuse(f"Ball {i}", colour), smooth=True))
    # In a jittered grid along the screen; from a spark to a lampion in size, few of them strong.
    lamps = []
    radii = random.permutation(np.geomspace(0.004, 0.42, LIGHTS))
    powers = random.permutation(np.geomspace(14, 150, LIGHTS))
    for i, (radius, power) in enumerate(zip(radii, powers, strict=True)):
        row, column = divmod(i, 12)
        y = -4.4 + 0.68 * (column + random.uniform(0.1, 0.9))
        px, z = SCREEN - 1.5 - 0.9 * (row + random.uniform(-0.3, 0.3)), random.uniform(0.5 + radius, 3.3)
        hue = 0.04 + 0.08 * random.random() + 0.53 * (random.random() < 0.2)
        colour = colorsys.hsv_to_rgb(hue, 0.6, 1.0)
        properties = {"shadow_soft_size": radius}
        lamps.append(Lamp(f"Light {i}", "POINT", (px, y, z), power, colour, properties=properties))
    return Model(View((3.2, -9.0, 3.9), (0.75, 1.1, 0.95), lens=46), things, lamps, size=(1280, 720))
