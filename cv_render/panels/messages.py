# SPDX-License-Identifier: GPL-3.0-or-later
"""Render properties: what the last render could not do as asked."""

from __future__ import annotations

import textwrap

import bpy

from .. import session
from .base import EnginePanel, registration

PIXELS_PER_CHARACTER = 7


class CVRENDER_RENDER_PT_messages(EnginePanel, bpy.types.Panel):
    bl_label = "Messages"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context: bpy.types.Context) -> None:
        if session.last_messages:
            self.layout.label(icon="ERROR")

    def draw(self, context: bpy.types.Context) -> None:
        column = self.layout.column(align=True)
        if not session.last_messages:
            column.label(text="The last render had nothing to report", icon="CHECKMARK")
        scale = context.preferences.system.ui_scale
        characters = max(20, int(context.region.width / (PIXELS_PER_CHARACTER * scale)) - 6)
        for message in session.last_messages:
            for i, line in enumerate(textwrap.wrap(message, characters)):
                column.label(text=line, icon="BLANK1" if i else "DOT")


register, unregister = registration(CVRENDER_RENDER_PT_messages)
