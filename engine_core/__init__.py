# SPDX-License-Identifier: GPL-3.0-or-later
"""CV Render's engine, importable without Blender.

from engine_core import Camera, Mesh, PointLight, Scene, render
film = render(Scene(Camera.look_at((0, -5, 2), (0, 0, 0), 320, 240), meshes=[...], lights=[...]))
"""

from .errors import CVRenderError, RenderError, SceneError
from .image.film import Film
from .render import render
from .scene import (
    AreaLight,
    Camera,
    Laser,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    SpotLight,
    SunLight,
    Volume,
    World,
)
from .settings import Settings
from .workers import Sink

__all__ = [
    "AreaLight",
    "CVRenderError",
    "Camera",
    "Film",
    "Laser",
    "Light",
    "Material",
    "Mesh",
    "PointLight",
    "RenderError",
    "Scene",
    "SceneError",
    "Settings",
    "Sink",
    "SpotLight",
    "SunLight",
    "Volume",
    "World",
    "render",
]
