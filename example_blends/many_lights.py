# SPDX-License-Identifier: GPL-3.0-or-later
"""Fifty lights of every kind among the blocks of a spiral town at dusk."""

import colorsys
import math

import numpy as np

from . import studio

GOLDEN_ANGLE = math.pi * (3 - math.sqrt(5))


def hue(turn: float, saturation: float = 0.75) -> tuple[float, float, float]:
    return colorsys.hsv_to_rgb(turn % 1.0, saturation, 1.0)


def spiral(i: float, spacing: float = 0.72) -> tuple[float, float]:
    """Position of the ``i``-th seed of a sunflower."""
    radius, angle = spacing * math.sqrt(i), i * GOLDEN_ANGLE
    return radius * math.cos(angle), radius * math.sin(angle)


def build() -> None:
    studio.empty_stage(world=(0.004, 0.005, 0.009))
    ground = studio.extruded(
        "Ground", [(-60, 0), (60, 0)], 120, studio.material("Ground", (0.55, 0.54, 0.56))
    )
    studio.place("Ground", ground)
    stone = studio.material("Stone", (0.78, 0.76, 0.74))
    count = np.arange(130)
    heights = 0.25 + 2.3 * np.exp(-count / 26) * np.random.default_rng(3).uniform(0.75, 1.25, 130)
    for i in count[1:]:
        x, y = spiral(i)
        block = studio.box(f"Block {i}", (0.44, 0.44, heights[i]), stone)
        studio.place(f"Block {i}", block, (x, y, 0), rotation_euler=(0, 0, i * GOLDEN_ANGLE))

    studio.light("SUN", (0, 0, 9), 0.05, (0.45, 0.55, 1.0), (4, 5, 5), angle=0.05)
    for i in range(20):
        x, y = spiral(6.5 + 6 * i)
        lamp = studio.light("POINT", (x, y, 0.4), 11, hue(0.02 + 0.03 * (i % 5), 0.85), name=f"Point {i}")
        lamp.data.shadow_soft_size = 0.06 * (i % 3)
    for i in range(16):
        turn = 2 * math.pi * i / 16
        x, y, cool = math.cos(turn), math.sin(turn), hue(0.5 + 0.22 * (i % 4) / 3, 0.8)
        lamp = studio.light("SPOT", (8.6 * x, 8.6 * y, 3.2), 260, cool, (4.6 * x, 4.6 * y, 0), f"Spot {i}")
        lamp.data.spot_size, lamp.data.spot_blend, lamp.data.shadow_soft_size = 0.5, 0.4, 0.1 * (i % 2)
    for i in range(8):
        turn = 2 * math.pi * (i + 0.5) / 8
        x, y = 3.0 * math.cos(turn), 3.0 * math.sin(turn)
        shape = ("SQUARE", "RECTANGLE", "DISK", "ELLIPSE")[i % 4]
        pink = hue(0.86 + 0.03 * (i % 4), 0.65)
        lamp = studio.light("AREA", (x, y, 3.4), 14, pink, (0, 0, 1.0), f"Area {i}", shape=shape)
        lamp.data.size, lamp.data.size_y = 0.6, 0.25
    for i in range(5):
        glow = studio.material(f"Glow {i}", hue(0.04 + 0.02 * i, 0.8), emission=2.5)
        x, y = spiral(14 + 17 * i)
        lantern = studio.ball(f"Lantern {i}", 0.22, glow, cells=6)
        studio.place(f"Lantern {i}", lantern, (x, y, heights[14 + 17 * i] + 0.27))
    studio.camera((0.0, -14.0, 9.6), (0.0, -0.55, 0.3), lens=50)
