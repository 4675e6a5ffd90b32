# SPDX-License-Identifier: GPL-3.0-or-later
"""The viewport set to Rendered: it says that it is not there yet."""

from __future__ import annotations

import blf
import bpy

TEXT = "CV Render does not render in the viewport yet: press F12, or use Material Preview"
SIZE, MARGIN = 14, 24


def draw(context: bpy.types.Context) -> None:
    """One line of text at the bottom of the region."""
    scale = context.preferences.system.ui_scale
    font = 0
    blf.size(font, SIZE * scale)
    blf.color(font, 1.0, 1.0, 1.0, 1.0)
    width, _ = blf.dimensions(font, TEXT)
    blf.position(font, max(0.0, (context.region.width - width) / 2), MARGIN * scale, 0)
    blf.draw(font, TEXT)
