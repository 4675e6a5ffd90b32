# SPDX-License-Identifier: GPL-3.0-or-later
"""Material properties: the nodes of the surface and the volume, as for Cycles."""

from __future__ import annotations

import bpy

from ..versions import node_tree
from .base import EnginePanel, draw_nodes, properties_layout, registration


class MaterialPanel(EnginePanel):
    bl_context = "material"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        material = context.material
        return material is not None and not material.grease_pencil and super().poll(context)


class CVRENDER_MATERIAL_PT_surface(MaterialPanel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context: bpy.types.Context) -> None:
        draw_nodes(properties_layout(self), context.material, "Surface", plain="diffuse_color")


class CVRENDER_MATERIAL_PT_volume(MaterialPanel, bpy.types.Panel):
    bl_label = "Volume"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and node_tree(context.material) is not None

    def draw(self, context: bpy.types.Context) -> None:
        draw_nodes(properties_layout(self), context.material, "Volume")


register, unregister = registration(CVRENDER_MATERIAL_PT_surface, CVRENDER_MATERIAL_PT_volume)
