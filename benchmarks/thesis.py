# SPDX-License-Identifier: GPL-3.0-or-later
"""The figures of the thesis' chapter 5, direct illumination: pictures, tables and curves into .dev/thesis.

5.3: lights sampled, BSDFs sampled, and both by multiple importance sampling. 5.4: four ways to spend equal
samples. 5.5: error against samples and seconds. The thesis' guided path tracer is stood in for by the
simplest thing of its kind: chances of lights and places on them, learned for each block of the picture.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import dev
from engine_core import Scene, Settings, render
from engine_core.integration import integrate
from engine_core.integration.integrand import values_at
from engine_core.settings import DIRECT_SAMPLING
from engine_core.transport.direct_light import DirectLight, DirectLightOverTile, Pixels
from example_blends.dragon import MESH
from example_blends.dragon import model as dragon

from .method_figures import BLACK, GREY, PALE, Canvas, Colour
from .scenes import core

FOLDER = dev.PRIVATE / "thesis"
CROPS = {"veach_plates": ((0.20, 0.34), (0.62, 0.34)), "violin": ((0.38, 0.35), (0.55, 0.72)),
         "dragon": ((0.25, 0.38), (0.42, 0.66))}  # fmt: skip
"""Of each scene, where two details begin: parts of the width and, from the top, of the height."""
CROP = 0.16
"""Their width and height, as parts of the picture's width."""
BLOCK, CELLS, UNLEARNED = 16, 4, 0.3
"""Of the learned chances: pixels of a block, places along a light's edges, and the part that stays even."""


# The picture as a function of the unit cube


class EvenChoice:
    """Every light with the same chance, at every point."""

    def __init__(self, lights: int) -> None:
        self._lights = lights

    def choose(self, position, normal, cell, w) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = w.reshape(-1) * self._lights
        light = np.minimum(x.astype(np.intp), self._lights - 1)
        chance = np.full(light.shape, 1 / self._lights, np.float32)
        return light, chance, np.clip(x - light, 0, np.float32(1 - 2.0**-24))

    def pdf(self, light, position, normal, cell) -> np.ndarray:
        return np.full(np.shape(light), 1 / self._lights, np.float32)


@dataclass
class PrimarySpace:
    """A scene's picture as an integrand: (row, column, place on a light), one light chosen a sample.

    The light is what the first place says when it is cut into as many parts as there are lights: four
    dimensions, as in the thesis. Where lights have triangles to choose from, that is the fifth.
    """

    scene: Scene

    def __post_init__(self) -> None:
        self._direct = DirectLight(self.scene)
        self.lights = len(self._direct.lights)
        choice = EvenChoice(self.lights) if self.lights > 1 else None
        self._integrand = DirectLightOverTile(self._direct, choice)
        self.dimensions = 5 if self._direct.chooses_triangle else 4
        self.width, self.height = self.scene.camera.region_size

    def values(self, screen: np.ndarray, light: np.ndarray, place: np.ndarray) -> np.ndarray:
        """(3, N) radiance times the number of lights, at screen (2, N) row and column in [0, 1].

        light : (N,) numbers in [0, 1), which light. place : (2, N) on it.
        """
        size = np.array([[self.height], [self.width]])
        index = np.minimum((screen * size).astype(np.int32), size - 1).astype(np.int32)
        inside = (screen * size - index)[::-1, :, None]
        pixels = Pixels(index[1], index[0], np.zeros(index.shape[1], np.intp))
        rest = np.concatenate([place, light[None]])[: self._integrand.rest_dimensions]
        with np.errstate(all="ignore"):  # as the renderer does
            stage = self._integrand.first(pixels, inside)
            return values_at(self._integrand, stage, index.shape[1], None, rest)[:3]

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """(3, N) at points (D, N), for `integrate`."""
        if self.dimensions == 5:
            return self.values(u[:2], u[4], u[2:4])
        parts = u[2] * self.lights
        inside = parts - np.minimum(np.floor(parts), max(self.lights - 1, 0))
        return self.values(u[:2], u[2], np.stack([inside, u[3]]))


# Ways to make a picture


@dataclass(frozen=True)
class Outcome:
    """picture : (H, W, 3), row 0 at the bottom. cost : rays, as words."""

    picture: np.ndarray
    seconds: float
    cost: str


def monte_carlo(scene: Scene, samples: int, seed: int) -> Outcome:
    return _integrated(scene, samples, seed, method="monte_carlo")


