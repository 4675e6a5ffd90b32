# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own panels, opened to the engine by its name in their ``COMPAT_ENGINES``."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..engine import ENGINE

REPLACED = frozenset(
    (
        "DATA_PT_falloff_curve",
        "DATA_PT_light",
        "DATA_PT_preview",
        "DATA_PT_spot",
        "EEVEE_MATERIAL_PT_viewport_settings",
        "MATERIAL_PT_preview",
        "NODE_DATA_PT_light",
        "NODE_DATA_PT_spot",
        "OBJECT_PT_shading",
        "OBJECT_PT_visibility",
        "VIEWLAYER_PT_layer_passes",
    )
)
"""Panels that we have a version of our own of, or nothing to show in."""

ALSO = frozenset(("DATA_PT_camera_dof", "DATA_PT_camera_dof_aperture", "EEVEE_MATERIAL_PT_context_material"))
"""Panels that fit, although Blender keeps them from engines of the general kind."""


def _panels() -> Iterator[type[bpy.types.Panel]]:
    for panel in bpy.types.Panel.__subclasses__():
        engines = getattr(panel, "COMPAT_ENGINES", ())
        if panel.__name__ in ALSO or ("BLENDER_RENDER" in engines and panel.__name__ not in REPLACED):
            yield panel


def register() -> None:
    for panel in _panels():
        panel.COMPAT_ENGINES.add(ENGINE)


def unregister() -> None:
    for panel in _panels():
        panel.COMPAT_ENGINES.discard(ENGINE)
