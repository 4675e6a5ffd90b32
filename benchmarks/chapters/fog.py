# SPDX-License-Identifier: GPL-3.0-or-later
"""Chapter 6, light scattered once by fog and by laser beams: pictures, tables and curves.

6.6: maps along the camera ray. 6.7: equal samples of plain Monte Carlo, quadrature along the ray (Munoz 2014)
and control variates. 6.8: error against samples and seconds. 6.9: where the error is. 6.12, 6.13: the same
of lasers. As in the thesis, it is the fog alone that is seen: all surfaces are black, they only cast shadows;
of a laser there is only what fog scatters out of its beam and then once more (eq. 6.10).
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from engine_core import Laser, Material, Scene, Settings
from engine_core.integration import Quadrature, integrate
from engine_core.settings import DISTANCE_SAMPLING
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.laser_in_fog import LaserInFog
from engine_core.transport.lasers import Lasers
from engine_core.transport.scattered_light import ScatteredLight
from engine_core.transport.single_scattering import SingleScattering

from ..method_figures import Canvas
from .common import (
    LETTER,
    Details,
    Method,
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

FOG: Mapping[str, Details] = {
    "occluder": ((0.52, 0.34), (0.05, 0.02)),
    "pumpkin": ((0.34, 0.42), (0.12, 0.16)),
    "lighthouse": ((0.31, 0.02), (0.52, 0.68)),
}
LASERS: Mapping[str, Details] = {
    "laser": ((0.30, 0.30), (0.68, 0.34)),
    "green_dragon": ((0.25, 0.28), (0.55, 0.38)),
}
DETAILS = {**FOG, **LASERS}

WAYS = {
    "monte carlo": {"method": "monte_carlo"},
    "sobol": {"method": "sobol"},
    "thesis 2020": {"preset": "thesis_2020"},
}
"""Of `integrate`, in which maps are compared: one point of each camera ray a sample."""
MAPS = [name for name in DISTANCE_SAMPLING if name != "auto"]


def prepared(scene: Scene) -> Scene:
    """Fog alone: surfaces are black, and neither lamps nor beams are seen."""
    lights = []
    for light in scene.lights:
        if isinstance(light, Laser):
            lights.append(replace(light, on_surfaces=False, beam=False, spot=False))
        else:
            lights.append(replace(light, visible_to_camera=False))
    return replace(scene, materials=[Material(0.0) for _ in scene.materials], lights=lights)


# The picture as a function of the unit cube


class FogOnScreen:
    """A scene's fog: (row, column, distance), and two more for places on lights where any has a size."""

    distance_dimension = 2

    def __init__(self, scene: Scene, distance_sampling: str = "equiangular") -> None:
        direct, scattering = _scattering(scene, distance_sampling)
        self.width, self.height = scene.camera.region_size
        self._integrand = ScatteredLight(scattering, np.arange(len(direct.lights)))
        self.dimensions = 2 + (self._integrand.rest_dimensions if scattering.sized.size else 1)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """(3, N) radiance at points (D, N), for `integrate`."""
        rest = np.full((self._integrand.rest_dimensions, u.shape[1]), np.float32(0.5))
        rest[: len(u) - 2] = u[2:]
        return values_on_screen(self._integrand, self.width, self.height, u[:2], rest)


class LasersOnScreen:
    """A scene's lasers in its fog, by the thesis' maps: (row, column, beam, distance)."""

    dimensions, distance_dimension = 4, 3

    def __init__(self, scene: Scene) -> None:
        direct, scattering = _scattering(scene, "auto")
        self.width, self.height = scene.camera.region_size
        lasers = Lasers.of(scene, direct.frame, direct.media, direct.shadows)
        self._integrand = LaserInFog(lasers, scattering, map="thesis_2020")

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """(3, N) radiance at points (4, N), for `integrate`."""
        return values_on_screen(self._integrand, self.width, self.height, u[:2], u[2:])


def _scattering(scene: Scene, distance_sampling: str) -> tuple[DirectLight, SingleScattering]:
    direct = DirectLight(scene)
    what = (getattr(direct, name) for name in ("frame", "media", "lights", "surfaces", "shader"))
    settings = Settings(distance_sampling=distance_sampling)
    return direct, SingleScattering(*what, direct.stage.rays, settings)


# Ways to make a picture


def _methods(space: type) -> Methods:
    return {
        "plain monte carlo": (integrated(space, method="monte_carlo"), (150, 150, 150)),
        "quadrature": (_quadrature(space), (60, 150, 70)),
        # A sixteenth of the samples for the control variate, all others for the residual.
        "thesis 2020": (integrated(space, preset="thesis_2020"), (235, 140, 30)),
        "cv render, sobol": (rendered(integrator="sobol"), (30, 110, 200)),
        "cv render": (rendered(), (210, 40, 40)),
    }


