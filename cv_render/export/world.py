# SPDX-License-Identifier: GPL-3.0-or-later
"""The world: light of one colour from everywhere."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...engine_core import World
from ..versions import node_tree
from .material import emitted
from .messages import Messages, named
from .nodes import described, output_node, surface


def export_world(world: Any | None, messages: Messages) -> World:
    """A Blender world's background; no world is black."""
    if world is None:
        return World(name="No world")
    visibility = getattr(world, "cycles_visibility", None)
    visible = visibility.camera if visibility else True
    return World(_radiance(world, messages), visible, world.name)


def _radiance(world: Any, messages: Messages) -> np.ndarray:
    if node_tree(world) is None:
        return np.array(world.color)
    owner = named(world)
    output = output_node(world)
    if output is not None and output.inputs["Volume"].is_linked:
        messages.add(owner, "volume is not supported yet and is left out")
    shader = surface(world)
    if shader is None:
        return np.zeros(3)
    if shader.node.type not in ("BACKGROUND", "EMISSION"):
        messages.add(owner, f"{described(shader)} is not supported, the world is black")
        return np.zeros(3)
    return emitted(shader, "Color", "Strength", owner, messages)
