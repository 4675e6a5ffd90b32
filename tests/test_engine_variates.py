# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures by control variates, by quadrature, and by the control variate alone."""

from __future__ import annotations

import dataclasses
import time
from functools import cache

import numpy as np
import pytest
from scenes import WHITE, area_light, assert_mean, blocks, floor, mixed_lights, pictures, place, studio
from test_engine_unbiased import CONVERGED, assert_true_in_the_mean, truth
from test_engine_unbiased import SCENES as UNBIASED

from engine_core import AreaLight, Camera, Film, Material, PointLight, Scene, Settings, Sink, World, render
from engine_core.image.film import FAR

SEEDS = 48
CV = {"integrator": "control_variates"}
SCENES = {
    "one light": studio(48, 32, [area_light()]),
    "spheres": studio(
        48, 32, [PointLight(60, position=(1, -2, 3), radius=0.1), PointLight(40, position=(-2, -1, 2))]
    ),
    "mixed lights": studio(48, 32, mixed_lights(6), world=World(0.1)),
    "no light": studio(48, 32, world=World(0.0)),
}


@pytest.mark.parametrize("name", ["one light", "world", "mixed lights"])
@pytest.mark.parametrize(
    ("samples", "seeds"), [(1, SEEDS), pytest.param(4, SEEDS, marks=pytest.mark.full), (16, SEEDS // 2)]
)
def test_mean_over_seeds_is_the_truth(name, samples, seeds):
    wanted, error = truth(name)
    estimates = blocks(pictures(UNBIASED[name], seeds, samples=samples, **CV))
    assert_true_in_the_mean(estimates, wanted, error)


def test_irradiance_of_a_square_in_closed_form():
    # A square of edge 2, 1 above the middle of a floor: E = L * 4 * (F of a quarter), F in closed form.
    x = 1 / np.sqrt(2)
    form = 4 * 2 * x * np.arctan(x) / (2 * np.pi)
    light = AreaLight(
        4 * np.pi, light_to_world=place((0, 0, 1)), size=(2.0, 2.0), normalize=True
    )  # radiance 1
    camera = np.eye(4)
    camera[:3, 3] = (0, 0, 1 / 64)
    camera = Camera(camera, (-5e-4, 5e-4, -5e-4, 5e-4), 16, 16, projection="orthographic")
    scene = Scene(camera, (floor(),), (WHITE,), (light,), World(0.0, visible_to_camera=False))
    estimates = pictures(scene, 16, samples=16, **CV).mean(axis=(1, 2))
    assert_mean(estimates, form)


def test_the_picture_is_the_control_variate_and_the_residual():
    film = render(SCENES["one light"], Settings(samples=16, standard_error=True, **CV))
    assert film.statistics["regions"] > 50
    assert np.allclose(film.combined[..., :3], film.control_variate + film.residual, atol=1e-6)
    assert (film.control_variate != 0).any() and (film.residual != 0).any()
    assert np.isfinite(film.standard_error).all() and (film.standard_error >= 0).all()
    # Samples go where the error is.
    assert film.sample_count.max() >= 8 * film.sample_count.min() >= 8


@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
def test_plain_samples_have_no_control_variate(integrator):
    film = render(SCENES["one light"], Settings(samples=4, integrator=integrator))
    assert not film.control_variate.any() and not film.residual.any() and not film.standard_error.any()


def test_control_variates_beat_sobol():
    scene = studio(96, 64, [area_light()])
    converged = pictures(scene, 4, samples=256, **CONVERGED).mean(axis=0)
    errors = {
        name: np.square(pictures(scene, 4, samples=16, integrator=name) - converged).mean()
        for name in ("sobol", "control_variates")
    }
    assert errors["control_variates"] < 0.4 * errors["sobol"]


def test_the_standard_error_is_that_of_the_picture():
    scene, seeds = SCENES["one light"], 12
    # Off by 1/14 of the error that is judged.
    converged = pictures(scene, 4, samples=512, **CONVERGED).mean(axis=0)
    films = [
        render(scene, Settings(samples=16, seed=seed, standard_error=True, **CV)) for seed in range(seeds)
    ]
    error = np.mean([np.square(film.combined[..., :3] - converged).mean() for film in films])
    said = np.mean([np.square(film.standard_error, dtype=np.float64).mean() for film in films])
    assert 0.75 < np.sqrt(error / said) < 1.35


@pytest.mark.parametrize("name", SCENES)
def test_thread_count_and_repetition_change_no_bit(name):
    settings = Settings(samples=8, normals=True, standard_error=True, threads=1, **CV)
    films = [render(SCENES[name], dataclasses.replace(settings, threads=n)) for n in (1, 2, 3, 3)]
    for film in films[1:]:
        for field in ("combined", "depth", "normal", "sample_count", "standard_error", "control_variate"):
            assert np.array_equal(getattr(film, field), getattr(films[0], field)), field


OPEN = dataclasses.replace(SCENES["one light"], meshes=SCENES["one light"].meshes[1:])


@cache
def open_film() -> Film:
    return render(OPEN, Settings(samples=1024, transparent=True, normals=True, integrator="sobol"))


@pytest.mark.parametrize("integrator", ["control_variates", "cv_only", "quadrature"])
def test_depth_normals_and_alpha_are_there(integrator):
    wanted = open_film()
    film = render(OPEN, Settings(samples=16, transparent=True, normals=True, integrator=integrator))
    alpha = wanted.combined[..., 3]
    inside, outside = alpha == 1, alpha == 0
    assert inside.any() and outside.any()
    assert (film.combined[inside, 3] == 1).all() and (film.combined[outside, 3] == 0).all()
    assert np.abs(film.combined[..., 3] - wanted.combined[..., 3]).mean() < 0.03
    assert (film.depth[outside] == FAR).all() and (film.depth[inside] < 10).all()
    assert np.abs(film.normal[inside] - wanted.normal[inside]).mean() < 0.05
    assert (film.sample_count >= 1).all()


@cache
def converged(name: str) -> np.ndarray:
    return pictures(SCENES[name], 1, samples=1024, **CONVERGED)[0]


@pytest.mark.parametrize(("integrator", "most"), [("cv_only", 0.1), ("quadrature", 0.1)])
@pytest.mark.parametrize("name", ["one light", "spheres"])
def test_what_is_biased_is_nearly_right(name, integrator, most):
    film = render(SCENES[name], Settings(samples=64, integrator=integrator))
    wanted = converged(name)
    difference = film.combined[..., :3] - wanted
    assert np.sqrt(np.square(difference).mean()) < most * wanted.mean()
    assert np.abs(difference.mean()) < 0.03 * wanted.mean()


def test_quadrature_has_no_noise_where_nothing_casts_a_shadow():
    scene = dataclasses.replace(SCENES["one light"], meshes=SCENES["one light"].meshes[:1])
    low = slice(0, 8)  # of the floor, far from its edge
    wanted = pictures(scene, 1, samples=1024, integrator="sobol")[0][low]
    film = render(scene, Settings(samples=16, integrator="quadrature"))
    assert np.abs(film.combined[low, :, :3] / wanted - 1).max() < 0.03


def test_cv_only_says_when_it_cannot_serve():
    film = render(studio(32, 16, mixed_lights(12)), Settings(samples=4, integrator="cv_only"))
    assert any("8 lights" in message for message in film.messages)
    assert "skipped" in film.statistics["control variate"]


def test_many_lights_are_sampled_plainly():
    scene = studio(32, 16, mixed_lights(12))
    plain = render(scene, Settings(samples=16, integrator="sobol"))
    film = render(scene, Settings(samples=16, **CV))
    assert np.array_equal(film.combined, plain.combined)


def test_every_pixel_has_a_sample_and_a_depth():
    scene = studio(128, 96, [area_light()])
    film = render(scene, Settings(samples=1, **CV))
    assert film.sample_count.min() == 1 and film.sample_count.max() > 1
    sampled = render(scene, Settings(samples=1, integrator="sobol"))
    # Within a pixel depth changes by less than that, but at edges.
    close = np.abs(film.depth / sampled.depth - 1) < 0.05
    assert close.mean() > 0.97 and (film.combined[..., 3] == 1).all()
    film = render(scene, Settings(samples=1, transparent=True, **CV))
    wanted = render(scene, Settings(samples=256, transparent=True, integrator="sobol")).combined[..., 3]
    assert abs(film.combined[..., 3].mean() / wanted.mean() - 1) < 0.01
    assert (film.combined[..., 3][wanted == 1] == 1).all() and (film.combined[..., 3][wanted == 0] == 0).all()


class Watcher(Sink):
    def __init__(self, cancel_after: int | None = None) -> None:
        self.boxes: list[tuple[int, int, int, int]] = []
        self.films: list[Film] = []
        self.fractions: list[float] = []
        self.cancel_after = cancel_after

    def cancelled(self) -> bool:
        return self.cancel_after is not None and len(self.boxes) >= self.cancel_after

    def tile(self, film, x0, y0, x1, y1) -> None:
        self.boxes.append((x0, y0, x1, y1))
        if len(self.boxes) == 1:
            self.films.append(film.combined.copy())

    def progress(self, fraction, elapsed, remaining, text) -> None:
        self.fractions.append(fraction)


def test_the_whole_picture_comes_first_and_then_its_tiles():
    sink = Watcher()
    scene = studio(200, 130, [area_light()])
    film = render(scene, Settings(samples=8, **CV), sink)
    assert sink.boxes[0] == (0, 0, 200, 130)
    # But for pixels that it was found not to serve, once they are sampled.
    kept = (film.control_variate != 0).any(axis=2)
    assert kept.mean() > 0.5
    assert np.array_equal(sink.films[0][kept][:, :3], film.control_variate[kept])
    covered = np.zeros((130, 200), int)
    for x0, y0, x1, y1 in sink.boxes[1:]:
        covered[y0:y1, x0:x1] += 1
    assert (covered == 1).all()
    assert sink.fractions == sorted(sink.fractions)
    assert film.stopped_by == "samples"


def test_cancel_while_refining_keeps_the_control_variate():
    sink = Watcher(cancel_after=1)
    film = render(studio(160, 160, [area_light()]), Settings(samples=64, **CV), sink)
    assert film.stopped_by == "cancel"
    left = film.sample_count == 0
    assert left.any()
    assert np.array_equal(film.combined[left][:, :3], film.control_variate[left])


def test_cancel_while_building():
    film = render(studio(300, 300, [area_light()]), Settings(samples=64, **CV), Watcher(cancel_after=0))
    assert film.stopped_by == "cancel"


def test_a_border_is_a_part_of_the_frame():
    whole = SCENES["one light"]
    camera = dataclasses.replace(whole.camera, region=(16, 8, 40, 28))
    film = render(dataclasses.replace(whole, camera=camera), Settings(samples=256, **CV))
    wanted = render(whole, Settings(samples=256, integrator="sobol")).combined[8:28, 16:40]
    assert film.combined.shape == wanted.shape
    assert np.abs(film.combined - wanted).mean() < 0.02 * wanted.mean()


def test_the_noise_threshold_spends_less_on_what_is_clean():
    scene = SCENES["one light"]
    full = render(scene, Settings(samples=64, **CV))
    film = render(scene, Settings(samples=64, noise_threshold=0.05, min_samples=1, **CV))
    assert film.sample_count.sum() < 0.5 * full.sample_count.sum()
    assert np.abs(film.combined - full.combined).mean() < 0.05 * full.combined.mean()


def test_a_holdout_is_transparent():
    scene = SCENES["one light"]
    ball = dataclasses.replace(scene.meshes[1], holdout=True)
    scene = dataclasses.replace(scene, meshes=(scene.meshes[0], ball, scene.meshes[2]))
    film = render(scene, Settings(samples=16, **CV))
    held = render(scene, Settings(samples=64)).combined[..., 3] == 0
    assert held.any() and (film.combined[held, 3] == 0).all()
    assert np.abs(film.combined[held]).mean() < 1e-3


def test_materials_seen_through_a_light_that_is_bright_do_no_harm():
    # A lamp in the picture is a million times as bright as what it lights.
    lamp = AreaLight(1e6, light_to_world=place((0, 0.5, 2.5), (1.2, 0, 0)), size=(0.2, 0.2))
    scene = studio(48, 32, [lamp])
    film = render(dataclasses.replace(scene, materials=(Material(1e-6),) * 2), Settings(samples=16, **CV))
    assert np.isfinite(film.combined).all()


@pytest.mark.parametrize("how", ["cancel", "time"])
def test_a_long_render_ends_soon(how):
    began = time.monotonic()
    settings = Settings(samples=1 << 20, threads=2, **CV)
    if how == "time":
        film = render(SCENES["one light"], dataclasses.replace(settings, time_limit=0.5))
        # H and a first pass everywhere come before any limit.
        assert (film.sample_count >= 1).all()
    else:
        sink = Watcher()
        sink.cancelled = lambda: time.monotonic() > began + 0.5
        film = render(SCENES["one light"], settings, sink)
    assert film.stopped_by == how
    assert np.isfinite(film.combined).all()
