# SPDX-License-Identifier: GPL-3.0-or-later
"""A render in progress: export, render, write, and one place where errors reach the user."""

from __future__ import annotations

import sys
import time
import traceback
from typing import Any

import bpy

from .. import engine_core
from ..engine_core import CVRenderError, Film, Sink
from . import passes
from .export import Messages, export_scene
from .properties import engine_settings

TERMINAL_INTERVAL, LOG_INTERVAL = 0.25, 5.0
"""Seconds between two words of progress: on a terminal, where they replace each other, and in a log."""

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
    messages, of_core = Messages(), {}
    last_messages.clear()
    for view in _views(depsgraph.scene_eval.render):
        engine.active_view_set(view)
        of_core |= dict.fromkeys(_render_view(engine, depsgraph, messages).messages)
    _tell(engine, [*messages, *of_core])


def _views(render: Any) -> list[str]:
    """The names of the pictures that stereoscopy asks for; a plain picture's name is empty."""
    if not render.use_multiview:
        return [""]
    views = render.stereo_views if render.views_format == "STEREO_3D" else render.views
    return [view.name for view in views if view.use]


def _render_view(engine: Any, depsgraph: Any, messages: Messages) -> Film:
    """Export, render and write what the engine's active view sees."""
    settings = engine_settings(depsgraph.scene_eval, depsgraph.view_layer_eval)
    if not bpy.app.background:
        engine.update_stats("", "Exporting scene")
    begin = time.perf_counter()
    scene = export_scene(engine, depsgraph, messages)
    exported = time.perf_counter()
    sink = BlenderSink(engine, depsgraph.view_layer_eval.name)
    try:
        film = engine_core.render(scene, settings, sink)
    finally:
        sink.end()
    x0, y0, x1, y1 = scene.camera.region
    sink.write(film, 0, 0, x1 - x0, y1 - y0, done=True)
    if bpy.app.debug:
        seconds = {"seconds export": exported - begin, "seconds in all": time.perf_counter() - begin}
        _print_statistics(depsgraph.view_layer_eval.name, film.statistics | seconds)
    return film


def _print_statistics(layer: str, statistics: dict[str, Any]) -> None:
    """A table of what a view layer took, for Blender's ``--debug``."""
    width = max(map(len, statistics))
    lines = [f'CV Render: statistics of view layer "{layer}"']
    for name, value in statistics.items():
        text = f"{value:15.3f}" if isinstance(value, float) else value
        lines.append(f"  {name:{width}}  {f'{value:11,}' if isinstance(value, int) else text}")
    print("\n".join(lines), flush=True)


class BlenderSink(Sink):
    """Where the engine's tiles and progress go: Blender's render result and status line."""

    def __init__(self, engine: Any, layer: str) -> None:
        self._engine = engine
        self._layer = layer
        self._terminal = sys.stdout.isatty()
        self._interval = TERMINAL_INTERVAL if self._terminal else LOG_INTERVAL
        self._next_line = time.monotonic() + self._interval

    def cancelled(self) -> bool:
        return self._engine.test_break()

    @property
    def watched(self) -> bool:
        return not bpy.app.background

    def tile(self, film: Film, x0: int, y0: int, x1: int, y1: int) -> None:
        if self.watched:
            self.write(film, x0, y0, x1, y1)

    def write(self, film: Film, x0: int, y0: int, x1: int, y1: int, done: bool = False) -> None:
        passes.write(self._engine, self._layer, self._engine.active_view_get(), film, x0, y0, x1, y1, done)

    def progress(self, fraction: float, elapsed: float, remaining: float | None, text: str) -> None:
        text = text if remaining is None else f"Remaining: {_clock(remaining)} | {text}"
        self._engine.update_progress(fraction)
        if not bpy.app.background:
            self._engine.update_stats("", text)
        elif time.monotonic() >= self._next_line:
            self._next_line = time.monotonic() + self._interval
            print(f"CV Render: {text}", end="\x1b[K\r" if self._terminal else "\n", flush=True)

    def end(self) -> None:
        """Leave nothing of the last progress on the terminal's line."""
        if bpy.app.background and self._terminal:
            print(end="\x1b[K", flush=True)


def _clock(seconds: float) -> str:
    minutes, seconds = divmod(max(0.0, seconds), 60)
    hours, minutes = divmod(int(minutes), 60)
    return f"{hours}:{minutes:02d}:{seconds:02.0f}" if hours else f"{minutes:02d}:{seconds:05.2f}"


def _tell(engine: Any, messages: list[str]) -> None:
    """Each message once: on the console, in a report, in the panel."""
    last_messages[:] = messages
    for message in messages:
        print(f"CV Render: {message}", flush=True)
    # Without a window, Blender would print the report below what was printed just now.
    if messages and not bpy.app.background:
        engine.report({"WARNING"}, "CV Render: " + "; ".join(messages))


def _fail(engine: Any, text: str) -> None:
    last_messages[:] = [text]
    engine.report({"ERROR"}, f"CV Render: {text}")
