# SPDX-License-Identifier: GPL-3.0-or-later
"""A render in progress: export, render, write, and one place where errors reach the user."""

from __future__ import annotations

import time
import traceback
from typing import Any

import bpy

from .. import engine_core
from ..engine_core import CVRenderError, Film, Sink
from . import passes
from .export import Messages, export_scene
from .properties import engine_settings

BACKGROUND_INTERVAL = 2.0
"""Seconds between lines of progress on a console."""

last_messages: list[str] = []
"""What the last render could not do as asked, for the panel."""


def render(engine: Any, depsgraph: Any) -> None:
    """Render one view layer of a frame.

    Everything ends here: an exception that left this function would crash Blender, or be taken for
    success; a reported error is neither.
    """
    try:
        _render(engine, depsgraph)
    except CVRenderError as error:
        _fail(engine, str(error))
    except MemoryError:
        _fail(engine, "Out of memory: use fewer instances, simpler meshes or a smaller picture")
    except KeyboardInterrupt:
        _fail(engine, "Interrupted")
    except BaseException as error:
        traceback.print_exc()
        _fail(engine, f"Unexpected error, please report it with the console's text: {error!r}")


def _render(engine: Any, depsgraph: Any) -> None:
    messages = Messages()
    last_messages.clear()
    settings = engine_settings(depsgraph.scene_eval, depsgraph.view_layer_eval)
    if not bpy.app.background:
        engine.update_stats("", "Exporting scene")
    scene = export_scene(engine, depsgraph, messages)
    sink = BlenderSink(engine, depsgraph.view_layer_eval.name)
    film = engine_core.render(scene, settings, sink)
    x0, y0, x1, y1 = scene.camera.region
    sink.write(film, 0, 0, x1 - x0, y1 - y0)
    _tell(engine, [*messages, *film.messages])


class BlenderSink(Sink):
    """Where the engine's tiles and progress go: Blender's render result and status line."""

    def __init__(self, engine: Any, layer: str) -> None:
        self._engine = engine
        self._layer = layer
        self._next_line = time.monotonic() + BACKGROUND_INTERVAL

    def cancelled(self) -> bool:
        return self._engine.test_break()

    def tile(self, film: Film, x0: int, y0: int, x1: int, y1: int) -> None:
        if not bpy.app.background:  # nobody watches
            self.write(film, x0, y0, x1, y1)

    def write(self, film: Film, x0: int, y0: int, x1: int, y1: int) -> None:
        passes.write(self._engine, self._layer, self._engine.active_view_get(), film, x0, y0, x1, y1)

    def progress(self, fraction: float, elapsed: float, remaining: float | None, text: str) -> None:
        text = text if remaining is None else f"Remaining: {_clock(remaining)} | {text}"
        self._engine.update_progress(fraction)
        if not bpy.app.background:
            self._engine.update_stats("", text)
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + BACKGROUND_INTERVAL
            print(f"CV Render: {text}", flush=True)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(max(0.0, seconds), 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02d}:{seconds:02.0f}" if hours else f"{minutes:02d}:{seconds:05.2f}"


def _tell(engine: Any, messages: list[str]) -> None:
    """Each message once: on the console, in a report, in the panel."""
    last_messages[:] = messages
    for message in messages:
        print(f"CV Render: {message}", flush=True)
    if messages:
        engine.report({"WARNING"}, "CV Render: " + "; ".join(messages))


def _fail(engine: Any, text: str) -> None:
    last_messages[:] = [text]
    engine.report({"ERROR"}, f"CV Render: {text}")
