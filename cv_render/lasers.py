# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers: spot lights with a switch, made by Add > Light > Laser and drawn as their beam in the 3-D view.

All that makes one is properties of the light, at ``light.cv_render``: so duplication, animation and undo are
Blender's own, and another engine shows a narrow spot.
"""

from __future__ import annotations

import math
from typing import Any

import bpy
import gpu
from bpy.props import FloatProperty
from bpy_extras.object_utils import AddObjectHelper, object_data_add
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix, Vector

from .engine import ENGINE
from .properties import is_laser

SHOWN_LENGTH = 100.0
"""Of a beam without limit, in the 3-D view; in scene units."""

RING = 24
"""Sides of the circles that show the beam's radius."""


class CVRENDER_OT_laser_add(bpy.types.Operator, AddObjectHelper):
    bl_idname = "object.cv_render_laser_add"
    bl_label = "Add Laser"
    bl_description = "Add a laser: a beam of parallel light, seen in fog and where it ends"
    bl_options = {"REGISTER", "UNDO"}

    power: FloatProperty(
        name="Power",
        description="Radiant flux of the beam",
        default=10.0,
        min=0.0,
        soft_max=1000.0,
        unit="POWER",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.mode == "OBJECT"

    def execute(self, context: bpy.types.Context) -> set[str]:
        light = bpy.data.lights.new("Laser", "SPOT")
        light.energy = self.power
        # What another engine shows: a cone as narrow as Blender allows.
        light.spot_size, light.spot_blend = math.radians(1.0), 0.0
        light.shadow_soft_size = light.cv_render.beam_radius
        light.cv_render.is_laser = True
        object_data_add(context, light, operator=self)
        return {"FINISHED"}


def _draw_menu(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    if context.engine == ENGINE:
        menu.layout.operator(CVRENDER_OT_laser_add.bl_idname, text="Laser", icon="LIGHT_SPOT")


def outline(matrix: Matrix, radius: float, length: float) -> list[Vector]:
    """Pairs of points in world space: the beam's axis, and a circle at either end."""
    rigid = matrix.normalized()
    ring = [(2 * math.pi * k / RING) for k in range(RING + 1)]
    points = [rigid.translation.copy(), rigid @ Vector((0, 0, -length))]
    for z in (0.0, -length):
        circle = [rigid @ Vector((radius * math.cos(a), radius * math.sin(a), z)) for a in ring]
        for pair in zip(circle, circle[1:], strict=False):
            points += pair
    return points


def _draw_beams() -> None:
    """The lasers of the view layer, as other overlays are drawn: whenever extras are shown."""
    context = bpy.context
    overlay = context.space_data.overlay
    if context.engine != ENGINE or not (overlay.show_overlays and overlay.show_extras):
        return
    theme = context.preferences.themes[0].view_3d
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    gpu.state.blend_set("ALPHA")
    gpu.state.depth_test_set("LESS_EQUAL")
    for obj in context.visible_objects:
        if obj.type != "LIGHT" or not is_laser(obj.data):
            continue
        if obj.select_get():
            colour = theme.object_active if obj == context.active_object else theme.object_selected
        else:
            colour = obj.data.color
        chosen = obj.data.cv_render
        points = outline(obj.matrix_world, chosen.beam_radius, chosen.length or SHOWN_LENGTH)
        shader.uniform_float("color", (*colour[:3], 1.0))
        batch_for_shader(shader, "LINES", {"pos": [tuple(point) for point in points]}).draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("NONE")


_handlers: list[Any] = []


def register() -> None:
    bpy.utils.register_class(CVRENDER_OT_laser_add)
    bpy.types.VIEW3D_MT_light_add.append(_draw_menu)
    if not bpy.app.background:  # nobody looks
        _handlers.append(bpy.types.SpaceView3D.draw_handler_add(_draw_beams, (), "WINDOW", "POST_VIEW"))


def unregister() -> None:
    while _handlers:
        bpy.types.SpaceView3D.draw_handler_remove(_handlers.pop(), "WINDOW")
    bpy.types.VIEW3D_MT_light_add.remove(_draw_menu)
    bpy.utils.unregister_class(CVRENDER_OT_laser_add)
