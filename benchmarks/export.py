# SPDX-License-Identifier: GPL-3.0-or-later
"""How long large scenes take from Blender into Scene arrays, and what Embree takes to make its tree."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

import dev

from .engines.stopwatch import Stopwatch


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench export", description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    bpy = dev.open_this_blender()
    from .engines.blender import CV_RENDER, set_output
    from .scenes.large import many_instances, many_objects, one_mesh

    extension = sys.modules[dev.MODULE]
    cases = {
        "1,000,000 triangles, flat": one_mesh,
        "1,000,000 triangles, smooth": lambda: one_mesh(smooth=True),
        "10,000 objects, own meshes": many_objects,
        "10,000 objects, one mesh": lambda: many_objects(shared=True),
        "10,000 instances on vertices": many_instances,
    }
    print(f"Blender {bpy.app.version_string}, seconds: the fastest of {options.repeats} renders\n")
    print("| scene | export | Embree | rest of engine_core | whole render |\n|---|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        for name, build in cases.items():
            build()
            set_output(16, 16)
            path = Path(folder) / "picture.exr"
            rows = [time_once(extension, CV_RENDER, path) for _ in range(options.repeats)]
            best = [min(column) for column in zip(*rows, strict=True)]
            print(f"| {name} | {' | '.join(f'{seconds:.3f}' for seconds in best)} |")


def time_once(extension: object, engine: object, path: Path) -> tuple[float, float, float, float]:
    """Seconds of one render: export, Embree's mesh and tree, the rest of engine_core, and all of it."""
    session = extension.cv_render.session
    with Stopwatch() as watch:
        watch.time(session, "export_scene", "export")
        watch.time(session.engine_core, "render", "engine_core")
        watch.time(extension.engine_core.geometry.raytracer.RayTracer, "__init__", "Embree")
        whole = engine.render(1, 0, path)
    spent = watch.total()
    return spent["export"].wall, spent["Embree"].wall, spent["engine_core"].wall, whole


if __name__ == "__main__":
    main()
