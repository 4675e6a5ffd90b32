# SPDX-License-Identifier: GPL-3.0-or-later
"""Object properties: visibility, to people and to rays, and the shadow terminator."""

from __future__ import annotations

import bpy

from ..versions import terminator_owner
from .base import EnginePanel, properties_layout, registration

WITH_SURFACE = frozenset(("MESH", "CURVE", "SURFACE", "META", "FONT"))


class ObjectPanel(EnginePanel):
    bl_context = "object"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.object is not None and super().poll(context)


class CVRENDER_OBJECT_PT_visibility(ObjectPanel, bpy.types.Panel):
    bl_label = "Visibility"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        obj = context.object
        column = properties_layout(self)
        column.prop(obj, "hide_select", text="Selectable", invert_checkbox=True, toggle=False)
        shown = column.column(heading="Show In")
        shown.prop(obj, "hide_viewport", text="Viewports", invert_checkbox=True, toggle=False)
        shown.prop(obj, "hide_render", text="Renders", invert_checkbox=True, toggle=False)
        if obj.type in WITH_SURFACE:
            column.column(heading="Mask").prop(obj, "is_holdout")


class RenderedObjectPanel(ObjectPanel):
    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return super().poll(context) and context.object.type in WITH_SURFACE


class CVRENDER_OBJECT_PT_ray_visibility(RenderedObjectPanel, bpy.types.Panel):
    bl_label = "Ray Visibility"
    bl_parent_id = "CVRENDER_OBJECT_PT_visibility"

    def draw(self, context: bpy.types.Context) -> None:
        column = properties_layout(self, animated=False)
        column.prop(context.object, "visible_camera", text="Camera")
        column.prop(context.object, "visible_shadow", text="Shadow")


class CVRENDER_OBJECT_PT_shadow_terminator(RenderedObjectPanel, bpy.types.Panel):
    bl_label = "Shadow Terminator"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        owner = terminator_owner(context.object)
        if owner is not None:
            properties_layout(self, animated=False).prop(
                owner, "shadow_terminator_geometry_offset", text="Geometry Offset", slider=True
            )


register, unregister = registration(
    CVRENDER_OBJECT_PT_visibility, CVRENDER_OBJECT_PT_ray_visibility, CVRENDER_OBJECT_PT_shadow_terminator
)
