# SPDX-License-Identifier: GPL-3.0-or-later
"""The mean over many seeds is the truth, on the picture and on every block of 16 x 16 pixels."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from scenes import (
    WHITE,
    area_light,
    assert_mean,
    blocks,
    floor,
    mixed_lights,
    patch_camera,
    pictures,
    place,
    studio,
)

from engine_core import Camera, Mesh, PointLight, Scene, Settings, SunLight, World, render
from engine_core.transport.light_choice import WEIGHED

SEEDS = 64
SCENES = {
    "one light": studio(32, 32, [area_light()]),
    "world": studio(32, 32, world=World((0.4, 0.5, 0.6))),
    "mixed lights": studio(32, 32, mixed_lights(6), world=World(0.1)),
}


CONVERGED = {"integrator": "sobol", "first": 5000}
"""By plain nets, five times as fast as many samples of a residual, and of other seeds than what is tested."""


@cache
def truth(name: str, samples: int = 512, seeds: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """Block means (rows, columns, 3) of the converged picture, and their standard errors.

    Light is additive: the sum of pictures of one light each needs no choice among lights.
    """
    scene = SCENES[name]
    dark = dataclasses.replace(scene, lights=(), world=World(0.0, visible_to_camera=False))
    alone = [dataclasses.replace(dark, lights=[light]) for light in scene.lights]
    if scene.world.radiance.any():
        alone.append(dataclasses.replace(dark, world=scene.world))
    estimates = sum(blocks(pictures(one, seeds, samples=samples, **CONVERGED)) for one in alone)
    return estimates.mean(axis=0), estimates.std(axis=0, ddof=1) / np.sqrt(seeds)


def assert_true_in_the_mean(estimates: np.ndarray, wanted: np.ndarray, error: np.ndarray) -> None:
    """Block means (S, rows, columns, 3) of S seeds against `truth`, each block and the whole picture."""
    seeds = np.sqrt(len(estimates))
    own = estimates.std(axis=0, ddof=1) / seeds
    z = np.abs(estimates.mean(axis=0) - wanted) / np.sqrt(own**2 + error**2 + (1e-5 * wanted) ** 2 + 1e-16)
    assert z.max() < 4
    picture = estimates.mean(axis=(1, 2))
    own = picture.std(axis=0, ddof=1) / seeds
    error = np.sqrt(own**2 + np.square(error).mean(axis=(0, 1)))
    assert (np.abs(picture.mean(axis=0) - wanted.mean(axis=(0, 1))) < 4 * error).all()


@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
@pytest.mark.parametrize(
    ("name", "light_samples"),
    [
        ("one light", 1),
        ("one light", 4),
        ("world", 1),
        ("mixed lights", 1),
        ("mixed lights", 2),
        ("mixed lights", 4),
    ],
)
def test_mean_over_seeds_is_the_truth(name, light_samples, integrator):
    wanted, error = truth(name)
    estimates = blocks(
        pictures(SCENES[name], SEEDS, samples=4, light_samples=light_samples, integrator=integrator)
    )
    assert_true_in_the_mean(estimates, wanted, error)


@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
@pytest.mark.parametrize("light_samples", [1, 2, 4])
def test_two_hundred_lights_add_to_their_closed_form(light_samples, integrator):
    random = np.random.default_rng(3)
    positions = random.uniform((-4, -4, 0.05), (4, 4, 3), (200, 3))
    powers = 10 ** random.uniform(-2, 2, (200, 1)) * random.random((200, 3))
    lights = [PointLight(p, position=x) for p, x in zip(powers, positions, strict=True)]
    camera = patch_camera(pixels=32)
    offset = positions - camera.camera_to_world[:3, 3] * (1, 1, 0)
    distance = np.linalg.norm(offset, axis=1)
    irradiance = (powers / (4 * np.pi) * (offset[:, 2] / distance**3)[:, None]).sum(axis=0)
    scene = Scene(camera, (floor(),), (WHITE,), lights)
    estimates = np.pi * pictures(scene, SEEDS, samples=2, light_samples=light_samples, integrator=integrator)
    assert_mean(blocks(estimates), irradiance, rounding=1e-4)


def test_light_that_no_pilot_sees_is_still_found():
    """Dozens of lights on a floor, and one that reaches but a tilted chip of a pixel's size."""
    chip = Mesh([[0.1, -0.02, 0.3], [0.1, 0.06, 0.3], [0.14, -0.02, 0.2]], [[0, 1, 2]], name="Chip")
    camera = Camera(place((0, 0, 2)), (-0.5, 0.5, -0.5, 0.5), 16, 16, projection="orthographic")
    above = SunLight(1.0, direction=(0, 0, -1))
    # It grazes the floor, which gets nothing from it.
    level = SunLight(900.0, direction=(-1, 0, 0))
    dark = Scene(camera, (floor(), chip), (WHITE,))
    alone = []
    for light in (above, level):
        alone.append(blocks(pictures(dataclasses.replace(dark, lights=[light]), 8, samples=256, **CONVERGED)))
    assert (alone[1].mean(axis=0) > 0.5 * alone[0].mean(axis=0)).all()
    wanted = sum(estimate.mean(axis=0) for estimate in alone)
    many = [dataclasses.replace(above, power=above.power / WEIGHED)] * WEIGHED + [level]
    estimates = blocks(pictures(dataclasses.replace(dark, lights=many), SEEDS, samples=64))
    own = estimates.std(axis=0, ddof=1) / np.sqrt(SEEDS)
    error = np.sqrt(sum(estimate.var(axis=0, ddof=1) for estimate in alone) / 8)
    assert (own < 0.25 * wanted).all()  # or nothing would be shown
    assert (np.abs(estimates.mean(axis=0) - wanted) < 4 * np.hypot(own, error)).all()


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("edge", [0.03, 0.5, 0.92])
def test_pixel_is_the_mean_over_its_whole_square(axis, edge, projection):
    """A sheet that ends within a pixel covers as much of it as its area says."""
    pixels, where = 8, 5
    low, high = [-9.0, -9.0], [9.0, 9.0]
    high[axis] = (where + edge) / pixels * 2 - 1
    corners = [[x, y, -1] for x, y in (low, (high[0], low[1]), high, (low[0], high[1]))]
    sheet = Mesh(corners, [[0, 1, 2], [0, 2, 3]])
    camera = Camera(np.eye(4), (-1, 1, -1, 1), pixels, pixels, projection=projection)
    film = render(Scene(camera, [sheet]), Settings(samples=256, transparent=True))
    wanted = np.clip(where + edge - np.arange(pixels), 0, 1)
    alpha = film.combined[..., 3] if axis == 0 else film.combined[..., 3].T
    assert np.abs(alpha - wanted).max() <= 1 / 256


