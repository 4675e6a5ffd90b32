# SPDX-License-Identifier: GPL-3.0-or-later
"""What is rendered: frozen dataclasses of arrays, validated when made."""

from .camera import Camera
from .lights import AreaLight, Laser, Light, PointLight, SpotLight, SunLight, World
from .linking import NO_SHADOW, Linking
from .material import Material
from .mesh import Mesh
from .scene import Scene
from .volume import Volume

__all__ = [
    "NO_SHADOW",
    "AreaLight",
    "Camera",
    "Laser",
    "Light",
    "Linking",
    "Material",
    "Mesh",
    "PointLight",
    "Scene",
    "SpotLight",
    "SunLight",
    "Volume",
    "World",
]
