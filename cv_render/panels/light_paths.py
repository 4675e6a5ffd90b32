# SPDX-License-Identifier: GPL-3.0-or-later
"""Render properties: how far rays go on."""

from __future__ import annotations

import bpy

from .base import EnginePanel, properties_layout, registration


class CVRENDER_RENDER_PT_light_paths(EnginePanel, bpy.types.Panel):
    bl_label = "Light Paths"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        properties_layout(self).prop(context.scene.cv_render, "transparent_bounces")


register, unregister = registration(CVRENDER_RENDER_PT_light_paths)
