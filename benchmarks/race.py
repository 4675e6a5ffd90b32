# SPDX-License-Identifier: GPL-3.0-or-later
"""Time to equal error: CV Render, Cycles and Mitsuba render the examples in turn.

Every engine is measured against its own converged picture, so that a difference between the engines
counts for none of them. Time is what a user waits for: export, rendering and a written EXR (for
Mitsuba, which is handed a loaded scene, the last two). The first render of a scene counts apart.
What is dear and does not change (converged pictures, and Cycles' long runs) is kept between races.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

import dev

bpy = dev.open_this_blender()

from example_blends.build import SCENES, build  # noqa: E402

from .engines.blender import (  # noqa: E402
    CV_RENDER,
    CYCLES,
    CYCLES_ADAPTIVE,
    CYCLES_DENOISED,
    CYCLES_WITHOUT_TREE,
    INTEGRATORS,
    read_picture,
    set_output,
)
from .engines.mitsuba import Mitsuba, Unavailable  # noqa: E402

TARGET_SAMPLES = 64
"""The errors to reach are the one that Cycles has with so many, and a third of it."""
DENOISED_SAMPLES = 16
"""That Cycles takes before it denoises: what a user in a hurry would pick."""
ADAPTIVE_SAMPLES = 1024
"""That Cycles' adaptive sampling may spend on a pixel."""
PIXELS_OF_SQUARE = 256 * 256
RACED = (
    "soft_shadow", "mixed_lights", "many_lights", "interior", "slats", "studio_spheres", "veach_plates",
    "violin", "dragon", "occluder", "pumpkin", "lighthouse", "fogged_interior", "stage", "fog_ball",
    "fog_area", "two_spots", "leaves", "fence",
)  # fmt: skip
SCRATCH = dev.PRIVATE / "race"
DOCUMENT = dev.ROOT / "docs" / "benchmarks.md"
MARKS = ("<!-- race: begin -->", "<!-- race: end -->")

METRICS = ("all", "dim")
"""Errors over all pixels, and over those that are not among the brightest."""


class Engine(Protocol):
    name: str
    family: str

    def render(self, samples: int, seed: int, path: Path) -> float: ...


@dataclass(frozen=True)
class Reference:
    """A converged picture, from two halves of different seeds.

    halves : two of (H, W, 3). dim : (H, W) bool, pixels that are not among the brightest.
    """

    halves: tuple[np.ndarray, np.ndarray]
    dim: np.ndarray

    @classmethod
    def of(cls, halves: Sequence[np.ndarray], brightest: int) -> Reference:
        """brightest : how many pixels, of 256 x 256, are left out of the second metric."""
        brightness = sum(halves).sum(axis=-1)
        count = brightest * brightness.size // PIXELS_OF_SQUARE
        limit = np.partition(brightness.ravel(), -count - 1)[-count - 1]
        return cls(tuple(halves), brightness <= limit)

    @property
    def picture(self) -> np.ndarray:
        return (self.halves[0] + self.halves[1]) / 2

    def errors(self, picture: np.ndarray) -> dict[str, float]:
        """RMSE over pixels and colours relative to the mean; the reference's own noise taken off."""
        noise = (self.halves[0] - self.halves[1]) ** 2 / 4
        return self._relative((picture - self.picture) ** 2 - noise)

    def own_errors(self) -> dict[str, float]:
        """Those of one half, by its difference to the other."""
        return self._relative((self.halves[0] - self.halves[1]) ** 2 / 2)

    def _relative(self, square: np.ndarray) -> dict[str, float]:
        mean = self.picture.mean()
        means = square.mean(), square[self.dim].mean()
        return {
            name: float(np.sqrt(max(value, 0)) / mean) for name, value in zip(METRICS, means, strict=True)
        }


