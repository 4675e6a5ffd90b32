# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that compute something of their inputs alone."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ...engine_core.shading import arithmetic, colour, coordinates, ramps
from ...engine_core.shading.arithmetic import as_vector, component, saturate
from ...engine_core.shading.values import compute
from .input_nodes import number, part

if TYPE_CHECKING:
    from .nodes import Node

FACTOR = ("Fac", "Factor")


def _clamped(value: Any, wanted: bool) -> Any:
    return compute(saturate, value) if wanted else value


def _math(node: Node) -> Any:
    operation = arithmetic.MATH[node.options.operation]
    value = compute(operation, *node.values("Value", "Value_001", "Value_002"))
    return _clamped(value, node.options.use_clamp)


def _vector_math(node: Node) -> Any:
    operation = arithmetic.VECTOR_MATH[node.options.operation]
    return compute(operation, *node.values("Vector", "Vector_001", "Vector_002", "Scale"))


def _mix(node: Node) -> Any:
    options = node.options
    kind = {"FLOAT": "Float", "VECTOR": "Vector", "RGBA": "Color"}.get(options.data_type)
    if kind is None:
        node.tell(f"mixing {options.data_type.lower()}s is not supported yet, it is 0")
        return np.zeros((3, 1), np.float32)
    uniform = kind != "Vector" or options.factor_mode == "UNIFORM"
    factor = _clamped(node["Factor_Float" if uniform else "Factor_Vector"], options.clamp_factor)
    blend = colour.BLEND[options.blend_type] if kind == "Color" else arithmetic.mix
    value = compute(blend, factor, node[f"A_{kind}"], node[f"B_{kind}"])
    return _clamped(value, kind == "Color" and options.clamp_result)


def _mix_rgb(node: Node) -> Any:
    blend = colour.BLEND[node.options.blend_type]
    value = compute(blend, _clamped(node[FACTOR], True), node["Color1"], node["Color2"])
    return _clamped(value, node.options.use_clamp)


def _clamp(node: Node) -> Any:
    clip = arithmetic.clip_range if node.options.clamp_type == "RANGE" else arithmetic.clip
    return compute(clip, node["Value"], node["Min"], node["Max"])


def _map_range(node: Node) -> Any:
    options = node.options
    smooth = options.interpolation_type.startswith("SMOOTH")
    convert = partial(arithmetic.map_range, options.interpolation_type, options.clamp and not smooth)
    ends = ("From Min", "From Max", "To Min", "To Max", "Steps")
    if options.data_type == "FLOAT_VECTOR":
        names = ("Vector", *(f"{end.replace(' ', '_')}_FLOAT3" for end in ends))
    else:
        names = ("Value", *ends)
    return compute(convert, *node.values(*names))


def _colour_ramp(node: Node) -> Any:
    def look_up() -> Any:
        ramp = node.options.color_ramp
        places = np.linspace(0, 1, ramps.ENTRIES)
        table = np.array([ramp.evaluate(x) for x in places], np.float32).T
        smooth = ramp.interpolation != "CONSTANT"
        return compute(partial(ramps.look_up, table, smooth), node[FACTOR])

    found = node.share(look_up)
    return part(found, 0, 3) if node.output == "Color" else number(found, 3)


def _curves(node: Node, value: str, channels: int) -> Any:
    mapping = node.options.mapping
    mapping.initialize()
    every = list(mapping.curves)
    start = min(curve.points[0].location[0] for curve in every)
    end = max(curve.points[-1].location[0] for curve in every)
    places = np.linspace(start, end, ramps.ENTRIES)
    if len(every) == 4:  # the combined curve comes first
        places = [mapping.evaluate(every[3], x) for x in places]
    table = [[mapping.evaluate(curve, x) for x in places] for curve in every[:channels]]
    convert = partial(ramps.curves, np.array(table, np.float32), start, end, mapping.extend == "EXTRAPOLATED")
    return compute(convert, node[FACTOR], node[value])


def _separate(kind: str, node: Node) -> Any:
    name = "Vector" if kind == "XYZ" else ("Color", "Image")
    parts = compute(colour.FROM_RGB.get(kind, colour.unchanged), node[name])
    return compute(partial(component, node.output_index), parts)


def _combine(kind: str, node: Node) -> Any:
    parts = compute(as_vector, *(node.graph.value(socket) for socket in node.socket.inputs()))
    return compute(colour.TO_RGB.get(kind, colour.unchanged), parts)


def _hue_saturation(node: Node) -> Any:
    inputs = (node["Hue"], node["Saturation"], node["Value"], node[FACTOR], node["Color"])
    return compute(colour.hue_saturation, *inputs)


def _mapping(node: Node) -> Any:
    convert = partial(coordinates.mapping, node.options.vector_type)
    location = node["Location"] if node.options.vector_type in ("POINT", "TEXTURE") else np.zeros((3, 1))
    return compute(convert, node["Vector"], location, node["Rotation"], node["Scale"])


_AXES = {"X_AXIS": (1.0, 0.0, 0.0), "Y_AXIS": (0.0, 1.0, 0.0), "Z_AXIS": (0.0, 0.0, 1.0)}


def _vector_rotate(node: Node) -> Any:
    options = node.options
    if options.rotation_type == "EULER_XYZ":
        turn = partial(coordinates.rotate_by_euler, options.invert)
        return compute(turn, node["Vector"], node["Center"], node["Rotation"])
    axis = _AXES.get(options.rotation_type) or node["Axis"]
    turn = partial(coordinates.rotate_about, options.invert)
    return compute(turn, node["Vector"], node["Center"], axis, node["Angle"])


NODES = {
    "MATH": _math,
    "VECT_MATH": _vector_math,
    "MIX": _mix,
    "MIX_RGB": _mix_rgb,
    "CLAMP": _clamp,
    "MAP_RANGE": _map_range,
    "VALTORGB": _colour_ramp,
    "CURVE_RGB": lambda node: _curves(node, "Color", 3),
    "CURVE_VEC": lambda node: _curves(node, "Vector", 3),
    "CURVE_FLOAT": lambda node: _curves(node, "Value", 1),
    "SEPXYZ": partial(_separate, "XYZ"),
    "COMBXYZ": partial(_combine, "XYZ"),
    "SEPARATE_COLOR": lambda node: _separate(node.options.mode, node),
    "COMBINE_COLOR": lambda node: _combine(node.options.mode, node),
    "SEPRGB": partial(_separate, "RGB"),
    "COMBRGB": partial(_combine, "RGB"),
    "SEPHSV": partial(_separate, "HSV"),
    "COMBHSV": partial(_combine, "HSV"),
    "RGBTOBW": lambda node: compute(colour.luminance, node["Color"]),
    "INVERT": lambda node: compute(colour.invert, node[FACTOR], node["Color"]),
    "GAMMA": lambda node: compute(colour.gamma, node["Color"], node["Gamma"]),
    "BRIGHTCONTRAST": lambda node: compute(
        colour.bright_contrast, node["Color"], node[("Bright", "Brightness")], node["Contrast"]
    ),
    "HUE_SAT": _hue_saturation,
    "MAPPING": _mapping,
    "VECTOR_ROTATE": _vector_rotate,
}
