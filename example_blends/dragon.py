# SPDX-License-Identifier: GPL-3.0-or-later
"""DRAGON: a diffuse dragon between the camera and a tilted lamp that runs from yellow over orange to red.

The mesh is the Stanford Dragon (Stanford Computer Graphics Laboratory, Stanford 3D Scanning Repository,
1996), which its terms keep from commercial use: it is read from a folder of the user's, and no part of
this project.
"""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np

from .model import Model, Ramp, Surface, Thing, View, diffuse
from .shapes import Shape

MESH = "dragon_vrip_res2.ply.gz"
HEIGHT = 2.4


def read_ply(path: Path) -> Shape:
    """Vertices and triangles of a gzipped ASCII PLY file."""
    with gzip.open(path, "rt") as lines:
        counts = {}
        for line in lines:
            words = line.split()
            if words[0] == "element":
                counts[words[1]] = int(words[2])
            if words[0] == "end_header":
                break
        vertices = np.loadtxt(lines, max_rows=counts["vertex"], usecols=(0, 1, 2))
        faces = np.loadtxt(lines, int, max_rows=counts["face"])
    return vertices, faces[:, 1:4]


def standing(assets: Path) -> Shape:
    """The dragon of `MESH` in this folder, on z = 0 and `HEIGHT` tall."""
    vertices, faces = read_ply(Path(assets) / MESH)
    vertices = vertices[:, [0, 2, 1]] * (1, -1, 1)
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle = np.array([*(low + high)[:2] / 2, low[2]])
    return (vertices - middle) * (HEIGHT / (high - low)[2]), faces


def model(assets: Path) -> Model:
    """assets : the folder that has `MESH`."""
    floor = np.array([(-14, -10, 0), (14, -10, 0), (14, 14, 0), (-14, 14, 0)], float)
    quad, corners = np.array([(0, 1, 2, 3)]), np.array([[(0, 0), (1, 0), (1, 1), (0, 1)]], float)
    # Behind the dragon, its upper edge nearer: seen from the front, and tilted to the floor.
    lamp = np.array([(-2.8, 2.2, 4.0), (2.8, 2.2, 4.0), (2.8, 3.7, 0.9), (-2.8, 3.7, 0.9)], float)
    ramp = Ramp(((0.0, (1.0, 0.80, 0.12)), (0.5, (1.0, 0.30, 0.03)), (1.0, (0.85, 0.02, 0.01))))
    glow = Surface("Lamp", "Emission", {"color": ramp, "strength": 2.4})
    things = [
        Thing("Floor", (floor, quad), diffuse("Floor", (0.62, 0.61, 0.60))),
        Thing("Dragon", standing(assets), diffuse("Jade", (0.70, 0.78, 0.70)), smooth=True),
        Thing("Lamp", (lamp, quad), glow, uv=corners),
    ]
    world = (0.06, 0.066, 0.08)
    return Model(View((0.2, -8.6, 3.0), (0.0, 0.3, 1.6), lens=46), things, (), world, size=(1280, 720))