@dataclass
class Curve:
    """What one engine needs for what error, in one scene at one size.

    seconds, errors, means : by number of samples, one entry a repeat; errors by metric; means relative to
        that of the engine's own converged picture.
    first, second : seconds of the first two renders of the scene, at the fewest samples.
    """

    engine: str
    first: float = 0.0
    second: float = 0.0
    seconds: dict[int, list[float]] = field(default_factory=dict)
    errors: dict[int, list[dict[str, float]]] = field(default_factory=dict)
    means: dict[int, list[float]] = field(default_factory=dict)

    def add(self, samples: int, seconds: float, errors: dict[str, float], mean: float = 1.0) -> None:
        self.seconds.setdefault(samples, []).append(seconds)
        self.errors.setdefault(samples, []).append(errors)
        self.means.setdefault(samples, []).append(mean)

    def at(self, samples: int, metric: str = "all") -> tuple[float, float]:
        """The fastest seconds (other work on the machine only adds), and root mean square error."""
        errors = [errors[metric] for errors in self.errors[samples]]
        return min(self.seconds[samples]), float(np.sqrt(np.mean(np.square(errors))))

    def _points(self, metric: str) -> tuple[np.ndarray, np.ndarray]:
        """log seconds and log errors of what pays: no point is both slower and worse than another."""
        kept: list[tuple[float, float]] = []
        for seconds, error in sorted(self.at(samples, metric) for samples in self.seconds):
            if error > 0 and (not kept or error < kept[-1][1]):
                kept.append((seconds, error))
        seconds, errors = np.log(np.array(kept)).T
        return seconds, errors

    def time_to(self, error: float, metric: str = "all") -> tuple[float, bool] | None:
        """Seconds to reach ``error``, and whether they lie within what was measured.

        Between two points as a power of time. Beyond the last by the slope before it (a single one: by
        N^-3/4, the fall of nets at edges); before the first the first, which is all that can be had.
        """
        seconds, errors = self._points(metric)
        goal = np.log(error)
        if goal >= errors[0]:
            return float(np.exp(seconds[0])), True
        if goal >= errors[-1]:
            return float(np.exp(np.interp(-goal, -errors, seconds))), True
        slope = -0.75
        if len(errors) > 1:
            slope = np.clip((errors[-1] - errors[-2]) / (seconds[-1] - seconds[-2]), -1, -0.25)
        return float(np.exp(seconds[-1] + (goal - errors[-1]) / slope)), False

    def error_after(self, time: float) -> float | None:
        """The error that so many seconds buy; None if no picture is done by then."""
        seconds, errors = self._points("all")
        if np.log(time) < seconds[0]:
            return None
        return float(np.exp(np.interp(np.log(time), seconds, errors)))


# Running


