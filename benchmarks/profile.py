# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the time of a render goes: Blender, export, Embree, shading, and what Python's calls cost."""

from __future__ import annotations

import argparse
import dataclasses
import importlib
import sys
import tempfile
from pathlib import Path
from types import ModuleType
from typing import Any

import dev

from .engines.stopwatch import Stopwatch

SMALL_BATCH = 1024


def watch_blender(watch: Stopwatch, extension: ModuleType, scenes: list[Any]) -> None:
    """Time the stages of a render through Blender, and keep the scene that it exports."""
    session = extension.cv_render.session
    watch.time(session, "export_scene", "export", scenes.append)
    watch.time(session.engine_core, "render", "engine_core")
    watch.time(session.BlenderSink, "write", "pixels to Blender")


def classes(module: ModuleType) -> list[type]:
    """Those that a module defines itself."""
    return [kind for kind in vars(module).values() if getattr(kind, "__module__", "") == module.__name__
            and isinstance(kind, type)]  # fmt: skip


def watch_engine(watch: Stopwatch, engine: ModuleType) -> None:
    """Time the parts of engine_core."""

    def module(name: str) -> ModuleType:
        return importlib.import_module(f"{engine.__name__}.{name}")

    tracer, surfaces = module("geometry.raytracer").RayTracer, module("geometry.surfaces").Surfaces
    direct, emitters = module("transport.direct_light"), module("transport.emitters")
    watch.time(tracer, "closest_hit", "Embree, camera rays")
    watch.time(tracer, "occluded", "Embree, shadow rays")
    watch.time(module("integration.point_sets").SobolPoints, "points", "Sobol points")
    watch.time(module("transport.camera_rays").CameraRays, "rays", "camera rays")
    watch.time(surfaces, "first_hit", "surface points")
    watch.time(surfaces, "shadow_rays", "shadow rays' ends")
    watch.time(direct.DirectLight, "choice_of_cells", "choice of lights")
    for kind in classes(module("transport.light_choice")):
        if "choose" in vars(kind):
            watch.time(kind, "choose", "choice of lights")
    for kind in classes(emitters):
        if "sample" in vars(kind):
            watch.time(kind, "sample", "points on lights")
    watch.time(direct.DirectLight, "first", "shading")
    watch.time(direct.DirectLight, "rest", "shading")
    watch.time(module("render"), "sum_samples", "sums by pixel")


def through_blender(blend: Path, size: int, samples: int, repeats: int) -> Any:
    """Print the stages of the last of some renders; returns the exported scene."""
    import bpy

    from .engines.blender import CV_RENDER, set_output

    bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False)
    set_output(size, size)
    scenes: list[Any] = []
    with tempfile.TemporaryDirectory() as folder:
        for _ in range(repeats):
            with Stopwatch() as watch:
                watch_blender(watch, sys.modules[dev.MODULE], scenes)
                seconds = CV_RENDER.render(samples, 0, Path(folder) / "picture.exr")
    print(f"\nThrough Blender, render {repeats} of a process: {seconds:.3f} s\n")
    print("| stage | seconds | share |\n|---|---|---|")
    stages = {label: spent.wall for label, spent in watch.total().items()}
    stages["Blender: scene, EXR"] = seconds - sum(stages.values())
    for label, wall in sorted(stages.items(), key=lambda item: -item[1]):
        print(f"| {label} | {wall:.3f} | {100 * wall / seconds:.0f} % |")
    return scenes[-1]


def alone(engine: ModuleType, scene: Any, samples: int) -> None:
    """Print the parts of engine_core by themselves."""
    settings = engine.Settings(samples=samples)
    with Stopwatch() as watch:
        watch_engine(watch, engine)
        film = engine.render(scene, settings)
    parts = watch.total()
    statistics = film.statistics
    threads = statistics["threads"] * statistics["seconds rendering"]
    rays = statistics["camera rays"]
    print(f"\nengine_core alone: building {statistics['seconds building']:.3f} s, "
          f"rendering {statistics['seconds rendering']:.3f} s on {statistics['threads']} threads, "
          f"{rays / statistics['seconds rendering'] / 1e6:.1f} Msamples/s")  # fmt: skip
    print("\n| part | share of the threads' time | ns a sample | calls |\n|---|---|---|---|")
    rest = threads - sum(spent.processor for spent in parts.values())
    rows = [(label, spent.processor, spent.calls) for label, spent in parts.items()]
    rows.sort(key=lambda row: -row[1])
    for label, seconds, calls in [*rows, ("waiting, and what is not above", rest, "")]:
        print(f"| {label} | {100 * seconds / threads:.0f} % | {1e9 * seconds / rays:.1f} | {calls} |")


def cost_of_calls(engine: ModuleType, scene: Any, samples: int) -> None:
    """Print what a batch costs however small it is, from two sizes of batches on one thread."""
    camera = scene.camera
    x, y = camera.width // 2, camera.height // 2
    half = min(64, x, y)
    part = dataclasses.replace(camera, region=(x - half, y - half, x + half, y + half))
    scene = dataclasses.replace(scene, camera=part)
    seconds, batches = [], []
    default = engine.Settings().batch_size
    for batch in (SMALL_BATCH, default):
        settings = engine.Settings(samples=samples, threads=1, batch_size=batch)
        runs = [engine.render(scene, settings).statistics for _ in range(3)]
        seconds.append(min(run["seconds rendering"] for run in runs))
        batches.append(runs[0]["camera rays"] / batch)
    each = (seconds[0] - seconds[1]) / (batches[0] - batches[1])
    share = each * batches[1] / seconds[1]
    print(f"\nPython's calls cost {1e6 * each:.0f} us a batch however small: {100 * share:.0f} % of the time "
          f"of one thread at {default} samples a batch")  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench profile", description=__doc__.partition("\n")[0])
    parser.add_argument("--scene", default="soft_shadow", metavar="NAME")
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--repeats", type=int, default=2)
    options = parser.parse_args()
    bpy = dev.open_this_blender()
    engine = sys.modules[f"{dev.MODULE}.engine_core"]
    size = options.size
    print(f"Blender {bpy.app.version_string}, {options.scene}, {size} x {size}, {options.samples} samples")
    blend = dev.ROOT / "example_blends" / f"{options.scene}.blend"
    scene = through_blender(blend, options.size, options.samples, options.repeats)
    alone(engine, scene, options.samples)
    cost_of_calls(engine, scene, options.samples)


if __name__ == "__main__":
    main()
