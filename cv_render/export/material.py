# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials: the node graphs of Cycles as closures of expressions."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from ...engine_core import Material
from ...engine_core.shading.closures import Add, Closure, Diffuse, Emission, Mix
from ...engine_core.shading.textures import ImagePixels
from ...engine_core.shading.values import Value, attributes_of
from ..versions import node_tree
from .messages import Messages, named
from .nodes import Graph, Socket, constant, output_node, surface
from .shader_nodes import closure
from .volume import Fog, read_fog

BLACK = np.zeros(3)


class Materials:
    """The materials that objects use, each exported once; number 0 is the grey of objects without any.

    fogs : of each, what its Volume is fed with, or None. surfaces : of each, False if it is volume alone.
    """

    def __init__(self, messages: Messages) -> None:
        self._messages = messages
        self._numbers: dict[int, int] = {}
        self._images: dict[int, ImagePixels] = {}
        self.exported = [Material(name="No material")]
        self.fogs: list[Fog | None] = [None]
        self.surfaces = [True]

    def number(self, material: Any | None) -> int:
        """The index of a Blender material in ``exported``."""
        if material is None:
            return 0
        pointer = material.as_pointer()
        if pointer not in self._numbers:
            self._numbers[pointer] = len(self.exported)
            self.exported.append(export_material(material, self._messages, self._images))
            self.fogs.append(fog := read_fog(material, self._messages, self._images))
            # As in Cycles, what only has a volume has no surface, rather than a black one.
            self.surfaces.append(fog is None or surface(material) is not None)
        return self._numbers[pointer]

    def attributes(self, numbers: Iterable[int]) -> frozenset[str]:
        """Names of what a mesh must have at its corners if it has the materials of these ``numbers``."""
        closures = (self.exported[number].surface for number in numbers)
        return frozenset(name for shader in closures for name in attributes_of(shader))


def export_material(
    material: Any, messages: Messages, images: dict[int, ImagePixels] | None = None
) -> Material:
    """The surface of a Blender material; what is left out goes to ``messages``."""
    if node_tree(material) is None:
        return Material(np.array(material.diffuse_color[:3]), name=material.name)
    owner = named(material)
    output = output_node(material)
    if output is None:
        return Material(0.0, name=material.name)
    if output.inputs["Displacement"].is_linked:
        messages.add(owner, "displacement is not supported yet and is left out")
    shader = closure(Graph(owner, messages, images), Socket(output.inputs["Surface"]))
    plain = _lambertian(shader)
    if plain is None:
        return Material(surface=shader, name=material.name)
    reflectance, emission = plain
    return Material(np.maximum(reflectance, 0.0), emission, material.name)


def _lambertian(surface: Closure | None) -> tuple[np.ndarray, np.ndarray] | None:
    """Reflectance and emission, (3,) each, of what is Lambertian and does not vary; None of all else."""
    if surface is None:
        return BLACK, BLACK
    if isinstance(surface, Diffuse):
        colour = _number_or_colour(surface.color)
        plain = colour is not None and surface.normal is None and not _varies_or_any(surface.roughness)
        return (colour, BLACK) if plain else None
    if isinstance(surface, Emission):
        colour, strength = _number_or_colour(surface.color), _number_or_colour(surface.strength)
        return None if colour is None or strength is None else (BLACK, colour * strength)
    if isinstance(surface, Add | Mix):
        first, second = _lambertian(surface.first), _lambertian(surface.second)
        factor = _number_or_colour(surface.factor) if isinstance(surface, Mix) else None
        if first is None or second is None or (isinstance(surface, Mix) and factor is None):
            return None
        a, b = (1.0, 1.0) if factor is None else (1 - factor, factor)
        return a * first[0] + b * second[0], a * first[1] + b * second[1]
    return None


def _number_or_colour(value: Any) -> np.ndarray | None:
    """(3,) of a constant; None of what varies."""
    return None if isinstance(value, Value) else np.broadcast_to(np.asarray(value, np.float64).ravel(), 3)


def _varies_or_any(value: Any) -> bool:
    return isinstance(value, Value) or bool(np.any(value))


def emitted(shader: Socket, colour: str, strength: str, owner: str, messages: Messages) -> np.ndarray:
    """(3,) colour times strength of a node that emits, the same everywhere."""
    factor = constant(shader.input(strength), owner, messages)
    if not factor.any():
        return BLACK
    return constant(shader.input(colour), owner, messages) * factor
