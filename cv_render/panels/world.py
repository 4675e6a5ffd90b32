# SPDX-License-Identifier: GPL-3.0-or-later
"""World properties: the background's nodes, and whether the camera sees it."""

from __future__ import annotations

import bpy

from .base import EnginePanel, draw_nodes, properties_layout, registration


class WorldPanel(EnginePanel):
    bl_context = "world"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.world is not None and super().poll(context)


class CVRENDER_WORLD_PT_surface(WorldPanel, bpy.types.Panel):
    bl_label = "Surface"

    def draw(self, context: bpy.types.Context) -> None:
        draw_nodes(properties_layout(self), context.world, "Surface", plain="color")


class CVRENDER_WORLD_PT_ray_visibility(WorldPanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and hasattr(context.world, "cycles_visibility")

    def draw(self, context: bpy.types.Context) -> None:
        properties_layout(self, animated=False).prop(context.world.cycles_visibility, "camera")


register, unregister = registration(CVRENDER_WORLD_PT_surface, CVRENDER_WORLD_PT_ray_visibility)
