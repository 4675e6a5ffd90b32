# SPDX-License-Identifier: GPL-3.0-or-later
"""Render properties: how much is sampled, and what the background is."""

from __future__ import annotations

import bpy

from .base import EnginePanel, properties_layout, registration


class CVRENDER_RENDER_PT_sampling(EnginePanel, bpy.types.Panel):
    bl_label = "Sampling"

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.cv_render
        column = properties_layout(self)
        column.prop(settings, "integrator")
        column.prop(settings, "samples")
        column.prop(settings, "light_samples")
        column.separator()
        column.prop(settings, "noise_threshold")
        minimum = column.column()
        minimum.active = settings.noise_threshold > 0
        minimum.prop(settings, "min_samples")
        column.prop(settings, "time_limit")
        column.separator()
        column.prop(settings, "viewport_samples")


class CVRENDER_RENDER_PT_sampling_advanced(EnginePanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "CVRENDER_RENDER_PT_sampling"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        settings = context.scene.cv_render
        column = properties_layout(self)
        row = column.row(align=True)
        row.prop(settings, "seed")
        row.prop(settings, "use_animated_seed", text="", icon="TIME")
        column.prop(settings, "direct_sampling")


class CVRENDER_RENDER_PT_film(EnginePanel, bpy.types.Panel):
    bl_label = "Film"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        properties_layout(self, animated=False).prop(context.scene.render, "film_transparent")


register, unregister = registration(
    CVRENDER_RENDER_PT_sampling, CVRENDER_RENDER_PT_sampling_advanced, CVRENDER_RENDER_PT_film
)
