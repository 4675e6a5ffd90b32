# SPDX-License-Identifier: GPL-3.0-or-later
"""Render properties: threads and tiles."""

from __future__ import annotations

import bpy

from .base import EnginePanel, properties_layout, registration


class CVRENDER_RENDER_PT_performance(EnginePanel, bpy.types.Panel):
    bl_label = "Performance"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        render = context.scene.render
        column = properties_layout(self, animated=False)
        column.prop(render, "threads_mode")
        threads = column.column()
        threads.enabled = render.threads_mode == "FIXED"
        threads.prop(render, "threads")
        column.separator()
        column.prop(context.scene.cv_render, "tile_size")


register, unregister = registration(CVRENDER_RENDER_PT_performance)
