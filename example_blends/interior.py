# SPDX-License-Identifier: GPL-3.0-or-later
"""A living room: the sun falls through the window, a soft lamp below the ceiling fills the rest."""

from __future__ import annotations

from collections.abc import Sequence

import bpy
import numpy as np

from . import studio

WIDTH, DEPTH, HEIGHT = 6.0, 5.4, 2.8
WINDOW = (-0.5, 1.7, 0.85, 2.35)
"""y and z between which the left wall is open."""


def block(
    name: str,
    low: Sequence[float],
    high: Sequence[float],
    surface: bpy.types.Material,
    bevel: float = 0.0,
    **properties: object,
) -> bpy.types.Object:
    """A box between two corners, its edges rounded by ``bevel``."""
    low, high = np.array(low, float), np.array(high, float)
    x, y, _ = (low + high) / 2
    made = studio.place(name, studio.box(name, high - low, surface), (x, y, low[2]), **properties)
    if bevel:
        rounding = made.modifiers.new("Bevel", "BEVEL")
        rounding.width, rounding.segments = bevel, 3
    return made


def turned(
    name: str,
    profile: Sequence[tuple[float, float]],
    surface: bpy.types.Material,
    position: Sequence[float],
) -> bpy.types.Object:
    """What a lathe makes of a ``profile`` of (radius, height)."""
    return studio.place(name, studio.revolved(name, profile, surface), position)


def room() -> None:
    """Floor boards, three walls and a ceiling, with a window in the left wall."""
    wall = studio.material("Wall", (0.74, 0.70, 0.62))
    accent = studio.material("Accent wall", (0.20, 0.36, 0.36))
    white = studio.material("White paint", (0.85, 0.85, 0.83))
    left, right, back, front = -WIDTH / 2, WIDTH / 2, DEPTH / 2, -DEPTH / 2
    shades = np.random.default_rng(4).uniform(0.75, 1.15, 6)
    boards = [
        studio.material(f"Board {i}", tuple(s * np.array([0.46, 0.28, 0.15]))) for i, s in enumerate(shades)
    ]
    edges = np.linspace(left, right, 21)
    for i, (x0, x1) in enumerate(zip(edges[:-1], edges[1:], strict=True)):
        block(
            f"Board {i}",
            (x0 + 0.004, front, -0.05),
            (x1 - 0.004, back, 0),
            boards[(5 * i) % 6 if i % 2 else i % 6],
        )
    block("Underfloor", (left, front, -0.2), (right, back, -0.06), boards[0])
    block("Back wall", (left, back, 0), (right, back + 0.2, HEIGHT), accent)
    block("Front wall", (left, front - 0.2, 0), (right, front, HEIGHT), wall)
    block("Right wall", (right, front, 0), (right + 0.2, back, HEIGHT), wall)
    block("Ceiling", (left - 0.2, front - 0.2, HEIGHT), (right + 0.2, back + 0.2, HEIGHT + 0.2), white)
    y0, y1, z0, z1 = WINDOW
    for name, low, high in (
        ("before", (front, 0), (y0, HEIGHT)),
        ("behind", (y1, 0), (back, HEIGHT)),
        ("below", (y0, 0), (y1, z0)),
        ("above", (y0, z1), (y1, HEIGHT)),
    ):
        block(f"Wall {name} window", (left - 0.2, *low), (left, *high), wall)
    middle = (y0 + y1) / 2
    for i, (low, high) in enumerate(
        [
            ((y0, z0), (y0 + 0.07, z1)),
            ((y1 - 0.07, z0), (y1, z1)),
            ((y0, z0), (y1, z0 + 0.07)),
            ((y0, z1 - 0.07), (y1, z1)),
            ((middle - 0.03, z0), (middle + 0.03, z1)),
            ((y0, 1.72), (y1, 1.77)),
        ]
    ):
        block(f"Frame {i}", (left - 0.14, *low), (left - 0.06, *high), white)
    block("Sill", (left - 0.02, y0 - 0.08, z0 - 0.04), (left + 0.2, y1 + 0.08, z0), white, bevel=0.01)
    block("Skirting back", (left, back - 0.02, 0), (right, back, 0.1), white)
    block("Skirting right", (right - 0.02, front, 0), (right, back, 0.1), white)


def sofa() -> None:
    fabric = studio.material("Fabric", (0.70, 0.30, 0.16))
    cushion = studio.material("Cushion", (0.86, 0.66, 0.28))
    block("Sofa seat", (0.15, 1.45, 0.16), (2.35, 2.45, 0.46), fabric, 0.06)
    block("Sofa back", (0.15, 2.2, 0.3), (2.35, 2.5, 0.92), fabric, 0.08)
    for i, x in enumerate((0.0, 2.3)):
        block(f"Sofa arm {i}", (x, 1.42, 0.14), (x + 0.24, 2.48, 0.66), fabric, 0.07)
    for i, (x, turn) in enumerate(((0.5, 0.2), (1.95, -0.15))):
        block(
            f"Cushion {i}", (x - 0.22, 1.98, 0.47), (x + 0.22, 2.12, 0.88), cushion, 0.06,
            rotation_euler=(-0.25, 0, turn),
        )  # fmt: skip


