# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers part by part: what integrates each, single camera rays, and beams, for their tests."""

from __future__ import annotations

from typing import Any

import numpy as np
import scenes

from engine_core import Camera, Laser, Scene, Settings, Volume, World
from engine_core.geometry.frame import frame_of
from engine_core.geometry.surfaces import Surfaces
from engine_core.geometry.triangles import gather_triangles
from engine_core.integration.integrand import values_at
from engine_core.integration.point_sets import SobolPoints
from engine_core.integration.rules import gauss
from engine_core.transport.camera_hits import CameraStage, Pixels
from engine_core.transport.camera_rays import CameraRays
from engine_core.transport.laser_in_fog import LaserInFog
from engine_core.transport.laser_maps import (
    along_ray,
    along_ray_as_in_thesis,
)
from engine_core.transport.laser_on_surfaces import LaserOnSurfaces, Reflection
from engine_core.transport.laser_seen import LasersSeen
from engine_core.transport.lasers import Lasers
from engine_core.transport.light_samples import SceneLights
from engine_core.transport.media import Media
from engine_core.transport.shadows import Shadows
from engine_core.transport.single_scattering import SingleScattering
from engine_core.transport.surface_shading import SurfaceShader

MAPS = {"point": along_ray, "thesis_2020": along_ray_as_in_thesis}


class Stage:
    """All that the parts of a scene's lasers share."""

    def __init__(self, scene: Scene, reflectance: float = 0.5) -> None:
        self.frame = frame_of(scene)
        triangles, _ = gather_triangles([mesh for mesh in scene.meshes if mesh.surface], self.frame)
        shader = SurfaceShader(scene.materials, triangles, self.frame)
        transmits = shader.transmits
        surfaces = Surfaces(triangles, transmits[triangles.material] if transmits.any() else None)
        self.media = Media.of(scene, self.frame)
        self.shadows = Shadows(surfaces, shader, 8)
        self.rays = CameraRays(scene.camera, self.frame)
        self.lasers = Lasers.of(scene, self.frame, self.media, self.shadows)
        lights = SceneLights([], shader, triangles)
        self.scattering = None
        if self.media is not None:
            self.scattering = SingleScattering(
                self.frame, self.media, lights, surfaces, shader, self.rays, Settings(threads=1)
            )
        self.hits = CameraStage(scene, self.frame, surfaces, shader, [], False, False, 8, self.media)
        self.reflection = Reflection(np.full((3, len(scene.materials)), reflectance), triangles.material)

    def in_fog(self, map: str = "point") -> LaserInFog:
        return LaserInFog(self.lasers, self.scattering, map, shifted=True)

    def on_surfaces(self) -> LaserOnSurfaces:
        return LaserOnSurfaces(
            self.lasers, self.hits, self.reflection, self.shadows, self.media, shifted=True
        )

    def seen(self) -> LasersSeen:
        return LasersSeen(self.lasers, self.rays, self.hits, self.reflection, self.shadows, self.scattering)


def pixels(width: int = 1, height: int = 1) -> Pixels:
    x, y = np.indices((width, height)).reshape(2, -1).astype(np.int32)
    return Pixels(x, y, np.zeros(len(x), np.int32))


def net(pixels_: Pixels, samples: int, seed: int = 0) -> np.ndarray:
    points = SobolPoints(range(2), seed, 3)
    points.prepare(samples)
    return points.points(pixels_.key(), 0, samples)


def tensor(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (2, order^2) and weights of a Gauss-Legendre rule."""
    x, w = gauss(order)
    return np.stack([np.repeat(x, order), np.tile(x, order)]), np.outer(w, w).ravel()


def beam(start: Any, towards: Any, power: Any = 1.0, **fields: Any) -> Laser:
    back = np.subtract(start, towards, dtype=float)
    back /= np.linalg.norm(back)
    side = np.cross(back, np.eye(3)[np.abs(back).argmin()])
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
    matrix[:3, 3] = start
    return Laser(power, light_to_world=matrix, **fields)


def pinhole(at: Any, towards: Any, **fields: Any) -> Camera:
    """A camera of one pixel that sees next to nothing but one ray."""
    camera = Camera.look_at(at, towards, 1, 1)
    return Camera(camera.camera_to_world, np.array(camera.viewplane) * 1e-6, 1, 1, **fields)


def from_above(width: int, size: float, **fields: Any) -> Camera:
    half = size / 2
    return Camera(
        scenes.place((0, 0, 4)), (-half, half, -half, half), width, width, projection="orthographic"
    )


def everywhere(scattering: Any, absorption: Any = 0.0, g: float = 0.0) -> dict[str, Any]:
    """Fields of a scene that is full of fog."""
    return {"world": World(0, volume=0), "volumes": (Volume(scattering, absorption, g),)}


def henyey_greenstein(cos: float, g: float) -> float:
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cos) ** 1.5)


class Line:
    """The one camera ray of a `pinhole`, and the beam of a laser, in scene units and float64."""

    def __init__(self, stage: Stage, laser: Laser) -> None:
        origin, direction = stage.rays.rays(np.zeros(1, int), np.zeros(1, int), np.full((2, 1, 1), 0.5))
        self.origin = origin[0] / stage.frame.scale + stage.frame.origin
        self.clip = stage.rays.reach / stage.frame.scale * np.linalg.norm(direction[0].astype(float))
        self.direction = direction[0] / np.linalg.norm(direction[0].astype(float))
        self.start, self.axis = laser.light_to_world[:3, 3], -laser.light_to_world[:3, 2]

    def between(self, t: float, v: float) -> tuple[np.ndarray, float]:
        vector = self.origin + t * self.direction - self.start - v * self.axis
        r = np.linalg.norm(vector)
        return vector / r, r


MIDDLE = np.full((2, 1, 1), 0.5)


def in_middles(integrand: LaserInFog | LaserOnSurfaces, where: Pixels, points: int = 1 << 12) -> np.ndarray:
    """(3, B) integrals in the pixels' middles."""
    net = SobolPoints(range(integrand.rest_dimensions), 0, 101)
    net.prepare(points)
    u = net.points(np.zeros(1, np.uint32), 0, points)[:, 0]
    middle = np.full((2, 1, 1), 0.5)
    stages = (integrand.first(where[n : n + 1], middle) for n in range(len(where)))
    each = [values_at(integrand, stage, 1, None, u)[:3].mean(axis=1) for stage in stages]
    return np.stack(each, axis=1)