POINT_OF_QUADRATURE = 28
"""Evaluations that one camera ray costs it on the average, so that it spends about what it is given."""


def _quadrature(space: type) -> Method:
    """Nested along the ray alone, as in Munoz 2014: pixels, lights and beams are sampled."""

    def method(scene: Scene, samples: int, seed: int) -> Outcome:
        begin = time.process_time()
        f = space(scene)
        distance = f.distance_dimension
        back = np.argsort([d for d in range(f.dimensions) if d != distance] + [distance])
        bins = (f.height, f.width) + (1,) * (f.dimensions - 3)
        how = Quadrature(points=max(1, round(samples / POINT_OF_QUADRATURE)))

        def along_rays(u: np.ndarray) -> np.ndarray:
            return f(u[back])

        found = integrate(
            along_rays, f.dimensions, bins, samples, how, seed=seed, dtype=np.float32, threads=0
        )
        picture = np.moveaxis(found.value.reshape(3, f.height, f.width), 0, -1)
        spent = found.evaluations / (f.width * f.height)
        return Outcome(picture, time.process_time() - begin, f"{spent:.1f} samples")

    return method


METHODS, LASER_METHODS = _methods(FogOnScreen), _methods(LasersOnScreen)


# The figures


def figure_6(study: Study) -> str:
    """Maps along the camera ray, a quarter of the samples."""
    pictures, errors, rows = {}, {}, []
    for name in MAPS:
        cells = [study.name, name]
        space = partial(FogOnScreen, distance_sampling=name)
        for label, how in WAYS.items():
            method = integrated(space, **how)
            outcome = method(study.scene, study.samples // 4, 1)
            cells.append(f"{study.error(outcome):.4f} ({outcome.seconds:.2f} s)")
            if label == "monte carlo":
                pictures[name], errors[name] = outcome.picture, study.error(outcome)
        rows.append(cells)
    pictures["reference"] = study.truth
    side_by_side(study.output / f"6_6_{study.name}.png", DETAILS[study.name], pictures, errors)
    return table(("6.6, scene", "map", *WAYS), rows)


def figure_7(study: Study) -> str:
    return equal_samples(study, "6.7", f"6_7_{study.name}.png", DETAILS[study.name], METHODS)


def figure_8(study: Study) -> str:
    return curves(study, "6.8", f"6_8_{study.name}", METHODS)


def figure_9(study: Study) -> str:
    return error_maps(study, "6.9", f"6_9_{study.name}.png", METHODS)


def figure_12(study: Study) -> str:
    return equal_samples(study, "6.12", f"6_12_{study.name}.png", DETAILS[study.name], LASER_METHODS)


def figure_13(study: Study) -> str:
    maps = error_maps(study, "6.13", f"6_13_{study.name}_errors.png", LASER_METHODS)
    return f"{curves(study, '6.13', f'6_13_{study.name}', LASER_METHODS)}\n\n{maps}"


def error_maps(study: Study, label: str, path: str, methods: Methods) -> str:
    """Each method's absolute error in every pixel, relative to the picture's mean; a table of its spread."""
    height, width = study.truth.shape[:2]
    gap, top = 8, 22
    pitch = gap + max(width, LETTER * max(len(name) + 8 for name in methods))
    canvas = Canvas(len(methods) * pitch + gap, top + height + gap)
    rows = []
    for number, name in enumerate(methods):
        outcome = study.outcome(methods, name, study.samples)
        error = np.abs(outcome.picture - study.truth).mean(axis=-1) / study.truth.mean()
        x = gap + number * pitch
        canvas.text(x, top / 2, f"{name}: {study.error(outcome):.4f}")
        canvas.image(x, top, error_colours(error), 1)
        parts = (f"{np.quantile(error, part):.5f}" for part in (0.5, 0.9, 0.99, 1.0))
        rows.append([study.name, name, *parts])
    canvas.save(study.output / path)
    return table((f"{label}, scene", "error in", "half the pixels below", "nine tenths", "99 %", "all"), rows)


def error_colours(error: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 of relative errors (H, W), row 0 at the bottom: black at 0.0003, white at 1."""
    place = (np.log10(np.maximum(error[::-1], 1e-9)) + 3.5) / 3.5
    stops = np.array([(0, 0, 0), (40, 30, 140), (200, 40, 70), (250, 180, 30), (255, 255, 255)])
    at = np.linspace(0, 1, len(stops))
    return np.stack([np.interp(place, at, channel) for channel in stops.T], -1).round().astype(np.uint8)


FIGURES = {
    "6.6": (figure_6, tuple(FOG)),
    "6.7": (figure_7, tuple(FOG)),
    "6.8": (figure_8, tuple(FOG)),
    "6.9": (figure_9, tuple(FOG)),
    "6.12": (figure_12, tuple(LASERS)),
    "6.13": (figure_13, tuple(LASERS)),
}
"""Each with its scenes."""
