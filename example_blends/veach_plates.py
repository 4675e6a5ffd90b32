# SPDX-License-Identifier: GPL-3.0-or-later
"""VEACHMIS: three round lights of equal power mirrored in four plates of rising roughness.

After the figure by which E. Veach and L. J. Guibas showed multiple importance sampling ("Optimally
Combining Sampling Techniques for Monte Carlo Rendering", 1995): the sharper the plate and the larger the
light, the better is sampling the BSDF; the rougher and the smaller, the better is sampling the light.
"""

import numpy as np

from .model import Lamp, Model, Surface, Thing, View, diffuse
from .shapes import Shape, grid_faces

LIGHTS = ((-2.9, 0.08, (1.0, 0.62, 0.30)), (0.0, 0.27, (1.0, 0.94, 0.86)), (2.9, 0.9, (0.42, 0.66, 1.0)))
"""x, radius and colour of each."""
HEIGHT, POWER = 4.15, 60.0
PLATES = (
    (0.07, ((-0.256, 1.440), (0.526, 2.062))),
    (0.14, ((-1.370, 0.858), (-0.477, 1.308))),
    (0.22, ((-2.700, 0.415), (-1.746, 0.712))),
    (0.32, ((-4.067, 0.150), (-3.082, 0.325))),
)
"""Roughness, and the (y, z) of the near and the far edge, so tilted that all lights are seen in each."""
WIDTH, THICKNESS = 8.0, 0.07


def plate(near: tuple[float, float], far: tuple[float, float]) -> Shape:
    """A board of some thickness below the line from ``near`` to ``far``."""
    along = np.subtract(far, near)
    below = np.array([along[1], -along[0]]) * THICKNESS / np.hypot(*along)
    edges = np.array([near, far, far + below, near + below])
    x = np.array([[-WIDTH / 2], [WIDTH / 2]])
    y, z = edges.T
    vertices = np.stack(np.broadcast_arrays(x, y, z), -1).reshape(-1, 3)
    faces = np.concatenate([grid_faces(2, 4, around=True)[:, ::-1], [(0, 1, 2, 3), (7, 6, 5, 4)]])
    return vertices, faces


def model() -> Model:
    wall, floor = diffuse("Wall", (0.36, 0.38, 0.42)), diffuse("Floor", (0.40, 0.38, 0.36))
    ground = np.array([(-12, -14, 0), (12, -14, 0), (12, 2.2, 0), (-12, 2.2, 0)], float)
    back = np.array([(-12, 2.2, 0), (12, 2.2, 0), (12, 2.2, 12), (-12, 2.2, 12)], float)
    quad = np.array([(0, 1, 2, 3)])
    things = [Thing("Floor", (ground, quad), floor), Thing("Wall", (back, quad), wall)]
    for i, (roughness, (near, far)) in enumerate(PLATES):
        metal = Surface(f"Plate {i}", "Glossy", {"color": (0.72, 0.76, 0.80), "roughness": roughness})
        things.append(Thing(f"Plate {i}", plate(near, far), metal))
    lamps = [
        Lamp(
            f"Light {i}", "POINT", (x, 0.0, HEIGHT), POWER, colour, seen=True,
            properties={"shadow_soft_size": radius, "use_soft_falloff": False},
        )
        for i, (x, radius, colour) in enumerate(LIGHTS)
    ]  # fmt: skip
    return Model(View((0, -15, 6.15), (0, -1.9, 2.16), lens=43), things, lamps, size=(1280, 720))
