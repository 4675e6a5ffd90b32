# SPDX-License-Identifier: GPL-3.0-or-later
"""The panels: our own, and Blender's own opened to the engine."""

from . import (
    blender,
    light,
    light_paths,
    material,
    messages,
    object,
    performance,
    sampling,
    view_layer,
    volumes,
    world,
)

MODULES = (
    sampling,
    volumes,
    light_paths,
    performance,
    messages,
    view_layer,
    light,
    world,
    material,
    object,
    blender,
)


def register() -> None:
    for module in MODULES:
        module.register()


def unregister() -> None:
    for module in reversed(MODULES):
        module.unregister()
