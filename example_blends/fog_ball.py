# SPDX-License-Identifier: GPL-3.0-or-later
"""A black ball of 101,568 triangles in a box of fog, lit by a point out of view: nothing but one shadow in fog."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from .model import Fog, Lamp, Model, Thing, View, diffuse
from .shapes import ball, block


def lit(kind: str, power: float, properties: Mapping[str, Any]) -> Model:
    """The scene under one light of this kind."""
    position, middle = (-2.3, 1.6, 4.4), (0.0, 0.0, 1.5)
    things = [
        Thing("Ball", ball(1.0, middle, cells=92), diffuse("Black", (0.0, 0.0, 0.0)), smooth=True),
        Thing("Bounds of the fog", block((-6, -4, -2.5), (6, 6, 6)), Fog("Fog", 0.12)),
    ]
    lamps = [Lamp("Light", kind, position, power, (1.0, 0.94, 0.86), middle, properties=properties)]
    return Model(View((0.3, -8.2, 1.2), (0.3, 0, 1.2), lens=52), things, lamps, size=(1280, 720))


def model() -> Model:
    return lit("POINT", 900, {"shadow_soft_size": 0.0})
