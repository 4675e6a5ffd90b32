# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that say something of the surface: coordinates, attributes, normals, angles."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ...engine_core.shading import coordinates, fresnel, normal_map
from ...engine_core.shading.arithmetic import component, unit
from ...engine_core.shading.colour import blackbody
from ...engine_core.shading.coordinates import (
    BACK,
    GENERATED,
    GEOMETRIC,
    NORMAL,
    OBJECT,
    OBJECT_TO_WORLD,
    POSITION,
    TOWARDS_VIEWER,
)
from ...engine_core.shading.values import Attribute, OfSurface, Value, compute

if TYPE_CHECKING:
    from .nodes import Node

ZERO, ONE, NULL = np.float32(0), np.float32(1), np.zeros((3, 1), np.float32)


def part(value: Value, first: int, count: int) -> Value:
    """A vector of a wider array."""
    return compute(lambda a: a[first : first + count], value)


def number(value: Value, which: int) -> Value:
    """A number of a wider array."""
    return compute(partial(component, which), value)


def _own_value(node: Node) -> np.ndarray:
    value = np.array(node.socket.socket.default_value, np.float32)
    return value[:3, None] if value.ndim else value


def _texture_coordinate(node: Node) -> Any:
    if node.options.from_instancer and node.output in ("Generated", "UV"):
        node.tell("coordinates of the instancer are not supported yet, they are the object's own")
    if node.output == "Object" and node.options.object is not None:
        inverse = np.linalg.inv(_regular(node.options.object.matrix_world))
        return compute(partial(coordinates.transform, inverse[:3]), POSITION)
    if node.output in ("Camera", "Window"):
        node.tell(f'"{node.output}" coordinates are not supported yet, they are 0')
        return NULL
    return {
        "Generated": lambda: GENERATED,
        "Normal": lambda: compute(coordinates.normal_to_object, OBJECT_TO_WORLD, NORMAL),
        "UV": lambda: coordinates.uv(""),
        "Object": lambda: OBJECT,
        "Reflection": lambda: compute(coordinates.reflection, TOWARDS_VIEWER, NORMAL),
    }[node.output]()


def _regular(matrix: Any) -> np.ndarray:
    """(4, 4), the identity in place of what has no inverse."""
    matrix = np.array(matrix, np.float64)
    return matrix if abs(np.linalg.det(matrix)) > 1e-30 else np.eye(4)


def _uv_map(node: Node) -> Any:
    if node.options.from_instancer:
        node.tell("coordinates of the instancer are not supported yet, they are the object's own")
    return coordinates.uv(node.options.uv_map)


def _attribute(node: Node) -> Any:
    options = node.options
    if options.attribute_type != "GEOMETRY" or not options.attribute_name:
        node.tell(f"attributes of {options.attribute_type.lower()} are not supported yet, they are 0")
        return ZERO if node.output in ("Fac", "Factor", "Alpha") else NULL
    found = node.share(lambda: Attribute(f"attribute:{options.attribute_name}", 5))
    if node.output in ("Color", "Vector"):
        return part(found, 0, 3)
    return number(found, 3 if node.output == "Alpha" else 4)


def _vertex_colour(node: Node) -> Any:
    found = node.share(lambda: Attribute(f"color:{node.options.layer_name}", 4))
    return part(found, 0, 3) if node.output == "Color" else number(found, 3)


_GEOMETRY = {
    "Position": lambda: POSITION,
    "Normal": lambda: NORMAL,
    "Tangent": lambda: coordinates.radial_tangent("Z"),
    "True Normal": lambda: GEOMETRIC,
    "Incoming": lambda: TOWARDS_VIEWER,
    "Backfacing": lambda: BACK,
}


def _geometry(node: Node) -> Any:
    if node.output in _GEOMETRY:
        return _GEOMETRY[node.output]()
    node.tell(f'"{node.output}" is not supported yet, it is 0')
    return NULL if node.output == "Parametric" else ZERO


