# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes as plain data, so that one description serves Blender and the engine without Blender alike.

`studio.build_model` makes a Blender file of a `Model`, `benchmarks.scenes.core` a scene of `engine_core`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .shapes import Shape, revolved

Colour = Sequence[float]


@dataclass(frozen=True)
class Ramp:
    """Colours over the first coordinate of the UV map, linear between ``stops`` (place, colour)."""

    stops: tuple[tuple[float, Colour], ...]


@dataclass(frozen=True)
class Surface:
    """What a thing is made of.

    shader : "Diffuse", "Glossy", "Principled" or "Emission".
    inputs : by the names that `engine_core.shading.closures` has for them: color, base_color, roughness ...
    """

    name: str
    shader: str
    inputs: Mapping[str, Any]


@dataclass(frozen=True)
class Fog:
    """A homogeneous medium: what Blender's Volume Scatter and Volume Absorption nodes make of it.

    density : of the scattering, per metre, times ``colour``. absorption : RGB, per metre.
    anisotropy : mean cosine of the Henyey-Greenstein phase function.
    """

    name: str
    density: float
    colour: Colour = (1.0, 1.0, 1.0)
    anisotropy: float = 0.0
    absorption: Colour = (0.0, 0.0, 0.0)


def diffuse(name: str, colour: Colour) -> Surface:
    return Surface(name, "Diffuse", {"color": colour})


@dataclass(frozen=True)
class Lathe:
    """A profile of (radius, height) turned about the z axis, then moved: `shapes.revolved`."""

    profile: Sequence[tuple[float, float]]
    segments: int
    position: Sequence[float]

    def thing(self, name: str, surface: Surface) -> Thing:
        vertices, faces = revolved(self.profile, self.segments)
        return Thing(name, (vertices + np.array(self.position), faces), surface, smooth=True, lathe=self)


@dataclass(frozen=True, eq=False)
class Thing:
    """An object: a shape in world space and one surface, or the fog that it bounds, itself unseen.

    uv : (F, K, 2), of its faces' corners.
    lathe : what ``shape`` was turned from, so that a file need not hold it.
    """

    name: str
    shape: Shape
    surface: Surface | Fog
    smooth: bool = False
    uv: np.ndarray | None = None
    lathe: Lathe | None = None


@dataclass(frozen=True)
class Lamp:
    """A light as Blender knows it.

    kind : "POINT", "SPOT", "AREA", "SUN" or "LASER". power : in W (a sun: W/m2). seen : by the camera.
    properties : of Blender's light data; of a laser: its beam's "radius" and "length", 0 for no end.
    """

    name: str
    kind: str
    position: Sequence[float]
    power: float
    colour: Colour = (1.0, 1.0, 1.0)
    target: Sequence[float] | None = None
    seen: bool = False
    properties: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class View:
    """A camera; ``lens`` in mm on a sensor of 36 mm."""

    position: Sequence[float]
    target: Sequence[float]
    lens: float = 50.0

    @property
    def field_of_view(self) -> float:
        """In radians, across the wider side of the picture."""
        return 2 * math.atan(18 / self.lens)


@dataclass(frozen=True)
class Model:
    """A whole scene.

    world : radiance from everywhere. size : of the picture, as the file has it. fog : fills all space.
    """

    view: View
    things: Sequence[Thing]
    lamps: Sequence[Lamp] = ()
    world: Colour = (0.0, 0.0, 0.0)
    size: tuple[int, int] = (960, 540)
    fog: Fog | None = None


def aimed(position: Sequence[float], target: Sequence[float] | None) -> np.ndarray:
    """(4, 4) of a camera or light at ``position``: its -Z points to the target, its Y as far up as can be."""
    matrix = np.eye(4)
    matrix[:3, 3] = position
    if target is not None:
        back = np.subtract(position, target, dtype=float)
        back /= np.linalg.norm(back)
        right = np.cross((0, 0, 1), back) if abs(back[2]) < 0.99999 else np.array([1.0, 0, 0])
        right /= np.linalg.norm(right)
        matrix[:3, :3] = np.stack([right, np.cross(back, right), back], axis=1)
    return matrix
