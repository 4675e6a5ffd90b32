# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog for `engine_core` alone: lights in the picture, and what grows in number."""

from __future__ import annotations

import numpy as np

from engine_core import Scene
from example_blends.model import Fog, Lamp, Model, Thing, View, diffuse
from example_blends.shapes import ball, block, revolved

from . import core

BARE = {"shadow_soft_size": 0.0}


def lights_in_frame(size: int) -> Scene:
    """A spot and three points in the picture, in fog of extinction 0.08 among black things."""
    black = diffuse("Black", (0.0, 0.0, 0.0))
    tower = revolved([(0.8, -2.5), (0.5, 2.2), (0.0, 2.2)], 32)
    things = [
        Thing("Ground", block((-20, -20, -3), (20, 20, -2.5)), black),
        Thing("Tower", tower, black),
        Thing("Rock", ball(0.8, (-2.2, -0.6, -2.2), cells=10), black),
        Thing("Post", block((1.6, -1.0, -2.5), (1.8, -0.8, 0.6)), black),
    ]
    beam = BARE | {"spot_size": np.radians(25), "spot_blend": 0.3}
    lamps = [
        Lamp("Beam", "SPOT", (0.3, -0.7, 2.5), 2000, (1, 0.95, 0.8), (6, -2.5, 2.0), properties=beam),
        Lamp("Lantern", "POINT", (-0.3, -0.8, 2.6), 60, (1, 0.9, 0.6), properties=BARE),
        Lamp("Orange", "POINT", (-1.6, -1.2, -1.2), 30, (1, 0.4, 0.1), properties=BARE),
        Lamp("Blue", "POINT", (2.4, -1.6, -1.0), 30, (0.2, 0.4, 1), properties=BARE),
    ]
    view = View((0.5, -12, 0.5), (0.5, 0, 0.3), lens=50)
    return core.scene(Model(view, things, lamps, fog=Fog("Fog", 0.08)), size, size)


def hall(pixels: int, lights: int, lasers: int, depth: float) -> Scene:
    """A box of fog about balls on a floor, under points and spots in turn of one power in all, some in view.

    depth : optical depth of the box from front to back.
    """
    random = np.random.default_rng(8)
    things = [Thing("Floor", block((-6, -6, -0.2), (6, 6, 0)), diffuse("Floor", (0.5, 0.5, 0.5)))]
    for i in range(6):
        place = (random.uniform(-3, 3), random.uniform(-3, 3), random.uniform(0.5, 2.5))
        things.append(Thing(f"Ball {i}", ball(0.5, place, cells=8), diffuse(f"Ball {i}", (0.6, 0.4, 0.3))))
    things.append(Thing("Fog", block((-5, -5, -0.1), (5, 5, 5)), Fog("Fog", depth / 10)))
    lamps = []
    for i in range(lights):
        place, down = random.uniform((-4, -4, 2), (4, 4, 4.5)), random.uniform(-2, 2, 2)
        colour, power = random.uniform(0.3, 1, 3), 600 / lights
        if i % 2:
            beam = BARE | {"spot_size": np.radians(40), "spot_blend": 0.3}
            lamps.append(Lamp(f"Light {i}", "SPOT", place, 4 * power, colour, (*down, 0), properties=beam))
        else:
            lamps.append(Lamp(f"Light {i}", "POINT", place, power, colour, properties=BARE))
    for i in range(lasers):
        start, end = random.uniform((-5, -4, 1), (-4, 4, 4)), random.uniform((4, -4, 1), (5, 4, 4))
        beam = {"radius": 0.01, "length": 0.0}
        lamps.append(Lamp(f"Laser {i}", "LASER", start, 40 / lasers, (0.2, 1, 0.3), end, properties=beam))
    return core.scene(Model(View((0, -13, 3), (0, 0, 2), lens=42), things, lamps), pixels, pixels)
