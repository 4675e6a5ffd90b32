# SPDX-License-Identifier: GPL-3.0-or-later
"""What all panels share: where they stand, and that they show for this engine only."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ..engine import ENGINE
from ..versions import nodes_are_optional


class EnginePanel:
    """A section of the Properties editor."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES


def properties_layout(panel: bpy.types.Panel, animated: bool = True) -> bpy.types.UILayout:
    """A column of names at the left and values at the right."""
    layout = panel.layout
    layout.use_property_split = True
    layout.use_property_decorate = animated
    return layout.column()


def draw_nodes(layout: bpy.types.UILayout, datablock: Any, input_name: str, plain: str | None = None) -> None:
    """The nodes behind an input of the output that Cycles would use; ``plain``: a property to go without."""
    if nodes_are_optional() and not datablock.use_nodes:
        layout.prop(datablock, "use_nodes", icon="NODETREE", toggle=True)
    elif datablock.node_tree is not None:
        output = datablock.node_tree.get_output_node("CYCLES")
        if output is None:
            layout.label(text="No output node")
        else:
            layout.template_node_view(datablock.node_tree, output, output.inputs[input_name])
        return
    if plain:
        layout.prop(datablock, plain)


def registration(*classes: type) -> tuple[Callable[[], None], Callable[[], None]]:
    """The functions ``register`` and ``unregister`` of a module of panels."""

    def register() -> None:
        for cls in classes:
            bpy.utils.register_class(cls)

    def unregister() -> None:
        for cls in reversed(classes):
            bpy.utils.unregister_class(cls)

    return register, unregister
