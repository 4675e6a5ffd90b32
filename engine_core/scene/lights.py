# SPDX-License-Identifier: GPL-3.0-or-later
"""Light sources, in the terms of Cycles: `transport.emitters` turns their watts into radiance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .linking import NO_SHADOW, Linking
from .validation import fail, set_array, set_colour, set_number, set_switch


@dataclass(frozen=True, eq=False)
class Light:
    """What all lights have.

    power : RGB radiant flux in W (a sun: irradiance in W/m2); may be negative, as in Cycles.
    normalize : True if power is the whole light's whatever its size, False if it is that of a unit
        area (a light then grows brighter as it grows larger).
    casts_shadow : False lights through everything.
    visible_to_camera : a light of some size is seen in the picture itself.
    linking : what it lights, and what casts shadows in its light.
    """

    power: Any
    normalize: bool = True
    casts_shadow: bool = True
    visible_to_camera: bool = False
    name: str = "Light"
    linking: Linking = Linking()

    def __post_init__(self) -> None:
        set_colour(self, "power")
        for field in ("normalize", "casts_shadow", "visible_to_camera"):
            set_switch(self, field)

    @property
    def links(self) -> Linking:
        """Its linking, in which its shadow counts."""
        return self.linking if self.casts_shadow else replace(self.linking, blockers=NO_SHADOW)


@dataclass(frozen=True, eq=False)
class PointLight(Light):
    """Emits alike in all directions, from a point, a sphere, or a disk that faces the shaded point.

    position : (3,) world position less `Scene.origin`.
    radius : in scene units; 0 is a point.
    sphere : False is the disk: what Blender's "soft falloff" (its default) makes of a radius.
    """

    position: Any = (0.0, 0.0, 0.0)
    radius: float = 0.0
    sphere: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        set_array(self, "position", (3,))
        set_number(self, "radius", 0.0)


@dataclass(frozen=True, eq=False)
class SpotLight(Light):
    """A point light seen through a cone about its own -Z.

    light_to_world : (4, 4); its scale widens or narrows the cone, as in Cycles.
    radius, sphere : as for `PointLight`; the radius is in scene units, whatever the scale.
    angle : full angle of the cone in radians.
    blend : softness of the cone's edge, 0 to 1.
    """

    light_to_world: Any = None
    radius: float = 0.0
    sphere: bool = True
    angle: float = np.pi / 4
    blend: float = 0.15

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.light_to_world is None:
            object.__setattr__(self, "light_to_world", np.eye(4))
        set_array(self, "light_to_world", (4, 4))
        set_number(self, "radius", 0.0)
        set_number(self, "angle", 0.0, np.pi)
        set_number(self, "blend", 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class AreaLight(Light):
    """A rectangle or an ellipse that emits from one side, along its own -Z.

    light_to_world : (4, 4), scale included.
    size : (x, y) in the light's own units, before the scale of ``light_to_world``.
    ellipse : the ellipse inscribed in the rectangle.
    spread : angle in radians of a soft box's grid; pi is none (cosine emission).
    """

    light_to_world: Any = None
    size: Any = (1.0, 1.0)
    ellipse: bool = False
    spread: float = np.pi

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.light_to_world is None:
            object.__setattr__(self, "light_to_world", np.eye(4))
        set_array(self, "light_to_world", (4, 4))
        if np.ndim(self.size) == 0:
            object.__setattr__(self, "size", (self.size, self.size))
        if (set_array(self, "size", (2,)) < 0).any():
            raise fail(self, "size", f"is {self.size.tolist()}, wanted no negative value")
        set_number(self, "spread", 0.0, np.pi + 1e-5)


@dataclass(frozen=True, eq=False)
class SunLight(Light):
    """A disk at infinity; ``power`` is the irradiance in W/m2 on a surface that faces it.

    direction : (3,), the way the light travels; any length but 0.
    angle : the disk's angular diameter in radians, 0 for parallel light.
    """

    direction: Any = (0.0, 0.0, -1.0)
    angle: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        direction = set_array(self, "direction", (3,))
        length = np.linalg.norm(direction)
        if not length > 0:
            raise fail(self, "direction", f"is {direction.tolist()}: it has no length")
        object.__setattr__(self, "direction", direction / length)
        set_number(self, "angle", 0.0, np.pi)


@dataclass(frozen=True, eq=False)
class Laser(Light):
    """A beam of parallel light along its own -Z, up to the first surface: a virtual ray light.

    ``power`` is the flux of the whole beam in W. Its light is drawn in four parts, each of which can be
    left out: what fog scatters out of the beam and then once more to the camera (`in_fog`, thesis eq.
    6.10), what it scatters out of the beam onto surfaces (`on_surfaces`), the beam itself, where fog
    scatters it straight to the camera (`beam`), and the spot where it ends (`spot`).

    light_to_world : (4, 4); the beam begins at its origin. Scale counts for nothing.
    radius : of the beam, in scene units.
    length : at which it ends if it meets nothing.
    """

    light_to_world: Any = None
    radius: float = 0.01
    length: float = np.inf
    in_fog: bool = True
    on_surfaces: bool = True
    beam: bool = True
    spot: bool = True

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.light_to_world is None:
            object.__setattr__(self, "light_to_world", np.eye(4))
        set_array(self, "light_to_world", (4, 4))
        set_number(self, "radius", 0.0)
        set_number(self, "length", 0.0, infinite=True)


@dataclass(frozen=True, eq=False)
class World:
    """Radiance from everywhere: one colour, a picture, or the sum of both.

    radiance : RGB in W/(sr m2).
    image : (H, W, 3) radiance, linear and equirectangular, interpolated linearly: row 0 looks down -Z, the
        middle of a row along +X, its first quarter along +Y. Negative values count as 0.
    rotation : (3, 3) orthogonal, from directions in the world to those of the image.
    visible_to_camera : False leaves the background black (it still lights the scene).
    volume : index into `Scene.volumes` of the medium that fills all space; -1 for none.
    """

    radiance: Any = 0.0
    visible_to_camera: bool = True
    name: str = "World"
    image: Any = None
    rotation: Any = None
    volume: int = -1

    def __post_init__(self) -> None:
        set_colour(self, "radiance")
        if self.image is not None and not set_array(self, "image", (None, None, 3), np.float32).size:
            raise fail(self, "image", f"has shape {self.image.shape}, wanted at least a texel")
        if self.rotation is None:
            object.__setattr__(self, "rotation", np.eye(3))
        rotation = set_array(self, "rotation", (3, 3))
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4:
            raise fail(self, "rotation", f"is {rotation.tolist()}, wanted perpendicular unit rows")
