# SPDX-License-Identifier: GPL-3.0-or-later
"""What the figures of all chapters share: ways to make a picture, its error, pictures and curves."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from engine_core import Scene, Settings, render
from engine_core.integration import integrate
from engine_core.integration.integrand import StagedIntegrand, values_at
from engine_core.transport.direct_light import Pixels

from ..method_figures import BLACK, GREY, PALE, Canvas, Colour

CROP = 0.16
"""Width and height of a detail, as parts of the picture's width."""
LETTER = 10
"""Pixels that one takes at most."""
SAMPLES = (4, 8, 16, 32, 64, 128, 256)
"""Of the curves."""

Details = tuple[tuple[float, float], tuple[float, float]]
"""Where two details begin: parts of the width and, from the top, of the height."""


@dataclass(frozen=True)
class Outcome:
    """picture : (H, W, 3), row 0 at the bottom. seconds : of all processors. cost : rays, as words."""

    picture: np.ndarray
    seconds: float
    cost: str


Method = Callable[[Scene, int, int], Outcome]
"""Of a scene, samples a pixel and seed."""
Methods = Mapping[str, tuple[Method, Colour]]
"""With the colour of its curve."""


@dataclass(frozen=True)
class Study:
    """One scene in a figure's hands.

    halves : two converged pictures (H, W, 3), independent. samples : of a pixel, where all are equal.
    output : the folder.
    """

    name: str
    scene: Scene
    halves: tuple[np.ndarray, np.ndarray]
    samples: int
    output: Path
    _made: dict[tuple[str, int], Outcome] = field(default_factory=dict)

    @property
    def truth(self) -> np.ndarray:
        return (self.halves[0] + self.halves[1]) / 2

    def outcome(self, methods: Methods, name: str, samples: int) -> Outcome:
        """What one of ``methods`` makes with so many samples; figures share it."""
        if (name, samples) not in self._made:
            self._made[name, samples] = methods[name][0](self.scene, samples, 1)
        return self._made[name, samples]

    def error(self, outcome: Outcome) -> float:
        return relative_error(outcome.picture, *self.halves)


# Ways to make a picture


class OnScreen(Protocol):
    """A picture as a plain function of the unit cube, for `integrate`."""

    width: int
    height: int
    dimensions: int

    def __call__(self, u: np.ndarray) -> np.ndarray: ...


def values_on_screen(
    integrand: StagedIntegrand, width: int, height: int, screen: np.ndarray, rest: np.ndarray
) -> np.ndarray:
    """(3, N) of an integrand over `Pixels`, at screen (2, N) row and column in [0, 1], and rest (D, N)."""
    size = np.array([[height], [width]])
    index = np.minimum((screen * size).astype(np.int32), size - 1).astype(np.int32)
    inside = (screen * size - index)[::-1, :, None]
    pixels = Pixels(index[1], index[0], np.zeros(index.shape[1], np.intp))
    with np.errstate(all="ignore"):  # as the renderer does
        stage = integrand.first(pixels, inside)
        return values_at(integrand, stage, index.shape[1], None, rest)[:3]


def integrated(space: Callable[[Scene], OnScreen], **how: object) -> Method:
    """By `integrate`, of what ``space`` makes of a scene."""

    def method(scene: Scene, samples: int, seed: int) -> Outcome:
        begin = time.process_time()
        f = space(scene)
        found = integrate(
            f, f.dimensions, (f.height, f.width), samples, seed=seed, dtype=np.float32, threads=0, **how
        )
        spent = found.evaluations / (f.width * f.height)
        return Outcome(np.moveaxis(found.value, 0, -1), time.process_time() - begin, f"{spent:.1f} samples")

    return method


def rendered(**choices: object) -> Method:
    """By the renderer."""

    def method(scene: Scene, samples: int, seed: int) -> Outcome:
        begin = time.process_time()
        film = render(scene, Settings(samples=samples, seed=seed, **choices))
        seconds, pixels = time.process_time() - begin, film.depth.size
        rays = (film.statistics[f"{kind} rays"] / pixels for kind in ("camera", "shadow"))
        return Outcome(
            film.combined[..., :3].astype(np.float64), seconds, "{:.1f} + {:.1f} rays".format(*rays)
        )

    return method