@dataclass
class Race:
    """One scene at one size, open in Blender; ``key`` names what is kept of it."""

    key: str
    width: int
    height: int
    options: argparse.Namespace

    @property
    def pixels(self) -> int:
        return self.width * self.height

    @property
    def picture(self) -> Path:
        return self.options.scratch / "picture.exr"

    def kept(self, engine: Engine, samples: int, seed: int) -> tuple[np.ndarray, float]:
        """A picture that was made before, or is made now, and how many times as long it took as with
        `TARGET_SAMPLES`: that much of its time is still true when the machine is busier."""
        name = engine.name if engine in (CYCLES_WITHOUT_TREE, CYCLES_ADAPTIVE) else engine.family
        name = "".join(c if c.isalnum() else "_" for c in name).lower()
        path = self.options.scratch / f"{self.key}-{name}-{samples}-{seed}.exr"
        record = path.with_suffix(".json")
        if not record.exists() or not path.exists() or (self.options.anew and engine.family == "cv_render"):
            once = CYCLES.render(TARGET_SAMPLES, seed, self.picture) if engine.family == "cycles" else 1.0
            part = path.with_suffix(".part.exr")
            seconds = engine.render(samples, seed, part)
            os.replace(part, path)
            record.write_text(json.dumps({"seconds": seconds, "times": seconds / once}), "utf-8")
        return read_picture(path), json.loads(record.read_text("utf-8"))["times"]

    def reference(self, engine: Engine, samples: int) -> tuple[Reference, float]:
        halves, times = zip(*(self.kept(engine, samples, seed) for seed in (1001, 2002)), strict=True)
        return Reference.of(halves, self.options.without_brightest), min(times)

    def entrants(self) -> list[Engine]:
        """The engines that can render the open scene; says why one can't."""
        engines: list[Engine] = [CYCLES, CYCLES_WITHOUT_TREE]
        engines += [CYCLES_DENOISED] if self.options.denoised else []
        engines += [INTEGRATORS[name] for name in self.options.integrators] or [CV_RENDER]
        if self.options.mitsuba:
            try:
                engines.append(Mitsuba(self.options.mitsuba_python, self.options.scratch))
            except Unavailable as reason:
                print(f"  Mitsuba is left out: {reason}")
        return engines

    def sample_counts(self, engine: Engine) -> Sequence[int]:
        if engine is CYCLES_DENOISED:
            return (DENOISED_SAMPLES,)
        if engine.family == "cycles":
            return (4, TARGET_SAMPLES)
        return Mitsuba.sample_counts if isinstance(engine, Mitsuba) else self.options.samples

    def run(self) -> tuple[dict[str, Curve], dict[str, Reference]]:
        """Curves of all engines, which take turns within each repeat, and references by family."""
        engines = self.entrants()
        samples = self.options.reference_samples or max(256, (1 << 25) // self.pixels)
        curves, references, times = {}, {}, {}
        for engine in engines:
            fewest = min(self.sample_counts(engine))
            curve = curves[engine.name] = Curve(engine.name)
            curve.first, curve.second = (engine.render(fewest, seed, self.picture) for seed in (1, 2))
            if engine.family not in references:
                by = INTEGRATORS["sobol"] if engine.family == "cv_render" else engine
                references[engine.family], times[engine.family] = self.reference(by, samples)
        for repeat in range(self.options.repeats):
            for engine in engines:
                self._measure(engine, curves, references[engine.family], 10 + repeat)
        self._long_runs(curves, references["cycles"], samples, times["cycles"])
        for engine in engines:
            if isinstance(engine, Mitsuba):
                engine.close()
        return curves, references

    def _measure(self, engine: Engine, curves: dict[str, Curve], reference: Reference, seed: int) -> None:
        """One repeat of one engine, up to its goal or as long as it is not hopeless.

        The goal is a third of Cycles' error, and where one is asked for, that error.
        """
        cycles = curves[CYCLES.name]
        for samples in self.sample_counts(engine):
            if isinstance(engine, Mitsuba) and samples not in curves[engine.name].seconds:
                engine.render(samples, seed, self.picture)  # compiles its kernels: warm from now on
            seconds = engine.render(samples, seed, self.picture)
            picture = read_picture(self.picture)
            errors, mean = reference.errors(picture), float(picture.mean() / reference.picture.mean())
            curves[engine.name].add(samples, seconds, errors, mean)
            print(f"  {engine.name:28} {samples:4} samples {seconds:8.3f} s  error {errors['all']:.5f}"
                  f"  without the brightest {errors['dim']:.5f}  mean {mean:.5f}")  # fmt: skip
            if engine.family == "cycles":
                continue
            time, _ = cycles.at(TARGET_SAMPLES)
            done = all(errors[metric] < 0.9 / 3 * cycles.at(TARGET_SAMPLES, metric)[1] for metric in METRICS)
            if self.options.until is not None:
                done &= errors["all"] < 0.9 * self.options.until
            if done or seconds > 4 * time:
                break

    def _long_runs(self, curves: dict[str, Curve], reference: Reference, samples: int, times: float) -> None:
        """Cycles' converged halves are points of its curve; its other settings run as long once."""
        seconds, _ = curves[CYCLES.name].at(TARGET_SAMPLES)
        curves[CYCLES.name].add(samples, times * seconds, reference.own_errors())
        others = [(CYCLES_WITHOUT_TREE, samples), (CYCLES_ADAPTIVE, ADAPTIVE_SAMPLES)]
        for engine, count in others[: 2 if self.options.adaptive else 1]:
            picture, times = self.kept(engine, count, 10)
            curve = curves.setdefault(engine.name, Curve(engine.name))
            curve.add(count, times * seconds, reference.errors(picture))


def race(blend: Path, size: tuple[int, int], options: argparse.Namespace) -> dict[str, object]:
    """All that was measured of one scene at one size."""
    bpy.ops.wm.open_mainfile(filepath=str(blend), load_ui=False)
    set_output(*size)
    digest = hashlib.sha256(blend.read_bytes()).hexdigest()[:8]
    version = "{}.{}".format(*bpy.app.version)
    key = f"{blend.stem}-{digest}-{version}-{size[0]}x{size[1]}"
    curves, references = Race(key, *size, options).run()
    truth = references["cycles"].picture
    agreement = {
        family: (float(found.picture.mean() / truth.mean()), found.errors(truth)["all"])
        for family, found in references.items()
        if family != "cycles"
    }
    for family, (mean, difference) in agreement.items():
        print(f"  {family}: mean {mean:.5f} of Cycles', relative RMS difference {difference:.5f}")
    where = f"{blend.stem}, {size[0]} x {size[1]}"
    # What a denoiser leaves does not fall with samples: no curve leads on from it.
    sampled = [curve for curve in curves.values() if curve.engine != CYCLES_DENOISED.name]
    return {
        "scene": blend.stem,
        "size": size,
        "curves": [asdict(curve) for curve in curves.values()],
        "mean and RMS difference to Cycles": agreement,
        "ratios": [ratios(where, curve, curves[CYCLES.name]) for curve in sampled],
        "absolute": [absolute(where, curve, size[0] * size[1]) for curve in sampled],
        "denoised": denoised(where, curves),
    }


# Tables


def ratios(where: str, curve: Curve, cycles: Curve) -> list[str]:
    """How many times as fast as Cycles an engine reaches Cycles' errors."""
    cells = [where, curve.engine]
    for metric in METRICS:
        goal = cycles.at(TARGET_SAMPLES, metric)[1]
        for part in (1, 3):
            if not goal > 0:
                cells.append("")
                continue
            (time, sure), (rival, rival_sure) = (c.time_to(goal / part, metric) for c in (curve, cycles))
            mark = "" if sure and rival_sure else "~"
            cells.append(f"{mark}{time:.2f} s: **{mark}{rival / time:.1f} x**")
    return cells


RATIOS = (
    "scene", "engine", "to Cycles' error at 64 samples", "to a third of it",
    "to its error without the brightest pixels", "to a third of that",
)  # fmt: skip


def absolute(where: str, curve: Curve, pixels: int) -> list[str]:
    samples = TARGET_SAMPLES if TARGET_SAMPLES in curve.seconds else max(curve.seconds)
    seconds, error = curve.at(samples)
    rate = samples * pixels / seconds / 1e6
    (time, sure), after = curve.time_to(0.0025), curve.error_after(1.0)
    return [
        where, curve.engine, f"{error:.4f} ({samples})", f"{seconds:.2f}",
        "" if curve.engine == CYCLES_ADAPTIVE.name else f"{rate:.1f}",
        f"{'' if sure else '~'}{time:.2f}", f"{after:.4f}" if after is not None else "no picture yet",
        f"{curve.first:.2f} / {curve.second:.2f}" if curve.first else "",
    ]  # fmt: skip


ABSOLUTE = (
    "scene", "engine", "error (samples)", "seconds", "Msamples/s", "seconds to 0.0025", "error after 1 s",
    "first / second render, s",
)  # fmt: skip


def denoised(where: str, curves: Mapping[str, Curve]) -> list[list[str]]:
    """Each engine of ours beside Cycles with few samples and OpenImageDenoise, if that has run."""
    if CYCLES_DENOISED.name not in curves:
        return []
    rival = curves[CYCLES_DENOISED.name]
    budget, goal = rival.at(DENOISED_SAMPLES)

    def of(curve: Curve, samples: int) -> str:
        (seconds, error), (_, dim) = curve.at(samples), curve.at(samples, "dim")
        mean = float(np.mean(curve.means[samples]))
        return f"{samples}: {seconds:.2f} s, {error:.4f} ({dim:.4f}), {mean:.4f}"

    rows = []
    for name, curve in curves.items():
        if not name.startswith(CV_RENDER.name):
            continue
        within = [samples for samples in curve.seconds if curve.at(samples)[0] <= budget]
        time, sure = curve.time_to(goal)
        reached = f"{'' if sure else '~'}{time:.2f} s: **{'' if sure else '~'}{budget / time:.1f} x**"
        rows.append(
            [
                where,
                name,
                of(rival, DENOISED_SAMPLES),
                of(curve, max(within, default=min(curve.seconds))),
                reached,
            ]
        )
    return rows


DENOISED = (
    "scene", "engine", "Cycles with OpenImageDenoise; samples: seconds, error (without the brightest), mean",
    "the engine in no more time, or by its fewest samples", "the engine to that error",
)  # fmt: skip


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows))


