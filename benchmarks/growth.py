# SPDX-License-Identifier: GPL-3.0-or-later
"""How the seconds of a render grow with pixels, triangles, lights, lasers and others; engine_core alone.

Surfaces and fog have a scene each. Seconds are those of all processors, which other work on the machine
hardly changes, but of a clock where threads grow. Beside them stands the picture's noise. The exponent is
the slope over the larger half of each row, where what a render costs at the least no longer counts: 1 is
linear, 0 is constant. Lights on surfaces are to grow like their logarithm.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

import dev
from engine_core import Scene, Settings, render
from example_blends.model import Lamp, Model, Thing, View, diffuse
from example_blends.shapes import ball, grid_faces

from .chapters.common import log_log, table
from .scenes import core
from .scenes.fog import hall

FOLDER = dev.PRIVATE / "growth"
COLOURS = {
    "pixels": (30, 110, 200), "triangles": (60, 150, 70), "lights": (210, 40, 40), "samples": (235, 140, 30),
    "threads": (150, 90, 180), "lasers": (60, 150, 70), "depth": (90, 90, 90),
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


@dataclass(frozen=True)
class Subject:
    """What grows in a scene.

    scene : of numbers by their names. base : these and the renderer's, where they do not grow.
    values : of pixels along an edge, and of the others as many. alone : numbers that are different while one
    grows.
    """

    scene: Callable[..., Scene]
    base: Mapping[str, float]
    values: Mapping[str, Sequence[float]]
    alone: Mapping[str, Mapping[str, float]]

    def measure(self, repeats: int, **grown: float) -> dict[str, float]:
        """Of the fastest of some renders: seconds, those of building, rays a pixel; and the noise of all."""
        (name,) = grown
        setting = {**self.base, **self.alone.get(name, {}), **grown}
        settings = Settings(samples=setting.pop("samples"), threads=setting.pop("threads"))
        scene = self.scene(**setting)
        clock = time.perf_counter if name == "threads" else time.process_time
        found, pictures = [], []
        for repeat in range(max(2, repeats)):
            begin = clock()
            film = render(scene, replace(settings, seed=repeat))
            seconds = clock() - begin
            rays = film.statistics["camera rays"] + film.statistics["shadow rays"]
            building = film.statistics["seconds building"]
            pictures.append(film.combined[..., :3].astype(np.float64))
            found.append({"seconds": seconds, "building": building, "rays": rays / film.depth.size})
        square = np.mean([np.mean((one - other) ** 2) for one, other in pairwise(pictures)])
        noise = float(np.sqrt(square / 2) / np.mean(pictures))
        return min(found, key=lambda one: one["seconds"]) | {"noise": noise}


SUBJECTS = {
    "surfaces": Subject(
        landscape,
        {"pixels": 256, "triangles": 10_000, "lights": 1, "samples": 16, "threads": 0},
        {
            "pixels": (128, 256, 512, 1024, 2048),
            "triangles": (1_000, 10_000, 100_000, 1_000_000, 5_000_000),
            "lights": (1, 3, 10, 30, 100, 300, 1_000),
            "samples": (4, 8, 16, 32, 64, 128, 256),
            "threads": tuple(n for n in (1, 2, 4, 8, 16, 32) if n <= (os.cpu_count() or 1)),
        },
        {},
    ),
    "fog": Subject(
        hall,
        {"pixels": 256, "lights": 2, "lasers": 0, "depth": 1.0, "samples": 4, "threads": 0},
        {
            "pixels": (128, 256, 512, 1024, 2048),
            "lights": (1, 3, 10, 30, 100),
            "lasers": (1, 2, 4, 8, 16, 32, 64),
            "depth": (0.01, 0.1, 1.0, 10.0),
            "samples": (1, 2, 4, 8, 16, 32, 64),
        },
        {"lasers": {"lights": 0}},
    ),
}  # fmt: skip


def exponent(counts: Sequence[float], seconds: Sequence[float]) -> float:
    """Slope of log seconds over log counts, fitted to the larger half of the counts."""
    first = min(len(counts) // 2, len(counts) - 2)
    return float(np.polyfit(np.log(counts[first:]), np.log(seconds[first:]), 1)[0])


def grow(
    name: str, values: Sequence[float], run: Callable[..., dict[str, float]]
) -> tuple[list[str], list[tuple[float, float]]]:
    """A row of the table, and its points (count, seconds)."""
    found = []
    for value in values:
        one = run(**{name: value})
        found.append(one)
        print(f"  {name} {value}: {one['seconds']:.3f} s, {one['building']:.3f} s of a clock building, "
              f"{one['rays']:.1f} rays a pixel, noise {one['noise']:.4f}", flush=True)  # fmt: skip
    seconds = [one["seconds"] for one in found]
    counts = [value**2 for value in values] if name == "pixels" else list(values)
    fitted = f"{exponent(counts, seconds):.2f}" if len(values) > 1 else ""
    labels = [f"{value}²" if name == "pixels" else f"{value:,}" for value in values]
    cells = (
        f"{label}: {one['seconds']:.2f} ({one['noise']:.4f})"
        for label, one in zip(labels, found, strict=True)
    )
    return [name, "; ".join(cells), fitted], list(zip(counts, seconds, strict=True))


def main() -> None:
    names = list(dict.fromkeys(name for subject in SUBJECTS.values() for name in subject.values))
    parser = argparse.ArgumentParser(prog="dev.py bench growth", description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--scene", nargs="+", choices=SUBJECTS, default=list(SUBJECTS), help=", ".join(SUBJECTS))
    add("--only", nargs="+", choices=names, default=names, metavar="NAME", help=", ".join(names))
    add("--largest", type=int, metavar="N", help="leave out larger numbers of pixels² and all else")
    add("--repeats", type=int, default=3)
    add("--size", type=int, default=256, metavar="N", help="pixels along an edge while others grow")
    add("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    for title in options.scene:
        subject, rows, curves = SUBJECTS[title], [], {}
        subject = replace(subject, base={**subject.base, "pixels": options.size})
        for name in [name for name in subject.values if name in options.only]:
            values = subject.values[name]
            if options.largest:
                values = [v for v in values if (v**2 if name == "pixels" else v) <= options.largest]
            row, curves[name] = grow(name, values, partial(subject.measure, options.repeats))
            rows.append(row)
        panels = {f"{title}: seconds over {name}": {name: curve} for name, curve in curves.items()}
        log_log(options.output / f"{title}.png", panels, {name: COLOURS[name] for name in curves})
        (options.output / f"{title}.json").write_text(json.dumps(curves), "utf-8")
        base = ", ".join(f"{value} {name}" for name, value in subject.base.items() if name != "threads")
        print(f"\n{title}: {base} but for what grows. Exponent of the larger half.\n")
        print(table(("", "processor seconds of a render (noise)", "exponent"), rows), flush=True)


if __name__ == "__main__":
    main()
