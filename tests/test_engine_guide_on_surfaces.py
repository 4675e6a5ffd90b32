# SPDX-License-Identifier: GPL-3.0-or-later
"""What pilots learn of the sky that surfaces see: pictures are right by it, and better."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import box, picture_of_sky, walls_with_window

from engine_core import Camera, Material, PointLight, Scene, Settings, Sink, World, render
from engine_core.integration.mapping import in_order
from engine_core.parts import pixels_at
from engine_core.shading.closures import Add, Diffuse, Glossy
from engine_core.transport import guide_on_surfaces as module
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.guide_on_surfaces import guide_of_sky

SIZE = 48, 32
SEEDS = 24


def room(material: Material | None = None, world: World | None = None, **changes) -> Scene:
    """Walls about a box, and a window in one of them that lets in the sky."""
    scene = Scene(
        Camera.look_at((-1.5, -2.5, 1.5), (0.5, 2, 1.2), *SIZE, 1.2, clip_start=0.05),
        [*walls_with_window((0.6, 1.8)), box((0, 0.5, 0), (1, 1.5, 0.8))],
        [material or Material(0.7)],
        world=world or World((0.5, 0.7, 1.0)),
    )
    return replace(scene, **changes)


def learned(scene: Scene, samples: int = 4):
    region = scene.camera.region
    guide, _ = guide_of_sky(
        DirectLight(scene), partial(pixels_at, region), region, 1, samples, in_order, lambda: None
    )
    return guide


def pictures(scene: Scene, seeds: int = SEEDS, **settings) -> np.ndarray:
    """(seeds, H, W, 3)."""
    return np.stack([
        render(scene, Settings(seed=seed, threads=1, **settings)).combined[..., :3].astype(np.float64)
        for seed in range(seeds)
    ])  # fmt: skip


SHINY = Material(surface=Add(Diffuse(0.4), Glossy(0.4, roughness=0.3)))
LAMPS = [PointLight(2.0, position=(-2 + 0.4 * i, -1, 2.5)) for i in range(10)]
SCENES = {
    "diffuse": room(),
    "gloss": room(SHINY),
    "picture": room(world=World(image=picture_of_sky())),
    "picture, gloss": room(SHINY, World(image=picture_of_sky())),
    "a lamp besides": room(lights=[PointLight(3.0, position=(0, 0, 2.6), radius=0.2)]),
    "many lamps": room(lights=LAMPS),
    "lens": room(
        camera=replace(room().camera, aperture=0.05, focus_distance=3.0),
    ),
}


CASES = [(name, 1) for name in SCENES] + [("diffuse", 4), ("picture, gloss", 4), ("a lamp besides", 4)]


@pytest.mark.parametrize(("name", "samples"), CASES)
def test_mean_over_seeds_is_that_of_plain_samples(name, samples):
    scene = SCENES[name]
    assert learned(scene, samples) is not None
    # Of a sun that few points meet, few seeds do not know their own variance.
    count = 2 * SEEDS if "picture" in name else SEEDS
    # Of 24 blocks of 8 x 8 pixels.
    found, truth = (
        pictures(scene, seeds, **settings).reshape(seeds, 4, 8, 6, 8, 3).mean(axis=(2, 4)).sum(axis=-1)
        for seeds, settings in ((count, {"samples": samples}), (4, {"samples": 512, "integrator": "sobol"}))
    )
    variance = found.var(axis=0, ddof=1) / count + truth.var(axis=0, ddof=1) / 4
    z = (found.mean(axis=0) - truth.mean(axis=0)) / np.sqrt(variance)
    # Variances of 23 degrees of freedom: 1.1 in the mean, and .34 of standard deviation.
    assert np.square(z).mean() < 2.5
    whole = [a.mean(axis=(1, 2)) for a in (found, truth)]
    error = np.sqrt(whole[0].var(ddof=1) / count + whole[1].var(ddof=1) / 4)
    assert abs(whole[0].mean() - whole[1].mean()) < 4 * error


def error_of(scene: Scene, samples: int) -> float:
    found = pictures(scene, 8, samples=samples)
    return float(np.sqrt(found.var(axis=0, ddof=1).mean()) / found.mean())


@pytest.mark.parametrize(
    ("name", "samples", "part"), [("diffuse", 1, 0.85), ("diffuse", 8, 0.7), ("picture", 4, 0.85)]
)
def test_error_is_less_than_without(name, samples, part, monkeypatch):
    by_guide = error_of(SCENES[name], samples)
    monkeypatch.setattr(module.Guide, "of", staticmethod(lambda *_: None))
    assert by_guide < part * error_of(SCENES[name], samples)


def test_nothing_is_learned_under_the_open_sky_nor_of_lamps_nor_for_other_integrators(monkeypatch):
    floor = Scene(
        Camera.look_at((0, -4, 2), (0, 0, 0), *SIZE, 1.0),
        [box((-9, -9, -1), (9, 9, 0)), box((-0.5, -0.5, 0), (0.5, 0.5, 1))],
        [Material(0.7)],
        world=World((0.5, 0.7, 1.0)),
    )
    assert learned(floor) is None
    # Its highlights are what lobes sample.
    assert learned(replace(floor, materials=[SHINY])) is None
    assert learned(room(world=World(), lights=[PointLight(3.0, position=(0, 0, 2.6), radius=0.2)])) is None
    assert learned(room(Material(0.0))) is None
    asked = []
    monkeypatch.setattr(module.Guide, "of", staticmethod(lambda *_: asked.append(1)))
    for integrator in ("sobol", "monte_carlo", "quadrature"):
        render(room(), Settings(samples=16, integrator=integrator, threads=1))
    assert not asked
    render(room(), Settings(samples=1, threads=1))
    assert asked


def test_a_picture_of_the_sky_whose_ends_are_black_gives_no_sample_that_is_not_finite():
    image = np.zeros((16, 32, 3), np.float32)
    image[6:10, 14:18] = 5
    film = render(room(world=World(image=image)), Settings(samples=4, threads=1))
    assert film.messages == [] and film.statistics["non-finite samples"] == 0


def test_pilots_can_be_cancelled():
    class Impatient(Sink):
        def __init__(self):
            self.texts = []

        def cancelled(self):
            return True

        def progress(self, fraction, elapsed, remaining, text):
            self.texts.append(text)

    sink = Impatient()
    film = render(room(), Settings(samples=4, threads=1), sink)
    assert film.stopped_by == "cancel" and "Looking for the sky" in sink.texts
    assert np.isfinite(film.combined).all()


def test_the_same_picture_by_any_number_of_threads():
    one, two = (render(room(), Settings(samples=2, threads=n)).combined for n in (1, 2))
    np.testing.assert_array_equal(one, two)
