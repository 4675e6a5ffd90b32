# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that are closures: BSDFs, emission, and what mixes them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...engine_core.shading import coordinates, fresnel
from ...engine_core.shading.arithmetic import saturate
from ...engine_core.shading.closures import (
    Add,
    Closure,
    Diffuse,
    Emission,
    Glossy,
    Holdout,
    Mix,
    Principled,
    Translucent,
    Transparent,
)
from ...engine_core.shading.coordinates import BACK, NORMAL, TOWARDS_VIEWER
from ...engine_core.shading.values import Value, compute
from .nodes import Graph, Node, Socket, described

BASE_COLOURS = ("Base Color", "Color")


def closure(graph: Graph, socket: Socket) -> Closure | None:
    """What a closure's input is fed with; None is black."""
    source = socket.source()
    if not source.socket.is_output:
        return None
    if source.socket.type != "SHADER":
        # Cycles takes a colour for emission.
        return Emission(graph.value(socket), 1.0)
    node = Node(graph, source)
    return SHADERS.get(source.node.type, _unknown)(node)


def _unknown(node: Node) -> Closure | None:
    if node.socket.input(*BASE_COLOURS) is None:
        node.graph.tell(f"{described(node.socket)} is not supported yet, it is rendered black")
        return None
    return _drawn_as_diffuse(node)


def _drawn_as_diffuse(node: Node) -> Closure:
    node.graph.tell(f"{described(node.socket)} is rendered as Diffuse BSDF of its base colour")
    return Diffuse(node[BASE_COLOURS], normal=node.normal() if node.socket.input("Normal") else None)


def _is(value: Any, number: float) -> bool:
    """Whether a value is one number, everywhere."""
    return not isinstance(value, Value) and bool((np.asarray(value) == number).all())


def _mix(node: Node) -> Closure | None:
    factor, first, second = node.socket.inputs()
    weight = compute(saturate, node.graph.value(factor))
    if _is(weight, 0.0):
        return closure(node.graph, first)
    if _is(weight, 1.0):
        return closure(node.graph, second)
    parts = closure(node.graph, first), closure(node.graph, second)
    return None if parts == (None, None) else Mix(weight, *parts)


def _add(node: Node) -> Closure | None:
    parts = [part for s in node.socket.inputs() if (part := closure(node.graph, s)) is not None]
    return Add(*parts) if len(parts) == 2 else next(iter(parts), None)


def _emission(node: Node) -> Closure | None:
    strength = node["Strength"]
    return None if _is(strength, 0.0) else Emission(node["Color"], strength)


def _diffuse(node: Node) -> Closure:
    return Diffuse(node["Color"], node["Roughness"], node.normal())


def _tangent(node: Node, anisotropy: Any) -> Any:
    """What an anisotropic closure is turned by; None where it makes no difference."""
    if _is(anisotropy, 0.0):
        return None
    return node.get("Tangent", coordinates.radial_tangent("Z"))


def _glossy(node: Node) -> Closure:
    anisotropy = node["Anisotropy"]
    return Glossy(
        node["Color"],
        node["Roughness"],
        node.options.distribution,
        anisotropy,
        node["Rotation"],
        node.normal(),
        _tangent(node, anisotropy),
    )


def _glass(node: Node) -> Closure:
    """Its reflection, which is what there is of glass without bounces."""
    node.graph.tell(f"{described(node.socket)} is rendered without its refraction")
    reflected = compute(fresnel.fresnel, node["IOR"], node.normal() or NORMAL, TOWARDS_VIEWER, BACK)
    colour = compute(np.multiply, node["Color"], reflected)
    return Glossy(colour, node["Roughness"], node.options.distribution, normal=node.normal())


def _refraction(node: Node) -> None:
    node.graph.tell(f"{described(node.socket)} is not supported yet, it is rendered black")


def _metallic(node: Node) -> Closure:
    """A metal of base colour and edge tint is what Principled has for metals."""
    options = node.options
    anisotropy = node["Anisotropy"]
    if options.fresnel_type == "F82":
        base, tint = node["Base Color"], node["Edge Tint"]
    else:
        node.graph.tell(f"{described(node.socket)} is rendered with the colour that it has head-on")
        base, tint = compute(_conductor, node["IOR"], node["Extinction"]), np.ones((3, 1), np.float32)
    return Principled(
        base,
        metallic=1.0,
        roughness=node["Roughness"],
        normal=node.normal(),
        specular_tint=tint,
        anisotropic=anisotropy,
        anisotropic_rotation=node["Rotation"],
        tangent=_tangent(node, anisotropy),
        distribution=options.distribution,
    )


def _conductor(n: np.ndarray, k: np.ndarray) -> np.ndarray:
    """Reflectance of a metal at normal incidence."""
    return ((n - 1) ** 2 + k * k) / ((n + 1) ** 2 + k * k)


LEFT_OUT = {
    "Transmission Weight": "transmission",
    "Subsurface Weight": "subsurface scattering",
    "Sheen Weight": "sheen",
    "Thin Film Thickness": "thin film",
}
"""What Principled can't do yet."""


def _principled(node: Node) -> Closure:
    for name, what in LEFT_OUT.items():
        if node.socket.input(name) is not None and not _is(node[name], 0.0):
            node.tell(f"{what} is not supported yet, it is rendered as if its {name} were 0")
    anisotropic = node["Anisotropic"]
    rough = node.socket.input("Diffuse Roughness") is not None  # from 4.3 on
    return Principled(
        node["Base Color"],
        metallic=node["Metallic"],
        roughness=node["Roughness"],
        ior=node["IOR"],
        alpha=node["Alpha"],
        normal=node.normal(),
        diffuse_roughness=node["Diffuse Roughness"] if rough else 0.0,
        specular_ior_level=node["Specular IOR Level"],
        specular_tint=node["Specular Tint"],
        anisotropic=anisotropic,
        anisotropic_rotation=node["Anisotropic Rotation"],
        tangent=_tangent(node, anisotropic),
        coat_weight=node["Coat Weight"],
        coat_roughness=node["Coat Roughness"],
        coat_ior=node["Coat IOR"],
        coat_tint=node["Coat Tint"],
        coat_normal=node.normal("Coat Normal"),
        emission_color=node["Emission Color"],
        emission_strength=node["Emission Strength"],
        distribution=node.options.distribution,
    )


SHADERS: dict[str, Callable[[Node], Closure | None]] = {
    "MIX_SHADER": _mix,
    "ADD_SHADER": _add,
    "EMISSION": _emission,
    "BACKGROUND": _emission,
    "BSDF_DIFFUSE": _diffuse,
    "BSDF_TRANSLUCENT": lambda node: Translucent(node["Color"], node.normal()),
    "BSDF_TRANSPARENT": lambda node: Transparent(node["Color"]),
    "HOLDOUT": lambda node: Holdout(),
    "BSDF_GLOSSY": _glossy,
    "BSDF_ANISOTROPIC": _glossy,
    "BSDF_GLASS": _glass,
    "BSDF_REFRACTION": _refraction,
    "BSDF_METALLIC": _metallic,
    "BSDF_PRINCIPLED": _principled,
}
"""By Blender's node type; another that has a colour is drawn as diffuse."""