def relative_error(picture: np.ndarray, one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square error over the mean; NaN where the converged pictures are too noisy to tell it.

    The noise of the two converged pictures is independent, so the mean of the product of the differences
    to them is the picture's mean square error alone.
    """
    square = np.mean((picture - one) * (picture - other))
    return float(np.sqrt(square) / ((one + other) / 2).mean()) if square > 0 else np.nan


def own_error(one: np.ndarray, other: np.ndarray) -> float:
    """Root mean square error, over the mean, of the mean of two independent pictures."""
    return float(np.sqrt(np.mean((one - other) ** 2)) / (one + other).mean())


# Pictures and curves


def seen(picture: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of radiance with row 0 at the bottom, as a screen shows it."""
    light = np.clip(picture[::-1], 0, 1)
    curve = np.where(light < 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def side_by_side(
    path: Path, details: Details, pictures: Mapping[str, np.ndarray], errors: Mapping[str, float]
) -> None:
    """Each picture with its label and error, and below it two details, three times as large."""
    height, width = next(iter(pictures.values())).shape[:2]
    edge = round(CROP * width)
    scale = max(1, width // (2 * edge + 4))
    gap, top = 8, 22
    captions = [f"{label}: {errors[label]:.4f}" if label in errors else label for label in pictures]
    pitch = gap + max(width, LETTER * max(map(len, captions)))
    canvas = Canvas(len(pictures) * pitch + gap, top + height + gap + edge * scale + gap)
    for number, (caption, picture) in enumerate(zip(captions, pictures.values(), strict=True)):
        x, colours = gap + number * pitch, seen(picture)
        canvas.text(x, top / 2, caption)
        canvas.image(x, top, colours, 1)
        for k, (left, upper) in enumerate(details):
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
        curves = {label: [p for p in curve if np.isfinite(p).all()] for label, curve in curves.items()}
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
            places = [place(np.log10(point)) for point in curve]
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


# Figures that every chapter has


def equal_samples(study: Study, label: str, path: str, details: Details, methods: Methods) -> str:
    """Pictures of all methods side by side, with the same samples, and a table of them."""
    pictures, errors, rows = {}, {}, []
    for name in methods:
        outcome = study.outcome(methods, name, study.samples)
        pictures[name], errors[name] = outcome.picture, study.error(outcome)
        mean = outcome.picture.mean() / study.truth.mean()
        rows.append(
            [study.name, name, f"{errors[name]:.4f}", f"{outcome.seconds:.2f}", outcome.cost, f"{mean:.4f}"]
        )
    side_by_side(study.output / path, details, {**pictures, "reference": study.truth}, errors)
    head = (
        f"{label}, scene",
        "method",
        "relative RMSE",
        "processor seconds",
        "a pixel",
        "mean of the reference's",
    )
    return table(head, rows)


def curves(study: Study, label: str, path: str, methods: Methods) -> str:
    """Error against samples, and against processor seconds."""
    by_samples, by_seconds = {}, {}
    counts = [n for n in SAMPLES if n <= study.samples]
    for name in methods:
        outcomes = [(n, study.outcome(methods, name, n)) for n in counts]
        found = [(n, outcome.seconds, study.error(outcome)) for n, outcome in outcomes]
        by_samples[name] = [(n, error) for n, _, error in found]
        by_seconds[name] = [(seconds, error) for _, seconds, error in found]
    colours = {name: colour for name, (_, colour) in methods.items()}
    panels = {f"{study.name}: rmse over samples": by_samples, "rmse over processor seconds": by_seconds}
    log_log(study.output / f"{path}.png", panels, colours)
    (study.output / f"{path}.json").write_text(json.dumps(panels), "utf-8")
    rows = [
        [study.name, name, *(f"{error:.4f} ({seconds:.2f} s)" for seconds, error in by_seconds[name])]
        for name in methods
    ]
    return table((f"{label}, scene", "method", *(f"{n} samples" for n in counts)), rows)
