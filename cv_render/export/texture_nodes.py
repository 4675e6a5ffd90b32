# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that are textures: images, checkers and gradients."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from ...engine_core.shading import coordinates, textures
from ...engine_core.shading.arithmetic import replicated
from ...engine_core.shading.coordinates import GENERATED, NORMAL, OBJECT_TO_WORLD
from ...engine_core.shading.values import compute
from .input_nodes import number, part

if TYPE_CHECKING:
    from .nodes import Node


def _image(node: Node) -> Any:
    texel = node.share(lambda: _texel(node))
    return part(texel, 0, 3) if node.output == "Color" else number(texel, 3)


def _texel(node: Node) -> Any:
    """(4, N) colour and alpha."""
    options = node.options
    image = node.graph.image(options.image)
    # As in Cycles, colours stay multiplied with alpha where nobody asks for alpha.
    opaque = not any(output.identifier == "Alpha" and output.is_linked for output in options.outputs)
    interpolation = "Cubic" if options.interpolation == "Smart" else options.interpolation
    look = (image, interpolation, options.extension, opaque)
    vector = node.get("Vector", coordinates.uv(""))
    if options.projection == "BOX":
        normal = compute(coordinates.normal_to_object, OBJECT_TO_WORLD, NORMAL)
        return compute(partial(textures.box_texture, *look, options.projection_blend), vector, normal)
    vector = compute(textures.PROJECTIONS[options.projection], vector)
    return compute(partial(textures.image_texture, *look), vector)


def _checker(node: Node) -> Any:
    dark = node.share(lambda: compute(textures.checker, _generated(node), node["Scale"]))
    if node.output != "Color":
        return dark
    return compute(lambda f, a, b: np.where(f == 1, a, b), dark, node["Color1"], node["Color2"])


def _gradient(node: Node) -> Any:
    kind = node.options.gradient_type
    grey = node.share(lambda: compute(partial(textures.gradient, kind), _generated(node)))
    return compute(replicated, grey) if node.output == "Color" else grey


def _generated(node: Node) -> Any:
    return node.get("Vector", GENERATED)


NODES = {"TEX_IMAGE": _image, "TEX_CHECKER": _checker, "TEX_GRADIENT": _gradient}
