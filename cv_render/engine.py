# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine as Blender sees it: a table of contents."""

from __future__ import annotations

import bpy

from . import passes, session, viewport

ENGINE = "CV_RENDER"


class CVRenderEngine(bpy.types.RenderEngine):
    """Every callback hands over. No __init__: Blender calls it once or twice, depending on its version."""

    bl_idname = ENGINE
    bl_label = "CV Render"
    bl_use_eevee_viewport = True
    bl_use_shading_nodes_custom = False

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        session.render(self, depsgraph)

    def view_update(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        pass  # the viewport keeps nothing that could grow old

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        viewport.draw(context)

    def update_render_passes(self, scene: bpy.types.Scene, renderlayer: bpy.types.ViewLayer) -> None:
        passes.register_passes(self, scene, renderlayer)


def register() -> None:
    bpy.utils.register_class(CVRenderEngine)


def unregister() -> None:
    bpy.utils.unregister_class(CVRenderEngine)
