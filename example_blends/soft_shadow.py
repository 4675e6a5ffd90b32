# SPDX-License-Identifier: GPL-3.0-or-later
"""A ball of 110,592 triangles in the light of one square lamp: nothing but a soft shadow."""

from . import studio


def build() -> None:
    studio.empty_stage()
    studio.backdrop(studio.material("Teal sheet", (0.14, 0.36, 0.40)))
    coral = studio.material("Coral", (0.84, 0.20, 0.12))
    ball = studio.place("Ball", studio.ball("Ball", 1.0, coral), (0, 0, 1))
    # Made of a coarse ball when it is needed: the file stays small.
    subdivision = ball.modifiers.new("Subdivision", "SUBSURF")
    subdivision.levels, subdivision.render_levels = 3, 3
    studio.light("AREA", (-2.6, -3.0, 4.8), 400, (1.0, 0.94, 0.86), (0, 0, 0.6), shape="SQUARE", size=3.0)
    studio.camera((0.35, -8.6, 3.4), (0.35, 0, 0.8), lens=62)
