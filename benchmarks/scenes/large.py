# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that are large to export: many triangles, or many objects."""

from __future__ import annotations

import bpy
import numpy as np

from example_blends import shapes, studio


def _stage() -> bpy.types.Material:
    studio.empty_stage()
    studio.light("SUN", (0, 0, 10), 2.0, target=(1, 1, 0))
    studio.camera((0, -30, 20), (0, 0, 0))
    return studio.material("Grey")


def one_mesh(triangles: int = 1_000_000, smooth: bool = False) -> None:
    """A wavy sheet in one mesh of about ``triangles``."""
    surface = _stage()
    n = int(np.sqrt(triangles / 2)) + 1
    x, y = np.meshgrid(np.linspace(-10, 10, n), np.linspace(-10, 10, n), indexing="ij")
    points = np.stack([x, y, np.sin(x) * np.cos(y)], -1).reshape(-1, 3)
    studio.place("Sheet", studio.mesh("Sheet", points, shapes.grid_faces(n, n), surface, smooth))


def many_objects(count: int = 10_000, shared: bool = False) -> None:
    """``count`` balls of 48 triangles, each a mesh of its own or all of one ``shared`` mesh."""
    surface = _stage()
    ball = studio.ball("Ball", 0.08, surface, cells=2)
    side = int(np.ceil(np.sqrt(count)))
    for i in range(count):
        x, y = divmod(i, side)
        data = ball if shared else ball.copy()
        studio.place(f"Ball {i}", data, (0.2 * (x - side / 2), 0.2 * (y - side / 2), 0))


def many_instances(count: int = 10_000) -> None:
    """``count`` instances of a ball of 48 triangles on the vertices of a mesh."""
    surface = _stage()
    side = int(np.ceil(np.sqrt(count)))
    x, y = np.divmod(np.arange(count), side)
    points = np.stack([0.2 * (x - side / 2), 0.2 * (y - side / 2), 0 * x], -1)
    cloud = studio.mesh("Points", points, np.empty((0, 3), int))
    parent = studio.place("Points", cloud, instance_type="VERTS")
    studio.place("Ball", studio.ball("Ball", 0.08, surface, cells=2)).parent = parent
