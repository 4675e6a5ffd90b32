# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials: the nodes of Cycles, as the diffuse and emitting surfaces that the engine knows."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core import Material
from ..versions import node_tree
from .messages import Messages, named
from .nodes import Socket, constant, described, output_node, surface

BASE_COLOURS = ("Base Color", "Color")
BLACK = np.zeros(3)


class Materials:
    """The materials that objects use, each exported once; number 0 is the grey of objects without any."""

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._numbers: dict[int, int] = {}
        self.exported = [Material(name="No material")]

    def number(self, material: Any | None) -> int:
        """The index of a Blender material in ``exported``."""
        if material is None:
            return 0
        pointer = material.as_pointer()
        if pointer not in self._numbers:
            self._numbers[pointer] = len(self.exported)
            self.exported.append(export_material(material, self._messages))
        return self._numbers[pointer]


def export_material(material: Any, messages: Messages) -> Material:
    """Reflectance and emission of a Blender material; what is left out goes to ``messages``."""
    if node_tree(material) is None:
        return Material(np.array(material.diffuse_color[:3]), name=material.name)
    owner = named(material)
    output = output_node(material)
    for name in ("Volume", "Displacement"):
        if output is not None and output.inputs[name].is_linked:
            messages.add(owner, f"{name.lower()} is not supported yet and is left out")
    reflectance, emission = _closure(surface(material), owner, messages)
    return Material(np.maximum(reflectance, 0.0), emission, material.name)


def _closure(shader: Socket | None, owner: str, messages: Messages) -> tuple[np.ndarray, np.ndarray]:
    """Reflectance and emission, (3,) each, of whatever closure a socket carries."""
    if shader is None or not shader.socket.is_output:
        return BLACK, BLACK
    kind = shader.node.type

    if kind == "EMISSION":
        return BLACK, emitted(shader, "Color", "Strength", owner, messages)
    if kind == "ADD_SHADER":
        first, second = (_closure(s.source(), owner, messages) for s in shader.inputs())
        return first[0] + second[0], first[1] + second[1]
    if kind == "MIX_SHADER":
        factor, *shaders = shader.inputs()
        weight = np.clip(constant(factor, owner, messages), 0.0, 1.0)
        first, second = (_closure(s.source(), owner, messages) for s in shaders)
        return tuple((1 - weight) * a + weight * b for a, b in zip(first, second, strict=True))

    emission = BLACK
    if kind == "BSDF_PRINCIPLED":
        emission = emitted(shader, "Emission Color", "Emission Strength", owner, messages)
    colour = shader.input(*BASE_COLOURS)
    if kind == "HOLDOUT" or colour is None:
        messages.add(owner, f"{described(shader)} is not supported yet, it is rendered black")
        return BLACK, emission
    if kind != "BSDF_DIFFUSE":
        messages.add(owner, f"{described(shader)} is rendered as Diffuse BSDF of its base colour")
    else:
        _check_diffuse(shader, owner, messages)
    return constant(colour, owner, messages), emission


def emitted(shader: Socket, colour: str, strength: str, owner: str, messages: Messages) -> np.ndarray:
    """(3,) colour times strength of a node that emits."""
    factor = constant(shader.input(strength), owner, messages)
    if not factor.any():
        return BLACK
    return constant(shader.input(colour), owner, messages) * factor


def _check_diffuse(shader: Socket, owner: str, messages: Messages) -> None:
    if constant(shader.input("Roughness"), owner, messages) > 0:
        messages.add(owner, f"roughness of {described(shader)} is not supported yet, it is Lambertian")
    if shader.input("Normal").socket.is_linked:
        messages.add(owner, f"normal of {described(shader)} is not supported yet, it is the mesh's own")
