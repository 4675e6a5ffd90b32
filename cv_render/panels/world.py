# SPDX-License-Identifier: GPL-3.0-or-later
"""World properties: the nodes of background and volume, and whether the camera sees the background."""

from __future__ import annotations

import bpy

from ..versions import node_tree
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


class CVRENDER_WORLD_PT_volume(WorldPanel, bpy.types.Panel):
    bl_label = "Volume"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and node_tree(context.world) is not None

    def draw(self, context: bpy.types.Context) -> None:
        draw_nodes(properties_layout(self), context.world, "Volume")


class CVRENDER_WORLD_PT_ray_visibility(WorldPanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and hasattr(context.world, "cycles_visibility")

    def draw(self, context: bpy.types.Context) -> None:
        properties_layout(self, animated=False).prop(context.world.cycles_visibility, "camera")


register, unregister = registration(
    CVRENDER_WORLD_PT_surface, CVRENDER_WORLD_PT_volume, CVRENDER_WORLD_PT_ray_visibility
)