def thesis_2020(scene: Scene, samples: int, seed: int) -> Outcome:
    """A sixteenth of the samples for the control variate, all others for the residual."""
    return _integrated(scene, samples, seed, preset="thesis_2020")


def _integrated(scene: Scene, samples: int, seed: int, **how: str) -> Outcome:
    begin = time.perf_counter()
    f = PrimarySpace(scene)
    found = integrate(
        f, f.dimensions, (f.height, f.width), samples, seed=seed, dtype=np.float32, threads=0, **how
    )
    spent = found.evaluations / (f.width * f.height)
    return Outcome(np.moveaxis(found.value, 0, -1), time.perf_counter() - begin, f"{spent:.1f} samples")


def learned(scene: Scene, samples: int, seed: int) -> Outcome:
    """A quarter of the samples anywhere; the rest where a block of pixels has found light by these."""
    begin, random = time.perf_counter(), np.random.default_rng(seed)
    f = PrimarySpace(scene)
    pixels = np.stack(np.divmod(np.arange(f.width * f.height), f.width))
    columns = -(-f.width // BLOCK)
    block = pixels[0] // BLOCK * columns + pixels[1] // BLOCK
    bins = max(f.lights, 1) * CELLS**2
    found = np.zeros((block.max() + 1, bins))
    total = np.zeros((3, block.size))
    first = max(1, samples // 4)
    size = np.array([[f.height], [f.width]])

    def drawn(bin_: np.ndarray) -> np.ndarray:
        light, cell = np.divmod(bin_, CELLS**2)
        row, column = np.divmod(cell, CELLS)
        place = (np.stack([row, column]) + random.random((2, len(bin_)))) / CELLS
        which = (light + random.random(len(bin_))) / max(f.lights, 1)
        screen = (pixels + random.random(pixels.shape)) / size
        place, which = (np.minimum(a.astype(np.float32), np.float32(1 - 2.0**-24)) for a in (place, which))
        return f.values(screen, which, place)

    for _ in range(first):
        bin_ = random.integers(0, bins, block.size)
        value = drawn(bin_)
        total += value
        np.add.at(found, (block, bin_), np.abs(value).sum(axis=0))
    sums = found.sum(axis=1, keepdims=True)
    chance = np.where(
        sums > 0, (1 - UNLEARNED) * found / np.where(sums > 0, sums, 1) + UNLEARNED / bins, 1 / bins
    )
    upper = np.cumsum(chance, axis=1)
    upper = (upper / upper[:, -1:] + np.arange(len(upper))[:, None]).ravel()
    for _ in range(samples - first):
        bin_ = np.searchsorted(upper, block + random.random(block.size), side="right") - block * bins
        bin_ = np.clip(bin_, 0, bins - 1)
        total += drawn(bin_) / (chance[block, bin_] * bins)
    picture = (total / max(samples, 1)).T.reshape(f.height, f.width, 3)
    return Outcome(picture, time.perf_counter() - begin, f"{samples:.1f} samples")


def rendered(**choices: object) -> Callable[[Scene, int, int], Outcome]:
    """By the renderer."""

    def method(scene: Scene, samples: int, seed: int) -> Outcome:
        begin = time.perf_counter()
        film = render(scene, Settings(samples=samples, seed=seed, **choices))
        seconds, pixels = time.perf_counter() - begin, film.depth.size
        rays = (film.statistics[f"{kind} rays"] / pixels for kind in ("camera", "shadow"))
        return Outcome(
            film.combined[..., :3].astype(np.float64), seconds, "{:.1f} + {:.1f} rays".format(*rays)
        )

    return method


METHODS: Mapping[str, tuple[Callable[[Scene, int, int], Outcome], Colour]] = {
    "plain monte carlo": (monte_carlo, (150, 150, 150)),
    "learned": (learned, (60, 150, 70)),
    "thesis 2020": (thesis_2020, (235, 140, 30)),
    "cv render, sobol": (rendered(integrator="sobol"), (30, 110, 200)),
    "cv render": (rendered(), (210, 40, 40)),
}


def reference(scene: Scene, key: str, options: argparse.Namespace) -> np.ndarray:
    """The converged picture, from the folder if it was made before."""
    path = options.output / f"reference-{key}-{options.reference_samples}.npy"
    if options.anew or not path.exists():
        film = render(scene, Settings(samples=options.reference_samples, seed=77, integrator="sobol"))
        np.save(path, film.combined[..., :3])
    return np.load(path).astype(np.float64)


def relative_error(picture: np.ndarray, truth: np.ndarray) -> float:
    return float(np.sqrt(np.mean((picture - truth) ** 2)) / truth.mean())


# Pictures and curves


def seen(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of radiance with row 0 at the bottom, as a screen shows it."""
    light = np.clip(picture[::-1], 0, 1)
    curve = np.where(light < 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def side_by_side(
    path: Path, name: str, pictures: Mapping[str, np.ndarray], errors: Mapping[str, float]
) -> None:
    """Each picture with its label and error, and below it two details, three times as large."""
    height, width = next(iter(pictures.values())).shape[:2]
    edge = round(CROP * width)
    scale = max(1, width // (2 * edge + 4))
    gap, top = 8, 22
    canvas = Canvas(len(pictures) * (width + gap) + gap, top + height + gap + edge * scale + gap)
    for number, (label, picture) in enumerate(pictures.items()):
        x, colours = gap + number * (width + gap), seen(picture)
        error = f": {errors[label]:.4f}" if label in errors else ""
        canvas.text(x, top / 2, label + error)
        canvas.image(x, top, colours, 1)
        for k, (left, upper) in enumerate(CROPS[name]):
            row, column = round(upper * height), round(left * width)
            detail = colours[row : row + edge, column : column + edge]
            canvas.image(x + k * (edge * scale + 4), top + height + gap, detail, scale)
            canvas.box(x + column, top + row, x + column + edge, top + row + edge, (240, 90, 30))
    canvas.save(path)


Points = Sequence[tuple[float, float]]


def log_log(path: Path, panels: Mapping[str, Mapping[str, Points]], colours: Mapping[str, Colour]) -> None:
    """Panels side by side, each of curves of (x, y) by their labels, both axes logarithmic."""
    w, h, gap, left, top = 330, 300, 62, 62, 30
    canvas = Canvas(left + len(panels) * (w + gap), top + h + 46 + 22 * len(colours))
    for number, (title, curves) in enumerate(panels.items()):
        points = np.log10(np.array([point for curve in curves.values() for point in curve]))
        low, high = points.min(axis=0) - 0.1, points.max(axis=0) + 0.1
        x0 = left + number * (w + gap)

        def place(point: np.ndarray, low=low, high=high, x0=x0) -> tuple[float, float]:
            x, y = (point - low) / (high - low)
            return x0 + x * w, top + (1 - y) * h

        canvas.text(x0, top / 2 - 2, title)
        for axis in range(2):
            for power in range(int(np.ceil(low[axis])), int(np.floor(high[axis])) + 1):
                at = np.array([float(power), low[1]] if axis == 0 else [low[0], float(power)])
                x, y = place(at)
                canvas.line([(x, y), (x, top) if axis == 0 else (x0 + w, y)], PALE, 1)
                where = (x, top + h + 12) if axis == 0 else (x0 - 6, y)
                canvas.text(*where, f"1e{power}", anchor=0.5 if axis == 0 else 1)
        canvas.box(x0, top, x0 + w, top + h, GREY)
        for label, curve in curves.items():
            places = np.array([place(point) for point in np.log10(np.array(curve))])
            if len(places) > 1:
                canvas.line(places, colours[label], 2)
            for x, y in places:
                canvas.dot(x, y, colours[label])
    for k, (label, colour) in enumerate(colours.items()):
        y = top + h + 40 + 22 * k
        canvas.line([(left, y), (left + 28, y)], colour, 2)
        canvas.text(left + 36, y, label, BLACK)
    canvas.save(path)


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (head, ["---"] * len(head), *rows))


# The figures


def figure_3(scene: Scene, name: str, truth: np.ndarray, options: argparse.Namespace) -> str:
    """Lights, BSDFs and both, by plain samples; errors of control variates beside them."""
    pictures, errors, rows = {}, {}, []
    for sampling in DIRECT_SAMPLING:
        cells = [name, sampling]
        for integrator in ("monte_carlo", "sobol", "control_variates"):
            method = rendered(integrator=integrator, direct_sampling=sampling)
            outcome = method(scene, options.samples // 4, 1)
            error = relative_error(outcome.picture, truth)
            cells.append(f"{error:.4f} ({outcome.seconds:.2f} s)")
            if integrator == "monte_carlo":
                pictures[sampling], errors[sampling] = outcome.picture, error
        rows.append(cells)
    side_by_side(options.output / f"5_3_{name}.png", name, pictures, errors)
    return table(("5.3, scene", "sampled", "monte carlo", "sobol", "control variates"), rows)


def figure_4(scene: Scene, name: str, truth: np.ndarray, options: argparse.Namespace) -> str:
    """Equal samples."""
    pictures, errors, rows = {}, {}, []
    for label, (method, _) in METHODS.items():
        outcome = method(scene, options.samples, 1)
        pictures[label], errors[label] = outcome.picture, relative_error(outcome.picture, truth)
        mean = outcome.picture.mean() / truth.mean()
        rows.append(
            [name, label, f"{errors[label]:.4f}", f"{outcome.seconds:.2f}", outcome.cost, f"{mean:.4f}"]
        )
    side_by_side(options.output / f"5_4_{name}.png", name, {**pictures, "reference": truth}, errors)
    return table(
        ("5.4, scene", "method", "relative RMSE", "seconds", "a pixel", "mean of the reference's"), rows
    )


def figure_5(scene: Scene, name: str, truth: np.ndarray, options: argparse.Namespace) -> str:
    """Error against samples, and against seconds."""
    by_samples, by_seconds = {}, {}
    for label, (method, _) in METHODS.items():
        samples = [n for n in (4, 8, 16, 32, 64, 128, 256) if n <= 4 * options.samples]
        outcomes = [(n, method(scene, n, 2)) for n in samples]
        found = [(n, outcome.seconds, relative_error(outcome.picture, truth)) for n, outcome in outcomes]
        by_samples[label] = [(n, error) for n, _, error in found]
        by_seconds[label] = [(seconds, error) for _, seconds, error in found]
    colours = {label: colour for label, (_, colour) in METHODS.items()}
    panels = {f"{name}: rmse over samples": by_samples, "rmse over seconds": by_seconds}
    log_log(options.output / f"5_5_{name}.png", panels, colours)
    (options.output / f"5_5_{name}.json").write_text(json.dumps(panels), "utf-8")
    counts = [n for n, _ in next(iter(by_samples.values()))]
    rows = [
        [name, label, *(f"{error:.4f} ({seconds:.2f} s)" for seconds, error in by_seconds[label])]
        for label in METHODS
    ]
    return table(("5.5, scene", "method", *(f"{n} samples" for n in counts)), rows)


FIGURES = {"5.3": figure_3, "5.4": figure_4, "5.5": figure_5}


def scenes(options: argparse.Namespace) -> Iterable[tuple[str, Scene]]:
    width, height = options.size
    for name in options.scenes:
        if name != "dragon":
            yield name, core.example(name, width, height)
        elif options.assets is not None and (Path(options.assets) / MESH).is_file():
            yield name, core.scene(dragon(Path(options.assets)), width, height)
        else:
            print(f"dragon is left out: --assets FOLDER with {MESH} is missing")


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench thesis", description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("--chapter", type=int, choices=[5], default=5)
    add("--figures", nargs="+", choices=FIGURES, default=list(FIGURES), metavar="5.N")
    add("--scenes", nargs="+", choices=CROPS, default=list(CROPS), metavar="NAME", help=", ".join(CROPS))
    add("--size", type=int, nargs=2, default=(320, 180), metavar=("WIDTH", "HEIGHT"))
    add(
        "--samples",
        type=int,
        default=64,
        help="of a pixel in 5.4; 5.3: a quarter, 5.5: up to four times that",
    )
    add("--reference-samples", type=int, default=4096)
    add("--anew", action="store_true", help="references again: the pictures have changed")
    add("--assets", type=Path, default=os.environ.get("CV_RENDER_ASSETS"), metavar="FOLDER",
        help="has the dragon's mesh (else: the environment's CV_RENDER_ASSETS)")  # fmt: skip
    add("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    options = parser.parse_args()
    options.output.mkdir(parents=True, exist_ok=True)
    tables = []
    for name, scene in scenes(options):
        truth = reference(scene, f"{name}-{options.size[0]}x{options.size[1]}", options)
        for figure in options.figures:
            if figure == "5.3" and name != "veach_plates":
                continue
            tables.append(FIGURES[figure](scene, name, truth, options))
            print(f"\n{tables[-1]}\n", flush=True)
    (options.output / "tables.md").write_text("\n\n".join(tables) + "\n", "utf-8")


if __name__ == "__main__":
    main()
