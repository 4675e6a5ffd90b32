# SPDX-License-Identifier: GPL-3.0-or-later
"""Where samples of f itself are better than those of f - h."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from benchmarks.scenes.core import example, scene
from engine_core import Scene, Settings, trial
from engine_core.render import render
from example_blends.model import Lamp, Model, Thing, View, diffuse
from example_blends.shapes import ball, block


@pytest.fixture(scope="module")
def fence() -> Scene:
    """Without fog's own light."""
    return clear(example("fence", 48, 27))


def clear(made: Scene) -> Scene:
    volumes = [dataclasses.replace(volume, scattering=(0, 0, 0)) for volume in made.volumes]
    return dataclasses.replace(made, volumes=volumes)


@pytest.mark.parametrize("better", [0.0, 1e9])
def test_the_mean_is_right_whether_h_is_given_up_or_not(
    fence: Scene, better: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trial, "BETTER", better)
    monkeypatch.setattr(trial, "SURE", ((0.0, 0.0),))
    monkeypatch.setattr(trial, "FEWEST", 0)
    films = [render(fence, Settings(samples=4, seed=seed, threads=1)) for seed in range(40)]
    gave_up = {film.statistics["control variate"].startswith("given up") for film in films}
    assert gave_up == {better > 0}
    means = np.array([film.combined[..., :3].mean() for film in films])
    truth = render(fence, Settings(samples=1024, seed=77, integrator="sobol", threads=1)).combined[..., :3]
    assert abs(means.mean() - truth.mean()) < 4 * means.std() / np.sqrt(len(means)) + 1e-3 * truth.mean()


def test_bars_below_the_regions_are_sampled_without_h() -> None:
    film = render(clear(example("fence", 240, 136)), Settings(samples=16, seed=5, threads=2))
    assert film.statistics["control variate"].startswith("given up")


@pytest.mark.parametrize("samples, given_up", [(1, True), (2, False)])
def test_f_may_be_worse_in_a_picture_of_one_sample(
    samples: int, given_up: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    def a_third_worse(self: trial.Trial, variate: object, number: int) -> tuple[np.ndarray, np.ndarray]:
        return np.ones(64), np.full(64, 1.3)

    monkeypatch.setattr(trial.Trial, "_deviations", a_third_worse)
    film = render(clear(example("fence", 160, 90)), Settings(samples=samples, seed=5, threads=2))
    assert film.statistics["control variate"].startswith("given up") == given_up


def test_rare_specks_count_by_their_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    def specks(self: trial.Trial, variate: object, number: int) -> tuple[np.ndarray, np.ndarray]:
        # In the mean less than half of what f deviates by, in the mean square three times.
        of_h = np.where(np.arange(640) % 64 == 0, 25.0, 0.05)
        return of_h, np.ones(640)

    monkeypatch.setattr(trial.Trial, "_deviations", specks)
    film = render(clear(example("fence", 160, 90)), Settings(samples=4, seed=5, threads=2))
    assert film.statistics["control variate"].startswith("given up")


@pytest.mark.parametrize("samples", [1, 2])
def test_more_is_no_doubt_in_a_picture_of_one_sample(samples: int, monkeypatch: pytest.MonkeyPatch) -> None:
    tried: list[int] = []

    def count(self: trial.Trial, variate: object, number: int) -> tuple[np.ndarray, np.ndarray]:
        tried.append(number)
        return np.ones(64), np.full(64, 9.0)

    monkeypatch.setattr(trial.Trial, "_deviations", count)
    monkeypatch.setattr(trial, "unexplained", lambda tree: (0.02, 0.0))
    render(clear(example("fence", 160, 90)), Settings(samples=samples, seed=5, threads=2))
    assert tried == [0] * (samples == 2)


def test_one_sample_of_highlights_is_far_better_without_h(monkeypatch: pytest.MonkeyPatch) -> None:
    plates = example("veach_plates", 160, 90)
    truth = render(plates, Settings(samples=64, seed=77, integrator="sobol")).combined[..., :3]

    def error() -> float:
        films = [render(plates, Settings(samples=1, seed=seed, threads=2)) for seed in range(3)]
        return np.mean([np.square(film.combined[..., :3] - truth, dtype=np.float64).mean() for film in films])

    ours = error()
    monkeypatch.setattr(trial, "DOUBTFUL_OF_ONE", 1.0)
    # Far more than what twice the samples would bring.
    assert ours < error() / 4


def test_soft_shadows_keep_h_untried(monkeypatch: pytest.MonkeyPatch) -> None:
    def tried(*arguments: object) -> None:
        raise AssertionError("what nodes see leaves no doubt")

    monkeypatch.setattr(trial.Trial, "_deviations", tried)
    things = [
        Thing("Floor", block((-3, -3, -0.1), (3, 3, 0)), diffuse("Floor", (0.5, 0.5, 0.5))),
        Thing("Ball", ball(0.5, (0, 0, 0.8), cells=8), diffuse("Ball", (0.5, 0.5, 0.5))),
    ]
    disk = {"shape": "DISK", "size": 1.5}
    lamp = Lamp("Lamp", "AREA", (1, -1, 3), 100, target=(0, 0, 0), properties=disk)
    film = render(scene(Model(View((0, -6, 3), (0, 0, 0.4)), things, [lamp]), 256, 144), Settings(samples=16))
    assert film.statistics["control variate"] == "built"


def test_where_few_pixels_would_tell_h_is_kept_untried(fence: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "BETTER", 1e9)
    assert render(fence, Settings(samples=4, seed=1)).statistics["control variate"] == "built"
    larger = clear(example("fence", 160, 90))
    assert render(larger, Settings(samples=4, seed=1)).statistics["control variate"].startswith("given up")


def test_what_is_uncertain_is_tried_in_more_pixels(fence: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds, pixels = [], []

    def alike(self: trial.Trial, variate: object, number: int) -> tuple[np.ndarray, np.ndarray]:
        rounds.append(number)
        of_h, of_f = deviations(self, variate, number)
        pixels.append(len(of_h))
        assert of_h.shape == of_f.shape and (of_h >= 0).all() and (of_f >= 0).all() and of_f.any()
        return 1 + 0.1 * (-1.0) ** np.arange(len(of_h)), np.full(len(of_f), trial.BETTER)

    deviations = trial.Trial._deviations
    monkeypatch.setattr(trial.Trial, "_deviations", alike)
    monkeypatch.setattr(trial, "FEWEST", 0)
    film = render(fence, Settings(samples=16, seed=3, threads=1))
    assert rounds == [0, 1, 2] and film.statistics["control variate"] == "built"
    # 1/64 of the samples: four nets of 8 in each pixel.
    assert all(0 < n < 2 * fence.camera.width * fence.camera.height * 16 / 64 / 32 for n in pixels)


@pytest.mark.parametrize("size", [(1, 1), (5, 3), (16, 9)])
def test_pictures_of_few_pixels_are_tried_too(size: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(trial, "DOUBTFUL", -1.0)
    monkeypatch.setattr(trial, "FEWEST", 0)
    film = render(clear(example("fence", *size)), Settings(samples=64, seed=1, threads=2))
    assert np.isfinite(film.combined).all()
