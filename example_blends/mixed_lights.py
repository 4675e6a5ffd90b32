# SPDX-License-Identifier: GPL-3.0-or-later
"""Twelve balls in the light of five area lamps and three soft spots, their shadows in many colours."""

import colorsys

import numpy as np

from . import studio


def build() -> None:
    studio.empty_stage()
    studio.backdrop(studio.material("Paper", (0.72, 0.70, 0.68)), depth=6.0)
    random = np.random.default_rng(7)
    for i in range(12):
        row, column = divmod(i, 4)
        radius = 0.42 + 0.16 * random.random()
        position = ((column - 1.5) * 1.55 + 0.4 * (row % 2) - 0.2, row * 1.5 - 1.0, radius)
        colour = colorsys.hsv_to_rgb((0.02 + 0.085 * i) % 1.0, 0.72, 0.88)
        surface = studio.material(f"Ball {i}", colour)
        studio.place(f"Ball {i}", studio.ball(f"Ball {i}", radius, surface, cells=24), position)
    for i, (x, y, z, power, colour, shape) in enumerate(
        [
            (-5.0, -2.0, 3.6, 125, (1.0, 0.55, 0.30), "SQUARE"),
            (-2.2, 3.8, 4.6, 95, (1.0, 0.90, 0.75), "RECTANGLE"),
            (0.5, -3.5, 5.2, 95, (1.0, 0.97, 0.92), "DISK"),
            (3.2, 3.6, 4.4, 95, (0.70, 0.85, 1.0), "ELLIPSE"),
            (5.2, -1.6, 3.4, 125, (0.35, 0.55, 1.0), "SQUARE"),
        ]
    ):
        lamp = studio.light("AREA", (x, y, z), power, colour, (0, 0.5, 0.3), f"Area {i}", shape=shape)
        lamp.data.size = 0.9
        lamp.data.size_y = 0.4
    colours = ((1.0, 0.25, 0.45), (0.45, 1.0, 0.55), (0.75, 0.40, 1.0))
    for i, (x, colour) in enumerate(zip((-2.6, 0.2, 2.8), colours, strict=True)):
        studio.light(
            "SPOT", (x * 1.5, -4.2, 3.8), 210, colour, (x, 0.4, 0.2), f"Spot {i}",
            spot_size=0.62, spot_blend=0.5, shadow_soft_size=0.15,
        )  # fmt: skip
    studio.camera((0.0, -9.6, 4.6), (0.0, 0.35, 0.35), lens=52)