_RAYS = {
    "Is Camera Ray": OfSurface(lambda points: np.float32(points.ray == "camera")),
    "Is Shadow Ray": OfSurface(lambda points: np.float32(points.ray == "shadow")),
}


def _light_path(node: Node) -> Any:
    if node.output in ("Ray Length", "Ray Depth", "Transparent Depth"):
        node.tell(f'"{node.output}" is not supported yet, it is 0')
    return _RAYS.get(node.output, ZERO)


def _fresnel(node: Node) -> Any:
    return compute(fresnel.fresnel, node["IOR"], node.normal() or NORMAL, TOWARDS_VIEWER, BACK)


def _layer_weight(node: Node) -> Any:
    blend, normal = node["Blend"], node.normal() or NORMAL
    if node.output == "Fresnel":
        return compute(fresnel.layer_fresnel, blend, normal, TOWARDS_VIEWER, BACK)
    return compute(fresnel.facing, blend, normal, TOWARDS_VIEWER)


def _normal_map(node: Node) -> Any:
    options = node.options
    colour, strength = node["Color"], node["Strength"]
    if getattr(options, "convention", "OPENGL") == "DIRECTX":
        colour = compute(lambda c: np.stack([c[0], 1 - c[1], c[2]]), colour)
    if options.space == "TANGENT":
        frame = normal_map.tangent_frame(options.uv_map)
        return compute(normal_map.in_tangent_space, colour, strength, frame, OBJECT_TO_WORLD, NORMAL, BACK)
    if options.space.startswith("BLENDER"):
        colour = compute(lambda c: np.stack([c[0], 1 - c[1], 1 - c[2]]), colour)
    bend = partial(normal_map.in_space, options.space.endswith("OBJECT"))
    return compute(bend, colour, strength, OBJECT_TO_WORLD, NORMAL, BACK)


def _bump(node: Node) -> Any:
    node.tell("bump is not supported yet, the surface is smooth")
    return node.normal() or NORMAL


def _tangent(node: Node) -> Any:
    if node.options.direction_type == "UV_MAP":
        return normal_map.uv_tangent(node.options.uv_map)
    return coordinates.radial_tangent(node.options.axis)


def _normal(node: Node) -> Any:
    direction = unit(np.array(node.options.outputs[0].default_value, np.float32)[:, None])
    if node.output == "Normal":
        return direction
    return compute(lambda n: (unit(n) * direction).sum(axis=0), node["Normal"])


_WORLD_TO = {
    ("VECTOR", "OBJECT"): coordinates.to_object,
    ("NORMAL", "OBJECT"): coordinates.normal_to_object,
}
_TO_WORLD = {("VECTOR", "OBJECT"): coordinates.to_world, ("NORMAL", "OBJECT"): coordinates.normal_to_world}


def _vector_transform(node: Node) -> Any:
    options, value = node.options, node["Vector"]
    kind, source, target = options.vector_type, options.convert_from, options.convert_to
    for space, table in ((source, _TO_WORLD), (target, _WORLD_TO)):
        if source == target or space == "WORLD":
            continue
        if (kind, space) not in table:
            node.tell(
                f"{kind.lower()}s between {source} and {target} are not supported yet and stay as they are"
            )
            return node["Vector"]
        value = compute(table[kind, space], OBJECT_TO_WORLD, value)
    return value


def _blackbody(node: Node) -> Any:
    return compute(blackbody, node["Temperature"])


NODES = {
    "VALUE": _own_value,
    "RGB": _own_value,
    "TEX_COORD": _texture_coordinate,
    "UVMAP": _uv_map,
    "ATTRIBUTE": _attribute,
    "VERTEX_COLOR": _vertex_colour,
    "NEW_GEOMETRY": _geometry,
    "LIGHT_PATH": _light_path,
    "FRESNEL": _fresnel,
    "LAYER_WEIGHT": _layer_weight,
    "NORMAL_MAP": _normal_map,
    "BUMP": _bump,
    "TANGENT": _tangent,
    "NORMAL": _normal,
    "VECT_TRANSFORM": _vector_transform,
    "BLACKBODY": _blackbody,
}
