# SPDX-License-Identifier: GPL-3.0-or-later
"""OCCLUDER: a cone of light falls through fog onto a white sphere, which cuts its shadow out of it."""

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import ball, block, revolved


def model() -> Model:
    floor = np.array([(-14, -10, 0), (14, -10, 0), (14, 14, 0), (-14, 14, 0)], float)
    plinth = [(0.62, 0), (0.62, 0.06), (0.5, 0.1), (0.46, 0.62), (0.54, 0.68), (0.54, 0.74), (0, 0.74)]
    things = [
        Thing("Floor", (floor, np.array([(0, 1, 2, 3)])), diffuse("Floor", (0.20, 0.21, 0.23))),
        Thing("Plinth", revolved(plinth, 64), diffuse("Basalt", (0.16, 0.16, 0.18))),
        Thing("Sphere", ball(0.8, (0, 0, 1.54), cells=24), diffuse("White", (0.85, 0.85, 0.84)), smooth=True),
        Thing("Bounds of the fog", block((-8, -5.5, -0.1), (8, 6, 6.5)), Fog("Fog", 0.11)),
    ]
    spot = {"spot_size": np.radians(38), "spot_blend": 0.12, "shadow_soft_size": 0.0}
    place, colour, target = (-3.7, 0.9, 5.3), (1.0, 0.93, 0.82), (0.25, -0.05, 1.05)
    lamps = [Lamp("Spot", "SPOT", place, 5200, colour, target, properties=spot)]
    return Model(View((0.6, -8.4, 1.9), (0.3, 0, 1.75), lens=42), things, lamps, size=(1280, 720))
