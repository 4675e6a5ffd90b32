# SPDX-License-Identifier: GPL-3.0-or-later
"""View layer properties: passes, and what a layer overrides."""

from __future__ import annotations

import bpy

from .base import EnginePanel, properties_layout, registration


class CVRENDER_VIEWLAYER_PT_passes(EnginePanel, bpy.types.Panel):
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        view_layer = context.view_layer
        column = properties_layout(self, animated=False).column(heading="Include", align=True)
        column.prop(view_layer, "use_pass_combined")
        column.prop(view_layer, "use_pass_z")
        column.prop(view_layer, "use_pass_normal")
        column = properties_layout(self, animated=False).column(heading="Light", align=True)
        column.prop(view_layer.cv_render, "use_pass_volume_direct")
        column.prop(view_layer.cv_render, "use_pass_laser")
        column = properties_layout(self, animated=False).column(heading="Integrator", align=True)
        column.prop(view_layer.cv_render, "use_pass_control_variate")
        column.prop(view_layer.cv_render, "use_pass_residual")
        column.prop(view_layer.cv_render, "use_pass_sample_count")
        column.prop(view_layer.cv_render, "use_pass_standard_error")


class CVRENDER_VIEWLAYER_PT_override(EnginePanel, bpy.types.Panel):
    bl_label = "Override"
    bl_context = "view_layer"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        view_layer = context.view_layer
        column = properties_layout(self, animated=False)
        column.prop(view_layer, "material_override")
        column.prop(view_layer, "world_override")
        column.prop(view_layer, "samples")


register, unregister = registration(CVRENDER_VIEWLAYER_PT_passes, CVRENDER_VIEWLAYER_PT_override)
