# SPDX-License-Identifier: GPL-3.0-or-later
"""Material properties: the nodes of the surface, as for Cycles."""

from __future__ import annotations

import bpy

from .base import EnginePanel, draw_nodes, properties_layout, registration


class CVRENDER_MATERIAL_PT_surface(EnginePanel, bpy.types.Panel):
    bl_label = "Surface"
    bl_context = "material"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        material = context.material
        return material is not None and not material.grease_pencil and super().poll(context)

    def draw(self, context: bpy.types.Context) -> None:
        draw_nodes(properties_layout(self), context.material, "Surface", plain="diffuse_color")


register, unregister = registration(CVRENDER_MATERIAL_PT_surface)
