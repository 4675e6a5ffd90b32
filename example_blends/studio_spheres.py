# SPDX-License-Identifier: GPL-3.0-or-later
"""Principled balls from rough plaster to coated metal, in a studio with three soft boxes."""

import numpy as np

from .model import Lamp, Model, Surface, Thing, View, diffuse
from .shapes import backdrop, ball

ROWS = (
    ("Plastic", (0.72, 0.07, 0.05), {"metallic": 0.0}),
    ("Gold", (0.95, 0.62, 0.24), {"metallic": 1.0}),
    ("Lacquer", (0.03, 0.16, 0.36), {"metallic": 0.6, "coat_weight": 1.0, "coat_roughness": 0.04}),
)
"""Name, base colour and other inputs of each row, from the front."""
ROUGHNESS = (0.08, 0.18, 0.32, 0.5, 0.8)
"""Of each column."""
RADIUS, APART = 0.46, 1.12


def model() -> Model:
    things = [Thing("Backdrop", backdrop(depth=7.0), diffuse("Paper", (0.42, 0.42, 0.44)), smooth=True)]
    for row, (name, colour, inputs) in enumerate(ROWS):
        for column, roughness in enumerate(ROUGHNESS):
            surface = Surface(
                f"{name} {roughness}", "Principled", {"base_color": colour, "roughness": roughness, **inputs}
            )
            x, y = (column - 2 + 0.2 * (row - 1)) * APART, (row - 1) * 1.15
            shape = ball(RADIUS, (x, y, RADIUS), cells=24)
            things.append(Thing(surface.name, shape, surface, smooth=True))
    aim = np.array([0.0, 0.0, 0.4])
    lamps = [
        Lamp("Key", "AREA", (-4.2, -3.4, 4.6), 260, (1.0, 0.95, 0.88), aim,
             properties={"shape": "SQUARE", "size": 2.4}),
        Lamp("Rim", "AREA", (4.6, 2.8, 3.4), 190, (0.72, 0.85, 1.0), aim,
             properties={"shape": "RECTANGLE", "size": 0.6, "size_y": 3.0}),
        Lamp("Top", "AREA", (0.6, -0.6, 5.4), 90, (1.0, 1.0, 1.0), aim,
             properties={"shape": "DISK", "size": 1.2}),
    ]  # fmt: skip
    return Model(View((0.0, -8.6, 4.1), (0.0, 0.05, 0.3), lens=44), things, lamps, size=(1280, 720))
