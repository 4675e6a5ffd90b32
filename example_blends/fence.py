# SPDX-License-Identifier: GPL-3.0-or-later
"""A lamp in fog behind a fence of 60 slats: shafts and shadows of what is thin."""

from __future__ import annotations

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import ball, block, joined

SLATS = 60
STEP, WIDTH, THICK, HEIGHT = 0.15, 0.07, 0.02, 1.7
"""From slat to slat, and of each, in metres."""


def model() -> Model:
    end = STEP * SLATS / 2
    places = STEP * (np.arange(SLATS) + 0.5) - end
    slats = [block((x - WIDTH / 2, 0, 0.06), (x + WIDTH / 2, THICK, HEIGHT)) for x in places]
    rails = [block((-end, THICK, z), (end, 2 * THICK, z + 0.08)) for z in (0.3, 1.35)]
    ground = np.array([(-14, -12, 0), (14, -12, 0), (14, 14, 0), (-14, 14, 0)], float)
    things = [
        Thing("Ground", (ground, np.array([(0, 1, 2, 3)])), diffuse("Ground", (0.34, 0.31, 0.26))),
        Thing("Fence", joined(*slats, *rails), diffuse("Paint", (0.55, 0.53, 0.48))),
        Thing(
            "Stone", ball(0.45, (1.3, -1.9, 0.36), cells=12), diffuse("Stone", (0.5, 0.5, 0.52)), smooth=True
        ),
        Thing("Bounds of the fog", block((-8, -7, -0.1), (8, 7, 7)), Fog("Fog", 0.05)),
    ]
    disk = {"shape": "DISK", "size": 0.25}
    lamp = Lamp("Lamp", "AREA", (-0.6, 3.4, 4.3), 1200, (1.0, 0.82, 0.58), (-0.1, -1.0, 0.2), properties=disk)
    return Model(View((0.4, -6.4, 2.0), (0.1, 0.2, 1.0), lens=32), things, [lamp], size=(1280, 720))
