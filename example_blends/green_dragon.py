# SPDX-License-Identifier: GPL-3.0-or-later
"""GREENDRAGON: a green beam behind the dragon, whose scattered light the fog carries around it.

The mesh is the one of `dragon`, and no part of this project.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .dragon import standing
from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import block


def model(assets: Path) -> Model:
    """assets : the folder that has `dragon.MESH`."""
    floor = np.array([(-14, -10, 0), (14, -10, 0), (14, 14, 0), (-14, 14, 0)], float)
    things = [
        Thing("Floor", (floor, np.array([(0, 1, 2, 3)])), diffuse("Floor", (0.34, 0.35, 0.34))),
        Thing("Dragon", standing(assets), diffuse("Jade", (0.70, 0.78, 0.70)), smooth=True),
        Thing("Bounds of the fog", block((-7, -6, -0.1), (7, 6, 6)), Fog("Fog", 0.2)),
    ]
    beam = {"radius": 0.015, "length": 0.0}
    green, start, end = (0.05, 1.0, 0.18), (-5.5, 1.4, 1.0), (5.5, 0.9, 2.3)
    lamps = [Lamp("Laser", "LASER", start, 700, green, end, properties=beam)]
    return Model(View((0.2, -8.6, 2.4), (0.0, 0.3, 1.45), lens=46), things, lamps, size=(1280, 720))
