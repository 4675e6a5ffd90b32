# SPDX-License-Identifier: GPL-3.0-or-later
"""The frame of reference in which rays are traced: about the camera, at unit size.

Float32 is exact to 2^-24 of a number's size, so it is spent best near the camera; and a scale by a
power of two changes no mantissa, so a scene and the same scene 2^13 times larger give the same
picture bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..scene import Mesh, Scene


@dataclass(frozen=True)
class Frame:
    """local = (scene position - origin) * scale, with ``scale`` a power of two."""

    origin: np.ndarray
    scale: float

    def positions(self, positions: np.ndarray) -> np.ndarray:
        """Scene positions (..., 3) of any dtype, as float32 in this frame."""
        return ((np.asarray(positions, np.float64) - self.origin) * self.scale).astype(np.float32)


def frame_of(scene: Scene) -> Frame:
    """The frame about the camera in which a typical vertex (without any, a light) is 1 to 2 away."""
    origin = scene.camera.camera_to_world[:3, 3]
    points = [_some_vertices(mesh) for mesh in scene.meshes if len(mesh.vertices)]
    if not points:
        points = [
            np.reshape(position, (1, 3))
            for light in scene.lights
            if (position := getattr(light, "position", None)) is not None
        ]
    points = np.concatenate(points) if points else np.ones((1, 3))
    distance = np.abs(points.astype(np.float64) - origin).max(axis=1)
    distance = distance[np.isfinite(distance) & (distance > 0)]
    typical = float(np.median(distance)) if distance.size else 1.0
    exponent = np.clip(np.floor(np.log2(typical)), -120, 120)
    return Frame(origin, float(2.0**-exponent))


def _some_vertices(mesh: Mesh, count: int = 1024) -> np.ndarray:
    return mesh.vertices[:: max(1, len(mesh.vertices) // count)]
