# SPDX-License-Identifier: GPL-3.0-or-later
"""Chapter 5, direct illumination: pictures, tables and curves.

5.3: lights sampled, BSDFs sampled, and both by multiple importance sampling. 5.4: four ways to spend equal
samples. 5.5: error against samples and seconds. The thesis' guided path tracer is stood in for by the
simplest thing of its kind: chances of lights and places on them, learned for each block of the picture.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from engine_core import Scene
from engine_core.settings import DIRECT_SAMPLING
from engine_core.transport.direct_light import DirectLight, DirectLightOverTile

from .common import (
    Details,
    Methods,
    Outcome,
    Study,
    curves,
    equal_samples,
    integrated,
    rendered,
    side_by_side,
    table,
    values_on_screen,
)

DETAILS: Mapping[str, Details] = {
    "veach_plates": ((0.20, 0.34), (0.62, 0.34)),
    "violin": ((0.38, 0.35), (0.55, 0.72)),
    "dragon": ((0.25, 0.38), (0.42, 0.66)),
}
BLOCK, CELLS, UNLEARNED = 16, 4, 0.3
"""Of the learned chances: pixels of a block, places along a light's edges, and the part that stays even."""


# The picture as a function of the unit cube


class EvenChoice:
    """Every light with the same chance, at every point."""

    def __init__(self, lights: int) -> None:
        self._lights = lights

    def choose(
        self, position, normal, cell, w, kind=None, highlights=None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        x = w.reshape(-1) * self._lights
        light = np.minimum(x.astype(np.intp), self._lights - 1)
        chance = np.full(light.shape, 1 / self._lights, np.float32)
        return light, chance, np.clip(x - light, 0, np.float32(1 - 2.0**-24))

    def pdf(self, light, position, normal, cell, kind=None, highlights=None) -> np.ndarray:
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
        self.dimensions = 5 if self._direct.chooses_piece else 4
        self.width, self.height = self.scene.camera.region_size

    def values(self, screen: np.ndarray, light: np.ndarray, place: np.ndarray) -> np.ndarray:
        """(3, N) radiance times the number of lights, at screen (2, N) row and column in [0, 1].

        light : (N,) numbers in [0, 1), which light. place : (2, N) on it.
        """
        rest = np.concatenate([place, light[None]])[: self._integrand.rest_dimensions]
        return values_on_screen(self._integrand, self.width, self.height, screen, rest)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """(3, N) at points (D, N), for `integrate`."""
        if self.dimensions == 5:
            return self.values(u[:2], u[4], u[2:4])
        parts = u[2] * self.lights
        inside = parts - np.minimum(np.floor(parts), max(self.lights - 1, 0))
        return self.values(u[:2], u[2], np.stack([inside, u[3]]))


# Ways to make a picture


def learned(scene: Scene, samples: int, seed: int) -> Outcome:
    """A quarter of the samples anywhere; the rest where a block of pixels has found light by these."""
    begin, random = time.process_time(), np.random.default_rng(seed)
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
    return Outcome(picture, time.process_time() - begin, f"{samples:.1f} samples")


METHODS: Methods = {
    "plain monte carlo": (integrated(PrimarySpace, method="monte_carlo"), (150, 150, 150)),
    "learned": (learned, (60, 150, 70)),
    # A sixteenth of the samples for the control variate, all others for the residual.
    "thesis 2020": (integrated(PrimarySpace, preset="thesis_2020"), (235, 140, 30)),
    "cv render, sobol": (rendered(integrator="sobol"), (30, 110, 200)),
    "cv render": (rendered(), (210, 40, 40)),
}


# The figures


def figure_3(study: Study) -> str:
    """Lights, BSDFs and both, by plain samples; errors of control variates beside them."""
    pictures, errors, rows = {}, {}, []
    for sampling in DIRECT_SAMPLING:
        cells = [study.name, sampling]
        for integrator in ("monte_carlo", "sobol", "control_variates"):
            method = rendered(integrator=integrator, direct_sampling=sampling)
            outcome = method(study.scene, study.samples // 4, 1)
            error = study.error(outcome)
            cells.append(f"{error:.4f} ({outcome.seconds:.2f} s)")
            if integrator == "monte_carlo":
                pictures[sampling], errors[sampling] = outcome.picture, error
        rows.append(cells)
    side_by_side(study.output / f"5_3_{study.name}.png", DETAILS[study.name], pictures, errors)
    return table(("5.3, scene", "sampled", "monte carlo", "sobol", "control variates"), rows)


def figure_4(study: Study) -> str:
    return equal_samples(study, "5.4", f"5_4_{study.name}.png", DETAILS[study.name], METHODS)


def figure_5(study: Study) -> str:
    return curves(study, "5.5", f"5_5_{study.name}", METHODS)


FIGURES = {
    "5.3": (figure_3, ("veach_plates",)),
    "5.4": (figure_4, tuple(DETAILS)),
    "5.5": (figure_5, tuple(DETAILS)),
}
"""Each with its scenes."""


def prepared(scene: Scene) -> Scene:
    """All of a scene is shown."""
    return scene
