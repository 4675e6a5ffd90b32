# SPDX-License-Identifier: GPL-3.0-or-later
"""Every difference between Blender 4.2 and today, and nothing else."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np


def node_tree(datablock: Any) -> Any | None:
    """The shader nodes of a material, light or world; None if it does without.

    From 5.0 on, ``use_nodes`` is deprecated and whoever has a tree uses it.
    """
    if bpy.app.version >= (5, 0, 0):
        return datablock.node_tree
    return datablock.node_tree if datablock.use_nodes else None


def light_gain(light: Any) -> np.ndarray:
    """(3,) factor of exposure and colour temperature, both from 4.5 on."""
    gain = np.full(3, 2.0 ** getattr(light, "exposure", 0.0))
    if getattr(light, "use_temperature", False):
        gain *= np.array(light.temperature_color)
    return gain


def light_is_normalized(light: Any) -> bool:
    """Whether the power is the whole light's, whatever its size: a choice from 4.5 on."""
    return getattr(light, "normalize", True)


def terminator_offset(obj: Any) -> float:
    """Shadow terminator geometry offset, which moved from Cycles' to Blender's own settings in 4.4 or 4.5."""
    if hasattr(obj, "shadow_terminator_geometry_offset"):
        return obj.shadow_terminator_geometry_offset
    cycles = getattr(obj, "cycles", None)
    return cycles.shadow_terminator_geometry_offset if cycles else 0.1


def terminator_owner(obj: Any) -> Any | None:
    """What has ``shadow_terminator_geometry_offset`` as a property to be drawn in a panel."""
    if hasattr(obj, "shadow_terminator_geometry_offset"):
        return obj
    return getattr(obj, "cycles", None)


def flat_faces_split_normals() -> bool:
    """Whether Cycles gives a mesh of flat and smooth faces a normal for each corner.

    Before, its smooth faces kept the vertices' normals, into which the flat ones enter as well.
    """
    return bpy.app.version >= (5, 0, 0)


def nodes_are_optional() -> bool:
    """Whether materials, lights and worlds have a switch for their nodes."""
    return bpy.app.version < (5, 0, 0)


def volume_pass_name() -> str:
    """What Cycles calls light that fog scatters: 5.0 gave passes names for people."""
    return "Volume Direct" if bpy.app.version >= (5, 0, 0) else "VolumeDir"
