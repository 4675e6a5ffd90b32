# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension as Blender loads it: everything is in `cv_render`."""

from .cv_render import register, unregister

__all__ = ["register", "unregister"]
