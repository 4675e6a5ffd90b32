# SPDX-License-Identifier: GPL-3.0-or-later
"""A black ball of 101,760 triangles in fog, lit by a point out of view: nothing but its shadow."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .model import Fog, Lamp, Lathe, Model, Thing, View, diffuse
from .shapes import block

RINGS, SEGMENTS = 160, 320


def lit(kind: str, power: float, properties: Mapping[str, Any]) -> Model:
    """The scene under one light of this kind."""
    position, middle = (-2.3, 1.6, 4.4), (0.0, 0.0, 1.5)
    turn = np.linspace(0, np.pi, RINGS + 1)
    circle = list(zip(np.sin(turn).round(12).tolist(), (-np.cos(turn)).tolist(), strict=True))
    things = [
        Lathe(circle, SEGMENTS, middle).thing("Ball", diffuse("Black", (0.0, 0.0, 0.0))),
        Thing("Bounds of the fog", block((-6, -4, -2.5), (6, 6, 6)), Fog("Fog", 0.12)),
    ]
    lamps = [Lamp("Light", kind, position, power, (1.0, 0.94, 0.86), middle, properties=properties)]
    return Model(View((0.3, -8.2, 1.2), (0.3, 0, 1.2), lens=52), things, lamps, size=(1280, 720))


def model() -> Model:
    return lit("POINT", 900, {"shadow_soft_size": 0.0})