def coffee_table() -> None:
    """A round table on a rug, with fruit and a vase."""
    for name, x, y, z, colour in (
        ("Rug", 1.45, 0.875, 0.020, (0.50, 0.47, 0.42)),
        ("Rug stripe", 1.25, 0.715, 0.024, (0.14, 0.23, 0.32)),
        ("Rug field", 1.13, 0.595, 0.028, (0.52, 0.45, 0.36)),
    ):
        block(name, (0.45 - x, 0.375 - y, 0), (0.45 + x, 0.375 + y, z), studio.material(name, colour))
    oak = studio.material("Oak", (0.55, 0.36, 0.19))
    turned("Table top", [(0, 0.4), (0.58, 0.4), (0.6, 0.42), (0.58, 0.44), (0, 0.44)], oak, (0.75, 0.4, 0))
    for i in range(3):
        turn = 2 * np.pi * i / 3 + 0.4
        position = (0.75 + 0.4 * np.cos(turn), 0.4 + 0.4 * np.sin(turn), 0)
        turned(f"Table leg {i}", [(0.018, 0), (0.03, 0.42)], oak, position)
    bowl = [(0, 0), (0.09, 0), (0.1, 0.02), (0.16, 0.07), (0.19, 0.12), (0.18, 0.12), (0.14, 0.07), (0, 0.03)]
    turned("Bowl", bowl, studio.material("China", (0.82, 0.84, 0.84)), (0.6, 0.35, 0.44))
    for name, x, y, colour in (
        ("Orange", 0.53, 0.30, (0.85, 0.42, 0.04)),
        ("Pear", 0.66, 0.32, (0.55, 0.68, 0.12)),
        ("Apple", 0.60, 0.44, (0.80, 0.12, 0.08)),
    ):
        studio.place(name, studio.ball(name, 0.065, studio.material(name, colour), 8), (x, y, 0.55))
    vase = [(0, 0), (0.06, 0), (0.1, 0.08), (0.085, 0.18), (0.035, 0.26), (0.05, 0.31), (0.04, 0.3), (0, 0.2)]
    turned("Vase", vase, studio.material("Glaze", (0.10, 0.33, 0.42)), (1.0, 0.55, 0.44))


def bookshelf() -> None:
    """Five shelves of books at the back wall."""
    pine = studio.material("Pine", (0.66, 0.50, 0.32))
    random = np.random.default_rng(11)
    hues = [
        (0.55, 0.14, 0.10),
        (0.12, 0.27, 0.42),
        (0.80, 0.68, 0.42),
        (0.18, 0.34, 0.20),
        (0.72, 0.40, 0.14),
        (0.30, 0.18, 0.30),
    ]
    covers = [studio.material(f"Cover {i}", hue) for i, hue in enumerate(hues)]
    left, right, back, front = -2.45, -0.75, 2.68, 2.36
    for x in (left, right):
        block("Shelf side", (x - 0.02, front, 0), (x + 0.02, back, 2.1), pine)
    for i in range(6):
        z = 0.08 + 0.4 * i
        block(f"Shelf {i}", (left, front, z), (right, back, z + 0.03), pine)
        x = left + 0.04
        while i < 5 and x < right - 0.1 - 0.5 * random.random():
            width, height, depth = random.uniform((0.025, 0.2, 0.16), (0.065, 0.33, 0.24))
            low = (x, back - 0.04 - depth, z + 0.03)
            block("Book", low, (x + width, back - 0.04, z + 0.03 + height), covers[random.integers(6)])
            x += width + 0.004


def floor_lamp() -> None:
    """The one bulb that glows itself, in a paper shade."""
    x, y = 2.68, 2.3
    turned(
        "Lamp stand",
        [(0.17, 0), (0.015, 0.04), (0.012, 1.5)],
        studio.material("Metal", (0.12, 0.12, 0.13)),
        (x, y, 0),
    )
    turned(
        "Lamp shade", [(0.21, 1.36), (0.13, 1.72)], studio.material("Paper", (0.85, 0.78, 0.66)), (x, y, 0)
    )
    bulb = studio.ball("Bulb", 0.05, studio.material("Bulb", (1.0, 0.72, 0.42), emission=150), 4)
    studio.place("Bulb", bulb, (x, y, 1.56))


def pictures() -> None:
    """Three prints with a disc each."""
    frame = studio.material("Frame", (0.10, 0.09, 0.08))
    back = DEPTH / 2
    for i, (paper, ink) in enumerate(
        [
            ((0.85, 0.78, 0.62), (0.80, 0.30, 0.16)),
            ((0.80, 0.82, 0.80), (0.13, 0.34, 0.48)),
            ((0.84, 0.80, 0.70), (0.86, 0.62, 0.16)),
        ]
    ):
        x, sheet = 0.5 + 0.72 * i, studio.material(f"Sheet {i}", paper)
        block(f"Frame of print {i}", (x - 0.27, back - 0.03, 1.25), (x + 0.27, back, 1.95), frame)
        block(f"Print {i}", (x - 0.24, back - 0.034, 1.28), (x + 0.24, back - 0.02, 1.92), sheet)
        disc = turned(
            f"Disc {i}", [(0, 0), (0.15, 0)], studio.material(f"Ink {i}", ink), (x, back - 0.036, 1.62)
        )
        disc.rotation_euler = (np.pi / 2, 0, 0)


def build() -> None:
    studio.empty_stage(world=(0.55, 0.75, 1.0))
    room()
    sofa()
    coffee_table()
    bookshelf()
    floor_lamp()
    pictures()
    studio.light("SUN", (-9.4, -2.6, 3.6), 14, (1.0, 0.82, 0.58), (-6.2, -1.0, 2.6), angle=0.009)
    studio.light(
        "AREA", (0.2, -0.2, HEIGHT - 0.02), 58, (1.0, 0.94, 0.86), (0.2, -0.2, 0), "Ceiling lamp",
        shape="RECTANGLE", size=2.6, size_y=1.8,
    )  # fmt: skip
    studio.camera((0.45, -2.6, 1.45), (-0.05, 2.0, 1.08), lens=22)
