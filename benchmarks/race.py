# SPDX-License-Identifier: GPL-3.0-or-later
"""Time to equal error: CV Render, Cycles and Mitsuba render the examples in turn.

Every engine is measured against its own converged picture, so that a difference between the engines
counts for none of them. Time is what a user waits for: export, rendering and a written EXR (for
Mitsuba, which is handed a loaded scene, the last two). The first render of a process counts apart.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

import dev

bpy = dev.open_this_blender()

from example_blends.build import SCENES  # noqa: E402

from .engines.blender import (  # noqa: E402
    CYCLES,
    CYCLES_WITHOUT_TREE,
    INTEGRATORS,
    read_picture,
    set_output,
)
from .engines.mitsuba import Mitsuba, Unavailable  # noqa: E402

TARGET_SAMPLES = 64
"""The error to reach is the one that Cycles has with so many."""
SCRATCH = dev.PRIVATE / "race"
DOCUMENT = dev.ROOT / "docs" / "benchmarks.md"
MARKS = ("<!-- race: begin -->", "<!-- race: end -->")


class Engine(Protocol):
    name: str

    def render(self, samples: int, seed: int, path: Path) -> float: ...


@dataclass(frozen=True)
class Reference:
    """A converged picture, from two halves of different seeds.

    picture : (H, W, 3). noise : mean square error that the picture has itself.
    """

    picture: np.ndarray
    noise: float

    def relative_error(self, picture: np.ndarray) -> float:
        """RMSE over pixels and colours, relative to the mean; the reference's own noise taken off."""
        square = np.mean((picture - self.picture) ** 2) - self.noise
        return float(np.sqrt(max(square, 0.0)) / self.picture.mean())


@dataclass
class Curve:
    """What one engine needs for what error, in one scene at one size.

    seconds, errors : by number of samples, one entry a repeat.
    first : seconds of the process's first render of the scene, at the fewest samples.
    """

    engine: str
    first: float = 0.0
    seconds: dict[int, list[float]] = field(default_factory=dict)
    errors: dict[int, list[float]] = field(default_factory=dict)

    def add(self, samples: int, seconds: float, error: float) -> None:
        self.seconds.setdefault(samples, []).append(seconds)
        self.errors.setdefault(samples, []).append(error)

    def at(self, samples: int) -> tuple[float, float]:
        """The fastest seconds (other work on the machine only adds), and root mean square error."""
        error = np.sqrt(np.mean(np.square(self.errors[samples])))
        return min(self.seconds[samples]), float(error)

    def time_to(self, error: float) -> float | None:
        """Seconds to reach ``error``, between the sample counts on either side; None beyond them.

        From a single count it follows the fall of N^-3/4 that nets have at edges.
        """
        seconds, errors = np.array([self.at(samples) for samples in sorted(self.seconds)]).T
        if len(seconds) == 1:
            return float(seconds[0] * (errors[0] / error) ** (4 / 3))
        if not errors.min() <= error <= errors.max():
            return None
        return float(np.exp(np.interp(-np.log(error), -np.log(errors), np.log(seconds))))


def reference(engine: Engine, key: str, samples: int, folder: Path) -> Reference:
    """The engine's converged picture, from the folder if it was made before."""
    halves = []
    for seed in (1001, 2002):
        name = engine.name.split(",")[0].split("(")[0].strip().lower().replace(" ", "_")
        path = folder / f"{key}-{name}-{samples}-{seed}.exr"
        if not path.exists():
            part = path.with_suffix(".part.exr")
            engine.render(samples, seed, part)
            os.replace(part, path)
        halves.append(read_picture(path))
    return Reference((halves[0] + halves[1]) / 2, float(np.mean((halves[0] - halves[1]) ** 2) / 4))


def entrants(folder: Path, mitsuba_python: str, integrators: Sequence[str]) -> list[Engine]:
    """The engines that can render the open scene; says why one can't."""
    engines: list[Engine] = [CYCLES, CYCLES_WITHOUT_TREE, *(INTEGRATORS[name] for name in integrators)]
    try:
        engines.append(Mitsuba(mitsuba_python, folder))
    except Unavailable as reason:
        print(f"  Mitsuba is left out: {reason}")
    return engines


def sample_counts(engine: Engine, options: argparse.Namespace) -> Sequence[int]:
    if engine in (CYCLES, CYCLES_WITHOUT_TREE):
        return [TARGET_SAMPLES]
    return Mitsuba.sample_counts if isinstance(engine, Mitsuba) else options.samples


