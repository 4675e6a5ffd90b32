# SPDX-License-Identifier: GPL-3.0-or-later
"""Light properties, in the order that Cycles has them."""

from __future__ import annotations

import bpy

from ..properties import is_laser
from .base import EnginePanel, draw_nodes, properties_layout, registration


class LightPanel(EnginePanel):
    bl_context = "data"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.light is not None and super().poll(context)


class CVRENDER_LIGHT_PT_light(LightPanel, bpy.types.Panel):
    bl_label = "Light"

    def draw(self, context: bpy.types.Context) -> None:
        light = context.light
        self.layout.row().prop(light, "type", expand=True)
        column = properties_layout(self)
        if hasattr(light, "use_temperature"):
            row = column.row(align=True, heading="Temperature")
            row.prop(light, "use_temperature", text="")
            value = row.row()
            value.active = light.use_temperature
            value.prop(light, "temperature", text="")
        column.prop(light, "color")
        column.separator()
        column.prop(light, "energy")
        for name in ("exposure", "normalize"):
            if hasattr(light, name) and not (name == "normalize" and is_laser(light)):
                column.prop(light, name)
        if not is_laser(light):
            column.separator()
            self._draw_size(column, light)
        column.separator()
        column.prop(light, "use_shadow", text="Cast Shadow")
        if context.object is not None:
            column.prop(context.object, "visible_camera", text="Visible to Camera")

    @staticmethod
    def _draw_size(column: bpy.types.UILayout, light: bpy.types.Light) -> None:
        if light.type in {"POINT", "SPOT"}:
            column.prop(light, "shadow_soft_size", text="Radius")
            column.prop(light, "use_soft_falloff")
        elif light.type == "SUN":
            column.prop(light, "angle")
        elif light.type == "AREA":
            column.prop(light, "shape")
            if light.shape in {"SQUARE", "DISK"}:
                column.prop(light, "size")
            else:
                sizes = column.column(align=True)
                sizes.prop(light, "size", text="Size X")
                sizes.prop(light, "size_y", text="Y")


class CVRENDER_LIGHT_PT_beam_shape(LightPanel, bpy.types.Panel):
    bl_label = "Beam Shape"
    bl_parent_id = "CVRENDER_LIGHT_PT_light"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return (
            super().poll(context) and context.light.type in {"SPOT", "AREA"} and not is_laser(context.light)
        )

    def draw(self, context: bpy.types.Context) -> None:
        light = context.light
        column = properties_layout(self)
        if light.type == "SPOT":
            column.prop(light, "spot_size", text="Angle")
            column.prop(light, "spot_blend", text="Blend", slider=True)
            column.prop(light, "show_cone")
        else:
            column.prop(light, "spread")


class CVRENDER_LIGHT_PT_laser(LightPanel, bpy.types.Panel):
    bl_label = "Laser"
    bl_parent_id = "CVRENDER_LIGHT_PT_light"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.light.type == "SPOT"

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.light.cv_render, "is_laser", text="")

    def draw(self, context: bpy.types.Context) -> None:
        laser = context.light.cv_render
        column = properties_layout(self)
        column.active = laser.is_laser
        column.prop(laser, "beam_radius")
        column.prop(laser, "length")
        parts = column.column(heading="Show", align=True)
        for name in ("beam", "spot", "in_fog", "on_surfaces"):
            parts.prop(laser, name)


class CVRENDER_LIGHT_PT_nodes(LightPanel, bpy.types.Panel):
    bl_label = "Nodes"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        draw_nodes(properties_layout(self), context.light, "Surface")


register, unregister = registration(
    CVRENDER_LIGHT_PT_light, CVRENDER_LIGHT_PT_beam_shape, CVRENDER_LIGHT_PT_laser, CVRENDER_LIGHT_PT_nodes
)