def machine() -> str:
    """What ran this."""
    cpu, information = platform.machine(), Path("/proc/cpuinfo")
    if information.exists():
        models = [line for line in information.read_text().splitlines() if line.startswith("model name")]
        cpu = models[0].partition(": ")[2] if models else cpu
    blender, python = bpy.app.version_string, platform.python_version()
    return f"Blender {blender}, Python {python}, {os.cpu_count()} processors ({cpu})"


def report(results: Sequence[dict[str, object]], options: argparse.Namespace) -> str:
    tables = [
        table(head, (row for result in results for row in result[key]))
        for head, key in ((RATIOS, "ratios"), (ABSOLUTE, "absolute"), (DENOISED, "denoised"))
        if any(result[key] for result in results)
    ]
    head = (
        f"{machine()}; the fastest of {options.repeats} renders each, of different seeds; ~ is extrapolated."
    )
    return "\n\n".join([head, *tables])


def write_document(text: str) -> None:
    """Put ``text`` between the marks of docs/benchmarks.md."""
    document = DOCUMENT.read_text("utf-8")
    before, rest = document.split(MARKS[0])
    DOCUMENT.write_text(f"{before}{MARKS[0]}\n{text}\n{MARKS[1]}{rest.split(MARKS[1])[1]}", "utf-8")


