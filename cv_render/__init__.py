# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender on one side, `engine_core` on the other; no mathematics of light."""

from . import engine, lasers, panels, properties

MODULES = (properties, engine, lasers, panels)


def register() -> None:
    for module in MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(MODULES):
        module.unregister()