@cache
def converged() -> np.ndarray:
    """(H, W, 3) of one light: off by 1/14 of the error of 64 Sobol samples."""
    return pictures(SCENES["one light"], 4, samples=1024, **CONVERGED).mean(axis=0)


@pytest.mark.parametrize(("samples", "factor"), [(16, 2.0), (64, 2.5)])
def test_sobol_beats_chance_on_an_area_light(samples, factor):
    scene = SCENES["one light"]
    error = {
        name: np.sqrt(np.square(pictures(scene, 4, samples=samples, integrator=name) - converged()).mean())
        for name in ("sobol", "monte_carlo")
    }
    assert error["monte_carlo"] > factor * error["sobol"]


def test_error_of_chance_falls_with_the_root_of_the_samples():
    scene = SCENES["one light"]
    few, many = (
        np.square(pictures(scene, 4, samples=n, integrator="monte_carlo") - converged()).mean()
        for n in (4, 64)
    )
    assert few / many == pytest.approx(16, rel=0.15)


@pytest.mark.full
@pytest.mark.parametrize(("threshold", "least"), [(0.05, 4), (0.05, 16), (0.02, 16)])
def test_noise_threshold_biases_no_more_than_the_manual_says(threshold, least):
    """Optional stopping: blocks that happen to look quiet stop. docs/sampling.md states these bounds."""
    scene = studio(64, 64, mixed_lights(6), world=World(0.1))
    settings = Settings(samples=256, noise_threshold=threshold, min_samples=least)
    seeds = 128
    wanted = blocks(pictures(scene, 8, samples=1024))
    estimates = blocks(pictures(scene, seeds, settings))
    assert _mean_bias(estimates, wanted) < 1e-3
    bias = np.abs(estimates.mean(axis=0) - wanted.mean(axis=0))
    noise = np.sqrt(estimates.var(axis=0, ddof=1) / seeds + wanted.var(axis=0, ddof=1) / 8)
    assert (bias < 5e-3 * wanted.mean(axis=0) + 4 * noise).all()


def _mean_bias(estimates: np.ndarray, wanted: np.ndarray) -> float:
    """Relative bias of the picture's mean."""
    return abs(estimates.mean() / wanted.mean() - 1)


def test_render_is_what_the_tests_of_seeds_average():
    scene = SCENES["one light"]
    film = render(scene, Settings(seed=1000, threads=1, samples=4))
    assert np.array_equal(pictures(scene, 1, samples=4)[0], film.combined[..., :3])