# The command


def size(text: str) -> tuple[int, int]:
    """1280x720, or 256 for a square."""
    width, _, height = text.partition("x")
    return int(width), int(height or width)


def parse(arguments: Sequence[str] | None = None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="dev.py bench race", description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--scenes", nargs="+", default=RACED, metavar="NAME", help=f"{', '.join(RACED)}, or .blend files")
    add("--sizes", nargs="+", type=size, metavar="WxH", help="1280x720 256x256")
    add("--repeats", type=int, metavar="N", help="3")
    add("--samples", nargs="+", type=int, metavar="N", default=[1 << k for k in range(10)],
        help="of CV Render, which stops at a third of Cycles' error")  # fmt: skip
    add("--integrators", nargs="+", choices=INTEGRATORS, metavar="NAME", default=[],
        help=f"of CV Render, instead of its own choice: {', '.join(INTEGRATORS)}")  # fmt: skip
    add("--reference-samples", type=int, metavar="N", help="of half a converged picture")
    add("--without-brightest", type=int, metavar="N", default=100,
        help="pixels, of each 256 x 256, that the second metric leaves out (100)")  # fmt: skip
    add("--no-adaptive", dest="adaptive", action="store_false", help="leave out Cycles' adaptive sampling")
    add("--no-denoised", dest="denoised", action="store_false", help="leave out Cycles with OpenImageDenoise")
    add("--until", type=float, metavar="ERROR", help="go on until this error is reached as well")
    add("--no-mitsuba", dest="mitsuba", action="store_false")
    add("--anew", action="store_true", help="CV Render's converged pictures again: its pictures have changed")
    add("--quick", action="store_true", help="one repeat at 320x180, short references, Cycles as it comes")
    add("--assets", type=Path, default=os.environ.get("CV_RENDER_ASSETS"), metavar="FOLDER",
        help="has the dragon's mesh (else: the environment's CV_RENDER_ASSETS)")  # fmt: skip
    add("--scratch", type=Path, default=SCRATCH, help="keeps references and results")
    add("--mitsuba-python", default=sys.executable, metavar="PYTHON")
    add("--write", action="store_true", help="also into docs/benchmarks.md")
    options = parser.parse_args(arguments)
    options.sizes = options.sizes or ([(320, 180)] if options.quick else [(1280, 720), (256, 256)])
    options.repeats = options.repeats or (1 if options.quick else 3)
    if options.quick:
        options.adaptive = False
        options.reference_samples = options.reference_samples or 256
    return options


def blend_of(name: str, options: argparse.Namespace) -> Path | None:
    """The file of a scene; the dragon's is made where its mesh is at hand, and not part of the project."""
    if name.endswith(".blend"):
        return Path(name).resolve()
    if name in SCENES:
        return dev.ROOT / "example_blends" / f"{name}.blend"
    from example_blends.dragon import MESH

    if options.assets is None or not (Path(options.assets) / MESH).is_file():
        print(f"{name} is left out: --assets FOLDER with {MESH} is missing")
        return None
    path = (options.scratch / f"{name}.blend").resolve()
    if not path.exists():
        build(name, Path(options.assets))
        bpy.ops.wm.save_as_mainfile(filepath=str(path), compress=True)
    return path


def main() -> None:
    options = parse()
    options.scratch.mkdir(parents=True, exist_ok=True)
    results = []
    for name in options.scenes:
        blend = blend_of(name, options)
        for shape in options.sizes if blend else ():
            print(f"{blend.stem}, {shape[0]} x {shape[1]}")
            results.append(race(blend, shape, options))
            record = {"machine": machine(), "results": results}
            (options.scratch / "race.json").write_text(json.dumps(record, indent=1), "utf-8")
    text = report(results, options)
    print(f"\n{text}\n\nThe whole curves: {options.scratch / 'race.json'}")
    if options.write:
        write_document(text)


if __name__ == "__main__":
    main()
