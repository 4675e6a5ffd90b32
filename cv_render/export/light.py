# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights, in the units and conventions of Cycles."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core import AreaLight, Laser, PointLight, SpotLight, SunLight
from ...engine_core.scene import Light, Linking
from ..properties import is_laser
from ..versions import light_gain, light_is_normalized, node_tree
from .material import emitted
from .messages import Messages, named
from .nodes import described, surface


def export_light(obj: Any, matrix: np.ndarray, linking: Linking, messages: Messages) -> Light | None:
    """The light of a Blender object at ``matrix`` ((4, 4) float64, less the origin).

    None if it has no effect.
    """
    light = obj.data
    owner = named(obj)
    if light.type == "AREA" and getattr(getattr(light, "cycles", None), "is_portal", False):
        messages.add(owner, "light portals are not needed, it is left out")
        return None
    if not obj.visible_diffuse:
        messages.add(owner, "is invisible to diffuse rays and is left out")
        return None
    if not np.isfinite(matrix).all() or (light.type == "SUN" and not matrix[:3, 2].any()):
        messages.add(owner, "has no direction (a scale of zero) and is left out")
        return None
    shared = {
        "power": np.array(light.color) * light.energy * light_gain(light) * _nodes_gain(light, messages),
        "normalize": light_is_normalized(light),
        "casts_shadow": light.use_shadow,
        "visible_to_camera": obj.visible_camera,
        "name": obj.name,
        "linking": linking,
    }
    make = _laser if is_laser(light) else _SHAPES[light.type]
    return make(light, matrix, shared)


def _nodes_gain(light: Any, messages: Messages) -> np.ndarray | float:
    """What the light's nodes multiply its power with."""
    if node_tree(light) is None:
        return 1.0
    shader = surface(light)
    if shader is None:
        return 0.0
    if shader.node.type != "EMISSION":
        messages.add(named(light), f"{described(shader)} is not supported and is left out")
        return 1.0
    return emitted(shader, "Color", "Strength", named(light), messages)


# Blender's limit of an angle is pi in float32, a little more than pi.


def _point(light: Any, matrix: np.ndarray, shared: dict[str, Any]) -> PointLight:
    return PointLight(
        position=matrix[:3, 3], radius=light.shadow_soft_size, sphere=not light.use_soft_falloff, **shared
    )


def _spot(light: Any, matrix: np.ndarray, shared: dict[str, Any]) -> SpotLight:
    return SpotLight(
        light_to_world=matrix,
        radius=light.shadow_soft_size,
        sphere=not light.use_soft_falloff,
        angle=min(light.spot_size, np.pi),
        blend=light.spot_blend,
        **shared,
    )


def _laser(light: Any, matrix: np.ndarray, shared: dict[str, Any]) -> Laser:
    """A spot light that is switched to laser: its power is that of the beam, whatever the beam's radius."""
    chosen = light.cv_render
    return Laser(
        light_to_world=matrix,
        radius=chosen.beam_radius,
        length=chosen.length or np.inf,
        in_fog=chosen.in_fog,
        on_surfaces=chosen.on_surfaces,
        beam=chosen.beam,
        spot=chosen.spot,
        **shared | {"normalize": True},
    )


def _area(light: Any, matrix: np.ndarray, shared: dict[str, Any]) -> AreaLight:
    size_y = light.size_y if light.shape in ("RECTANGLE", "ELLIPSE") else light.size
    return AreaLight(
        light_to_world=matrix,
        size=(light.size, size_y),
        ellipse=light.shape in ("DISK", "ELLIPSE"),
        spread=min(light.spread, np.pi),
        **shared,
    )


def _sun(light: Any, matrix: np.ndarray, shared: dict[str, Any]) -> SunLight:
    return SunLight(direction=-matrix[:3, 2], angle=min(light.angle, np.pi), **shared)


_SHAPES = {"POINT": _point, "SPOT": _spot, "AREA": _area, "SUN": _sun}
