# SPDX-License-Identifier: GPL-3.0-or-later
"""Highlights among many lights: quick estimates near the truth, and pictures that are true in the mean."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenes import blocks, floor, mixed_lights, pictures, studio

from engine_core import Camera, Material, PointLight, Scene, World
from engine_core.bsdf.diffuse import Lambert
from engine_core.bsdf.microfacet import GGX
from engine_core.shading.closures import Principled
from engine_core.transport.highlights import BY_IRRADIANCE, Highlights
from engine_core.transport.light_choice import WEIGHED
from engine_core.transport.surface_shading import Slot

NONE_AROUND = np.zeros(0, np.intp)


def directions(random: np.random.Generator, *shape: int) -> np.ndarray:
    """(3, *shape) float32 unit vectors above the surface z = 0."""
    vectors = random.normal(size=(3, *shape))
    vectors[2] = np.abs(vectors[2]) + 0.02
    return (vectors / np.linalg.norm(vectors, axis=0)).astype(np.float32)


def mirrored(viewer: np.ndarray) -> np.ndarray:
    return viewer * np.array([-1, -1, 1], np.float32)[:, None]


def highlights_of(viewer: np.ndarray, alpha: float, diffuse: float) -> tuple[Highlights, GGX]:
    count = viewer.shape[1]
    normal = np.zeros_like(viewer)
    normal[2] = 1
    lobe = GGX.of(np.ones((3, count), np.float32), normal, viewer, (alpha, alpha), None, None)
    matte = Lambert(np.full((3, count), np.pi * diffuse, np.float32), normal, viewer)
    return Highlights.of([Slot(matte, None, False), Slot(lobe, None, True)], count), lobe


@pytest.mark.parametrize("alpha", [1e-4, 0.01, 0.1, 0.5, 1.0])
def test_estimates_of_point_lights_are_nearly_the_brdf(alpha):
    """Two lights of equal irradiance: their ratio is that of the BRDF, to a factor that masking explains."""
    random = np.random.default_rng(1)
    viewer = directions(random, 4000)
    highlights, lobe = highlights_of(viewer, alpha, 0.0)
    # One anywhere, one near the mirrored direction, where the lobe is.
    other = mirrored(viewer) + np.float32(0.5 * alpha) * random.normal(size=viewer.shape).astype(np.float32)
    other[2] = np.maximum(other[2], 0.02)
    other /= np.linalg.norm(other, axis=0)
    lights = np.stack([directions(random, 4000), other], axis=1)
    even = np.ones((2, 4000), np.float32)
    preference = highlights.preference(even, lights, np.zeros_like(even), NONE_AROUND)
    preference = (preference - BY_IRRADIANCE) / (1 - BY_IRRADIANCE)
    truth = np.stack([lobe.evaluate(None, lights[:, k])[0][0] / lights[2, k] for k in (0, 1)])
    share, wanted = preference[1] / 2, truth[1] / truth.sum(axis=0)
    with np.errstate(divide="ignore"):
        odds, wanted = share / (1 - share), wanted / (1 - wanted)
    clear = np.isfinite(wanted) & (wanted > 1e-3) & (wanted < 1e3) & (share > 1e-3) & (share < 0.999)
    if alpha >= 0.1:
        assert clear.sum() > 400  # or nothing would be shown
    ratio = odds[clear] / wanted[clear]
    assert (ratio > 0.45).all() and (ratio < 2.2).all()
    # What is mirrored is preferred wherever the BRDF says so by far.
    far = truth[1] > 100 * truth[0]
    assert (preference[1, far] > 1.9).all()


def test_preference_keeps_the_sum_of_irradiance():
    random = np.random.default_rng(2)
    viewer = directions(random, 500)
    highlights, _ = highlights_of(viewer, 0.03, 0.1)
    irradiance = (10 ** random.uniform(-6, 6, (9, 500))).astype(np.float32)
    spread = random.uniform(0, 0.5, (9, 500)).astype(np.float32)
    preference = highlights.preference(irradiance, directions(random, 9, 500), spread, np.array([8]))
    assert (preference >= BY_IRRADIANCE).all()
    total = (irradiance * preference).sum(axis=0, dtype=np.float64)
    assert total == pytest.approx(irradiance.sum(axis=0, dtype=np.float64), rel=1e-4)


@pytest.mark.parametrize("irradiance", [0.0, 1e-38, 1.0, 1e30])
@pytest.mark.parametrize("alpha", [1e-4, 1.0])
def test_nothing_makes_it_other_than_positive_and_finite(irradiance, alpha):
    random = np.random.default_rng(3)
    viewer = directions(random, 200)
    viewer[:, :50] = np.array([[1], [0], [0]], np.float32)  # along the surface
    highlights, _ = highlights_of(viewer, alpha, 0.0)
    lights = directions(random, 6, 200)
    lights[:, 0] = mirrored(viewer)
    lights[:, 1] = -viewer
    lights[:, 2] = 0
    light = np.full((6, 200), irradiance, np.float32)
    with np.errstate(all="ignore"):
        preference = highlights.preference(light, lights, np.zeros_like(light), NONE_AROUND)
    assert np.isfinite(preference).all() and (preference >= BY_IRRADIANCE).all()


def test_smooth_lobes_have_none():
    normal = directions(np.random.default_rng(0), 5)
    assert Highlights.of(None, 5) is None
    assert Highlights.of([Slot(Lambert(np.ones((3, 5), np.float32), normal, normal), None, False)], 5) is None


@pytest.mark.parametrize(("count", "sampling"), [(12, "mis"), (12, "light"), (WEIGHED + 12, "mis")])
def test_glossy_surfaces_are_true_in_the_mean(count, sampling):
    """Of lights of all kinds and the world: the sum of pictures of one light each needs no choice."""
    shiny = (
        Material(surface=Principled((0.3, 0.2, 0.1), roughness=0.35)),
        Material(
            surface=Principled(
                (0.6, 0.5, 0.2), metallic=1.0, roughness=0.6, coat_weight=0.5, coat_roughness=0.25
            )
        ),
    )
    world = World(0.05, visible_to_camera=False)
    scene = dataclasses.replace(studio(16, 16, mixed_lights(count), world=world), materials=shiny)
    dark = dataclasses.replace(scene, lights=(), world=World(0.0))
    alone = [dataclasses.replace(dark, lights=[light]) for light in scene.lights]
    alone.append(dataclasses.replace(dark, world=world))
    by = {"direct_sampling": sampling, "integrator": "sobol"}
    wanted = sum(blocks(pictures(one, 4, samples=64, first=5000, **by)) for one in alone)
    error = wanted.std(axis=0, ddof=1) / 2
    estimates = blocks(pictures(scene, 32, samples=4, **by))
    own = estimates.std(axis=0, ddof=1) / np.sqrt(32)
    assert (own < 0.02 * wanted.mean(axis=0)).all()  # or nothing would be shown
    # 3 channels of one block, and what four seeds know of their own spread.
    assert (np.abs(estimates.mean(axis=0) - wanted.mean(axis=0)) < 4 * own + 6 * error).all()


def test_a_floor_that_mirrors_many_small_lamps_is_quiet():
    """Each pixel mirrors one lamp at most, which irradiance alone would choose once in twenty times."""
    lamps = [PointLight(4.0, position=(x, 3.0, 1.0), radius=0.03) for x in np.linspace(-2.5, 2.5, 20)]
    material = Material(surface=Principled((0.1, 0.1, 0.1), roughness=0.3))
    camera = Camera.look_at((0, -5, 1.2), (0, 0, 0), 48, 24)
    scene = Scene(camera, (floor(),), (material,), lamps)
    truth = pictures(scene, 1, samples=512, integrator="sobol", first=77)[0]
    noisy = pictures(scene, 4, samples=1, integrator="sobol")
    error = np.sqrt(np.square(noisy - truth).mean() / np.square(truth).mean())
    assert error < 0.15