def race(blend: Path, size: int, options: argparse.Namespace) -> dict[str, object]:
    """Curves of every engine for one scene, the engines taking turns within each repeat."""
    bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False)
    set_output(size, size)
    digest = hashlib.sha256(blend.read_bytes()).hexdigest()[:8]
    key = f"{blend.stem}-{digest}-{bpy.app.version[0]}.{bpy.app.version[1]}-{size}"
    picture = options.scratch / "picture.exr"
    engines = entrants(options.scratch, options.mitsuba_python, options.integrators)
    curves, references = {}, {}
    for engine in engines:
        curves[engine.name] = Curve(engine.name, engine.render(min(options.samples), 1, picture))
        samples = options.reference_samples or converged(size)
        references[engine.name] = reference(engine, key, samples, options.scratch)
    for repeat in range(options.repeats):
        goal = np.inf
        for engine in engines:
            for samples in sample_counts(engine, options):
                seconds = engine.render(samples, 10 + repeat, picture)
                error = references[engine.name].relative_error(read_picture(picture))
                curves[engine.name].add(samples, seconds, error)
                print(f"  {engine.name:22} {samples:4} samples {seconds:8.3f} s  error {error:.5f}")
                if samples >= TARGET_SAMPLES and error < 0.8 * goal:
                    break  # the curve has passed all that is asked of it
            if engine in (CYCLES, CYCLES_WITHOUT_TREE):
                goal = min(goal, error)
    for engine in engines:
        if isinstance(engine, Mitsuba):
            engine.close()
    truth = references[CYCLES.name].picture.mean()
    return {
        "scene": blend.stem,
        "size": size,
        "curves": [asdict(curve) for curve in curves.values()],
        "mean ratio to Cycles": {name: float(r.picture.mean() / truth) for name, r in references.items()},
        "table": [row(blend.stem, size, curve, curves) for curve in curves.values()],
    }


def converged(size: int) -> int:
    """Samples of half a reference: 2^26 a picture, but at least 128 a pixel."""
    return max(128, (1 << 26) // size**2)


def row(scene: str, size: int, curve: Curve, curves: dict[str, Curve]) -> list[str]:
    """The cells of one engine: what it does at Cycles' number of samples, and its time to Cycles' errors."""
    samples = TARGET_SAMPLES if TARGET_SAMPLES in curve.seconds else max(curve.seconds)
    seconds, error = curve.at(samples)
    rate = samples * size**2 / seconds / 1e6
    shown = f"{error:.4f}" if samples == TARGET_SAMPLES else f"{error:.4f} ({samples} samples)"
    cells = [scene, f"{size} x {size}", curve.engine, shown, f"{seconds:.2f}", f"{rate:.1f}"]
    for rival in (CYCLES, CYCLES_WITHOUT_TREE):
        time, goal = curves[rival.name].at(TARGET_SAMPLES)
        needed = curve.time_to(goal)
        cells.append(f"{needed:.2f}: **{time / needed:.1f} x**" if needed else "outside the curve")
    return [*cells, f"{curve.first:.2f}"]


def table(results: Iterable[dict[str, object]]) -> str:
    head = (
        "scene", "size", "engine", f"error at {TARGET_SAMPLES} samples", "seconds", "Msamples/s",
        "seconds to Cycles' error: times as fast", "to that without light tree", "first render, s",
    )  # fmt: skip
    lines = [head, ["---"] * len(head), *(cells for result in results for cells in result["table"])]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def machine() -> str:
    """What ran this."""
    cpu, information = platform.machine(), Path("/proc/cpuinfo")
    if information.exists():
        models = [line for line in information.read_text().splitlines() if line.startswith("model name")]
        cpu = models[0].partition(": ")[2] if models else cpu
    blender, python = bpy.app.version_string, platform.python_version()
    return f"Blender {blender}, Python {python}, {os.cpu_count()} processors ({cpu})"


def write_document(text: str) -> None:
    """Put ``text`` between the marks of docs/benchmarks.md."""
    document = DOCUMENT.read_text("utf-8")
    before, rest = document.split(MARKS[0])
    DOCUMENT.write_text(f"{before}{MARKS[0]}\n{text}\n{MARKS[1]}{rest.split(MARKS[1])[1]}", "utf-8")


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="dev.py bench race", description=__doc__.partition("\n")[0])
    parser.add_argument("--scenes", nargs="+", default=["soft_shadow", "mixed_lights"], metavar="NAME",
                        help=f"{', '.join(SCENES)}, or paths of .blend files")  # fmt: skip
    parser.add_argument("--sizes", nargs="+", type=int, default=[256, 1024], metavar="PIXELS")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--samples", nargs="+", type=int, default=[2, 4, 8, 16, 32, 64, 128], metavar="N",
                        help="of CV Render (Cycles has 64)")  # fmt: skip
    parser.add_argument("--integrators", nargs="+", choices=INTEGRATORS, metavar="NAME",
                        default=["control_variates", "sobol"],
                        help=f"of CV Render: {', '.join(INTEGRATORS)}")  # fmt: skip
    parser.add_argument("--reference-samples", type=int, metavar="N", help="of half a reference")
    parser.add_argument("--scratch", type=Path, default=SCRATCH, help="keeps references and results")
    parser.add_argument("--mitsuba-python", default=sys.executable, metavar="PYTHON")
    parser.add_argument("--write", action="store_true", help="also into docs/benchmarks.md")
    return parser.parse_args(arguments)


def main() -> None:
    options = parse()
    options.scratch.mkdir(parents=True, exist_ok=True)
    results = []
    for name in options.scenes:
        blend = Path(name) if name.endswith(".blend") else dev.ROOT / "example_blends" / f"{name}.blend"
        for size in options.sizes:
            print(f"{blend.stem}, {size} x {size}")
            results.append(race(blend.resolve(), size, options))
    record = {"machine": machine(), "results": results}
    (options.scratch / "race.json").write_text(json.dumps(record, indent=1), "utf-8")
    text = (
        f"{machine()}; the fastest of {options.repeats} renders each, of different seeds.\n\n{table(results)}"
    )
    print(f"\n{text}\n\nThe whole curves: {options.scratch / 'race.json'}")
    if options.write:
        write_document(text)


if __name__ == "__main__":
    main()
