# SPDX-License-Identifier: GPL-3.0-or-later
"""Render properties: how fog is sampled."""

from __future__ import annotations

import bpy

from .base import EnginePanel, properties_layout, registration


class CVRENDER_RENDER_PT_volumes(EnginePanel, bpy.types.Panel):
    bl_label = "Volumes"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        properties_layout(self).prop(context.scene.cv_render, "distance_sampling")


register, unregister = registration(CVRENDER_RENDER_PT_volumes)
