# SPDX-License-Identifier: GPL-3.0-or-later
"""Two coloured spots in fog over a floor with a ball and a box."""

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import ball, block


def model() -> Model:
    floor = np.array([(-14, -10, 0), (14, -10, 0), (14, 14, 0), (-14, 14, 0)], float)
    things = [
        Thing("Floor", (floor, np.array([(0, 1, 2, 3)])), diffuse("Floor", (0.4, 0.4, 0.4))),
        Thing("Sphere", ball(0.9, (-0.6, 0, 0.9), cells=24), diffuse("White", (0.8, 0.8, 0.8)), smooth=True),
        Thing("Box", block((0.9, -0.3, 0), (2.0, 0.8, 1.6)), diffuse("Box", (0.6, 0.6, 0.6))),
        Thing("Bounds of the fog", block((-8, -5.5, -0.1), (8, 6, 6.5)), Fog("Fog", 0.1)),
    ]
    spot = {"spot_size": np.radians(40), "spot_blend": 0.15, "shadow_soft_size": 0.0}
    lamps = [
        Lamp("Red", "SPOT", (-3.7, 0.4, 5.0), 4000, (1.0, 0.25, 0.15), (0.1, 0, 0.6), properties=spot),
        Lamp("Blue", "SPOT", (3.9, -0.6, 4.6), 4000, (0.2, 0.35, 1.0), (-0.2, 0, 0.6), properties=spot),
    ]
    return Model(View((0.4, -8.4, 2.4), (0.2, 0, 1.5), lens=40), things, lamps, size=(1280, 720))
