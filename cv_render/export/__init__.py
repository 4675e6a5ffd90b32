# SPDX-License-Identifier: GPL-3.0-or-later
"""From Blender's evaluated scene to `engine_core.Scene`: one module a data-block."""

from .messages import Messages
from .scene import export_scene

__all__ = ["Messages", "export_scene"]
