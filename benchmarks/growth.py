# SPDX-License-Identifier: GPL-3.0-or-later
"""How the seconds of a render grow with pixels, triangles, lights, samples and threads; engine_core alone.

The exponent is the slope over the larger half of each row, where what a render costs at the least no
longer counts: 1 is linear, 0 is constant. Lights are to grow like their logarithm.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

import dev
from engine_core import Scene, Settings, render
from example_blends.model import Lamp, Model, Thing, View, diffuse
from example_blends.shapes import ball, grid_faces

from .chapters.common import log_log, table
from .scenes import core

FOLDER = dev.PRIVATE / "growth"
BASE = {"pixels": 256, "triangles": 10_000, "lights": 1, "samples": 16, "threads": 0}
VALUES: Mapping[str, Sequence[int]] = {
    "pixels": (128, 256, 512, 1024, 2048),
    "triangles": (1_000, 10_000, 100_000, 1_000_000, 5_000_000),
    "lights": (1, 3, 10, 30, 100, 300, 1_000),
    "samples": (4, 8, 16, 32, 64, 128, 256),
    "threads": tuple(n for n in (1, 2, 4, 8, 16, 32) if n <= (os.cpu_count() or 1)),
}
"""Of pixels along an edge, and of the others as many."""
COLOURS = {
    "pixels": (30, 110, 200), "triangles": (60, 150, 70), "lights": (210, 40, 40), "samples": (235, 140, 30),
    "threads": (150, 90, 180),
}  # fmt: skip


def landscape(pixels: int, triangles: int, lights: int) -> Scene:
    """A wavy sheet of ``triangles`` and four balls on it under ``lights`` area lights of one power in all."""
    n = max(2, int(np.sqrt(triangles / 2)) + 1)
    x, y = np.meshgrid(np.linspace(-5, 5, n), np.linspace(-5, 5, n), indexing="ij")
    sheet = np.stack([x, y, 0.25 * np.sin(1.3 * x) * np.cos(1.1 * y)], -1).reshape(-1, 3)
    things = [Thing("Sheet", (sheet, grid_faces(n, n)[:, ::-1]), diffuse("Sand", (0.6, 0.55, 0.45)))]
    for i, (px, py) in enumerate([(-2, -1.5), (1.8, -2), (-0.6, 0.8), (2.2, 1.9)]):
        shape = ball(0.7, (px, py, 0.8), cells=10)
        things.append(Thing(f"Ball {i}", shape, diffuse(f"Ball {i}", (0.7, 0.3, 0.25)), smooth=True))
    random = np.random.default_rng(5)
    lamps = []
    for i in range(lights):
        px, py = random.uniform(-5, 5, 2) if lights > 1 else (-2.0, -2.5)
        position, size = (px, py, random.uniform(2.5, 4.0)), 1.2 / np.sqrt(lights)
        properties = {"shape": "SQUARE", "size": size}
        lamps.append(
            Lamp(f"Light {i}", "AREA", position, 700 / lights, (1, 0.95, 0.9), (px, py, 0), False, properties)
        )
    return core.scene(Model(View((0, -11, 7), (0, 0, 0.2), lens=42), things, lamps), pixels, pixels)


def measure(repeats: int, **setting: int) -> dict[str, float]:
    """Seconds in all and while building, and rays a pixel, of the fastest of some renders."""
    setting = BASE | setting
    scene = landscape(setting["pixels"], setting["triangles"], setting["lights"])
    settings = Settings(samples=setting["samples"], threads=setting["threads"])
    found = []
    for repeat in range(repeats):
        begin = time.perf_counter()
        film = render(scene, replace(settings, seed=repeat))
        seconds = time.perf_counter() - begin
        rays = film.statistics["camera rays"] + film.statistics["shadow rays"]
        building = film.statistics["seconds building"]
        found.append({"seconds": seconds, "building": building, "rays": rays / film.depth.size})
    return min(found, key=lambda one: one["seconds"])


def exponent(counts: Sequence[int], seconds: Sequence[float]) -> float:
    """Slope of log seconds over log counts, fitted to the larger half of the counts."""
    first = min(len(counts) // 2, len(counts) - 2)
    return float(np.polyfit(np.log(counts[first:]), np.log(seconds[first:]), 1)[0])


def grow(name: str, values: Sequence[int], run: Callable[..., dict[str, float]]) -> tuple[list[str], list]:
    """A row of the table, and its points (count, seconds)."""
    found = []
    for value in values:
        one = run(**{name: value})
        found.append(one)
        print(f"  {name} {value}: {one['seconds']:.3f} s, {one['building']:.3f} of them building, "
              f"{one['rays']:.1f} rays a pixel", flush=True)  # fmt: skip
    seconds = [one["seconds"] for one in found]
    counts = [value**2 for value in values] if name == "pixels" else list(values)
    fitted = f"{exponent(counts, seconds):.2f}" if len(values) > 1 else ""
    label = [f"{value}²" if name == "pixels" else f"{value:,}" for value in values]
    cells = "; ".join(f"{count}: {second:.3f}" for count, second in zip(label, seconds, strict=True))
    return [name, cells, fitted], list(zip(counts, seconds, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench growth", description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--only", nargs="+", choices=VALUES, default=list(VALUES), metavar="NAME", help=", ".join(VALUES))
    add("--largest", type=int, metavar="N", help="leave out larger numbers of pixels² and triangles")
    add("--repeats", type=int, default=3)
    add("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    options = parser.parse_args()
    rows, curves = [], {}
    for name in options.only:
        values = VALUES[name]
        if options.largest:
            values = [v for v in values if (v**2 if name == "pixels" else v) <= options.largest]
        row, curves[name] = grow(name, values, lambda **setting: measure(options.repeats, **setting))
        rows.append(row)
    options.output.mkdir(parents=True, exist_ok=True)
    colours = {name: COLOURS[name] for name in curves}
    panels = {f"seconds over {name}": {name: curve} for name, curve in curves.items()}
    log_log(options.output / "growth.png", panels, colours)
    (options.output / "growth.json").write_text(json.dumps(curves), "utf-8")
    base = ", ".join(f"{BASE[name]} {name}" for name in ("triangles", "lights", "samples"))
    print(f"\nSeconds of a render; 256² pixels, {base} but for what grows. Exponent of the larger half.\n")
    print(table(("", "seconds", "exponent"), rows))


if __name__ == "__main__":
    main()
