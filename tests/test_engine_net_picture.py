# SPDX-License-Identifier: GPL-3.0-or-later
"""A net whose points are followed over the picture: unbiased, whatever lies between corners."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from engine_core import Settings, points_of_tiles
from engine_core import net_picture as module
from engine_core.image.film import LASER, Layer
from engine_core.integration.sobol import digital_shift, sobol, unit_float
from engine_core.net_picture import NetPicture
from engine_core.parts import OverNet
from engine_core.points_of_tiles import (
    ERROR,
    MOST_TIMES,
    PATTERN,
    PATTERN_IN_NOISE,
    ROOT,
    _roughness,
    _shared,
    enough_points,
    hiding,
)
from engine_core.transport.camera_hits import Pixels

WIDTH, HEIGHT = 22, 13  # no multiples of a cell


class Place:
    values = None

    def __init__(self, x: np.ndarray, y: np.ndarray) -> None:
        # No ray at all where x is large, as where a camera ray meets no fog.
        self.lane = np.flatnonzero(x < WIDTH - 2.5)
        self.x, self.y = x[self.lane], y[self.lane]


class Broken:
    """Bright up to an edge in u[0] that moves over the picture, and in one thin stripe of u[1] and x."""

    rest_dimensions = 2
    counts: Counter[str] = Counter()

    def first(self, pixels: Pixels, u: np.ndarray) -> Place:
        x, y = (a[:, None] + b for a, b in zip((pixels.x, pixels.y), u, strict=True))
        return Place(x.ravel(), y.ravel())

    def rest(self, stage: Place, lane: Any, u: np.ndarray) -> tuple[None, np.ndarray]:
        if lane is None:
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        x, y = stage.x.take(lane), stage.y.take(lane)
        u = u.reshape(2, -1)
        bright = (1 + u[1] * y / HEIGHT) * (u[0] < 0.2 + 0.6 * x / WIDTH)
        bright += 3 * (np.abs(x - 9.3 - u[1]) < 0.3)
        return None, np.stack([bright, 2 * bright, 0 * bright]).astype(np.float32)

    @staticmethod
    def truth() -> np.ndarray:
        """(H, W) means over pixels of the first channel, by a fine grid."""
        n = 200
        inner = (np.arange(n) + 0.5) / n
        x, y = np.arange(WIDTH)[:, None] + inner, np.arange(HEIGHT) + 0.5
        seen = x < WIDTH - 2.5
        edge = ((0.2 + 0.6 * x / WIDTH) * seen).mean(axis=1)
        stripe = np.clip(x - 9.3 + 0.3, 0, 1) - np.clip(x - 9.3 - 0.3, 0, 1)
        return (1 + 0.5 * y / HEIGHT)[:, None] * edge + 3 * (stripe * seen).mean(axis=1)


class Slit(Broken):
    """Bright all over but between two corners of cells, where none of them sees that."""

    def rest(self, stage: Place, lane: Any, u: np.ndarray) -> tuple[None, np.ndarray]:
        if lane is None:
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        bright = 1.0 - (np.floor(stage.x.take(lane)) == 10)
        return None, np.stack([bright] * 3).astype(np.float32)


class Coloured(Broken):
    """As bright everywhere, of one colour up to an edge in u[0] that moves over the picture."""

    def rest(self, stage: Place, lane: Any, u: np.ndarray) -> tuple[None, np.ndarray]:
        if lane is None:
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        red = u.reshape(2, -1)[0] < 0.2 + 0.6 * stage.x.take(lane) / WIDTH
        return None, np.stack([red, ~red, 0 * red]).astype(np.float32)


class Dark(Broken):
    """As noisy as it is bright, and black from a corner of cells on."""

    def rest(self, stage: Place, lane: Any, u: np.ndarray) -> tuple[None, np.ndarray]:
        if lane is None:
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        bright = 3 * u.reshape(2, -1)[0] ** 2 * (stage.x.take(lane) < 12)
        return None, np.stack([bright] * 3).astype(np.float32)

    @staticmethod
    def expected(stage: Place, count: int) -> np.ndarray:
        return np.bincount(stage.lane, stage.x < 12, count)


def picture(
    seed: int,
    samples: int = 32,
    integrator: str = "control_variates",
    map_=None,
    enough: bool = False,
    noise: float | None = None,
    integrand: Broken | None = None,
    chooses: bool = False,
) -> Layer:
    layer = Layer.empty(LASER, WIDTH, HEIGHT)

    def outlines(region: tuple[int, int, int, int], _: Any) -> np.ndarray:
        found = np.zeros((WIDTH, HEIGHT), bool)
        found[17, 5] = True
        return found

    integrand = integrand or Broken()
    expected = getattr(integrand, "expected", None)
    by = OverNet(integrand, samples, outlines, fewest=8, expected=expected, chooses=chooses, more=not chooses)
    settings = Settings(1, seed=seed, integrator=integrator, standard_error=True)
    made = NetPicture(by, settings, (0, 0, WIDTH, HEIGHT), layer, lambda: None)
    made.build(map_ or (lambda f, items: [f(item) for item in items]), lambda: enough, noise)
    return layer


@pytest.mark.parametrize(
    ("rounds", "tile", "apart"),
    [
        (1, 8, 2),
        (4, 8, 2),
        pytest.param(1, 1, 2, marks=pytest.mark.full),
        pytest.param(1, 2, 2, marks=pytest.mark.full),
        (1, 1, 0.15),
        (4, 1, 0.15),
    ],
)
def test_the_mean_over_seeds_is_the_truth(rounds, tile, apart, monkeypatch):
    """apart : from where on tiles' pixels have nets of their own; none, or some of each picture."""
    count = 120
    if rounds > 1:
        count = 60
        monkeypatch.setattr(module, "MOST_POINTS", 8)
    monkeypatch.setattr(module, "TILE", tile)
    monkeypatch.setattr(module, "APART", apart)
    monkeypatch.setattr(module, "ALIKE", np.ones(1))
    seeds = np.array([picture(seed, chooses=True).radiance for seed in range(count)], np.float64)
    np.testing.assert_allclose(seeds[..., 1], 2 * seeds[..., 0], rtol=1e-4, atol=1e-5)
    assert not seeds[..., 2].any()
    mean, truth = seeds[..., 0].mean(axis=0), Broken.truth()
    error = seeds[..., 0].std(axis=0, ddof=1) / np.sqrt(len(seeds))
    z = (mean - truth) / np.maximum(error, 1e-4)
    assert np.abs(z).max() < 5 and np.sqrt(np.square(z).mean()) < 1.25
    whole = seeds[..., 0].mean(axis=(1, 2))
    assert abs(whole.mean() - truth.mean()) < 3 * whole.std() / np.sqrt(len(seeds))
    # Left of the stripe: as many points by chance, of 0.2 to 0.45 that is lit, have 0.08.
    assert np.median(seeds[..., :7, 0].std(axis=0)) < 0.05


def test_the_mean_over_seeds_of_the_fewest_points_is_the_truth():
    seeds = np.array([picture(seed, samples=4).radiance[..., 0] for seed in range(300)], np.float64)
    # The stripe, where it lies between corners, is asked for so seldom that the deviation is not known.
    often = np.delete(np.arange(WIDTH), [9, 10])
    mean, error = seeds.mean(axis=0), seeds.std(axis=0, ddof=1) / np.sqrt(len(seeds))
    z = ((mean - Broken.truth()) / np.maximum(error, 1e-4))[:, often]
    # Four points are so much the same all over the picture that the mean square of this says nothing.
    assert np.abs(z).max() < 5
    whole = seeds.mean(axis=(1, 2))
    assert abs(whole.mean() - Broken.truth().mean()) < 3 * whole.std() / np.sqrt(len(seeds))


def test_what_no_corner_sees_makes_no_specks():
    made = np.stack([picture(seed, 8, integrand=Slit()).radiance[:, 10, 0] for seed in range(40)])
    # One point of eight in every other pixel, which is twice as bright as all over its chance.
    assert sorted(np.unique(made.round(5)).tolist()) == [-1, 1]
    assert abs(made.mean()) < 4 / made.size**0.5

    class Different(Slit):
        """Of points that differ, so that there are many."""

        def rest(self, stage: Place, lane: Any, u: np.ndarray) -> tuple[None, np.ndarray]:
            return None, super().rest(stage, lane, u)[1] * (0.5 + u[0].ravel()).astype(np.float32)

    # Of 64 points four are asked for, each of which is a quarter as bright.
    many = np.stack([picture(seed, 64, integrand=Different()).radiance[:, 10, 0] for seed in range(20)])
    assert np.abs(many).max() < 0.3 and abs(many.mean()) < 1 / many.size**0.5


def test_lights_of_one_brightness_and_several_colours_make_no_specks():
    made = np.stack([picture(seed, 16, integrand=Coloured()).radiance for seed in range(40)])
    # A point that were left to the least chance would be four times as bright.
    assert made.min() > -0.3 and made.max() < 1.3
    red = made[:, :, : WIDTH - 3, 0].mean(axis=(0, 1))
    np.testing.assert_allclose(red, 0.2 + 0.6 * (np.arange(WIDTH - 3) + 0.5) / WIDTH, atol=0.04)


def test_what_the_bright_is_wrong_by_is_not_seen_in_the_dark():
    made = np.stack([picture(seed, 8, integrand=Dark()).radiance[..., 0] for seed in range(60)])
    assert made[:, :, :11].all() and not made[:, :, 12:].any()
    lit = made[:, :, :8].mean(axis=(1, 2))
    assert abs(lit.mean() - 1) < 4 * lit.std() / len(lit) ** 0.5 < 0.05


def test_where_following_is_of_no_use_pixels_are_wrong_by_themselves(monkeypatch):
    monkeypatch.setattr(module, "TILE", 2)
    monkeypatch.setattr(module, "ALIKE", np.ones(1))

    class Wild(Broken):
        """A point is bright or dark, and another one a pixel further."""

        def rest(self, stage: Place, lane: Any, u: np.ndarray) -> tuple[None, np.ndarray]:
            if lane is None:
                lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
            turn = 0.7 * np.floor(stage.x.take(lane)) + 0.9 * np.floor(stage.y.take(lane))
            return None, np.stack([2.0 * ((u.reshape(2, -1)[0] + turn) % 1 < 0.5)] * 3).astype(np.float32)

    def alike(**kind: bool) -> float:
        made = np.stack([picture(seed, 4, integrand=Wild(), **kind).radiance[..., 0] for seed in range(60)])
        off = made[:, :, : WIDTH - 3] - 1
        return float((off.mean(axis=(1, 2)) ** 2).mean() / (off**2).mean() * off[0].size)

    # Of as many pixels that have nothing to do with each other: 1.
    assert alike(chooses=True) < 4 < 8 < alike()


def test_enough_is_a_picture_of_the_nets_that_there_are(monkeypatch):
    monkeypatch.setattr(module, "MOST_POINTS", 32)
    one = picture(3)
    stopped = picture(3, samples=128, enough=True)
    for name in ("radiance", "control_variate", "residual", "standard_error", "sample_count"):
        np.testing.assert_array_equal(getattr(one, name), getattr(stopped, name))


def test_noise_beside_hides_that_points_are_few(monkeypatch):
    monkeypatch.setattr(points_of_tiles, "MOST_TIMES", 1)

    def is_of(points: int, noise: float) -> bool:
        return np.array_equal(picture(5, noise=noise).radiance, picture(5, samples=points).radiance)

    assert is_of(32, noise=1e-9) and is_of(8, noise=1e9)


@pytest.mark.parametrize("dimensions", [1, 2])
def test_what_values_differ_by_is_the_same_of_a_shifted_net(dimensions):
    net = np.stack([unit_float(sobol(np.arange(64, dtype=np.uint32), d)) for d in range(dimensions)])
    found = []
    for number in range(4):
        slopes = digital_shift(net, number).sum(axis=0)
        found.append(_roughness(np.broadcast_to(slopes, (3, 1, 64)), net[:, None])[0])
    np.testing.assert_allclose(found, found[0], rtol=0.5)


def test_many_edges_in_line_are_told():
    """Of what differs along the first dimension alone: in proportion to what 32 points are wrong by."""
    random, told = np.random.default_rng(4), {}
    for edges in (3, 24):
        ends = np.sort(random.uniform(0, 1, (2000, edges)), axis=1)[:, :, None]

        def jittered(count: int) -> np.ndarray:
            return (np.arange(count) + random.random((2000, count))) / count

        def lit(u: np.ndarray, ends: np.ndarray = ends) -> np.ndarray:
            return (u[:, None] > ends).sum(axis=1) % 2

        truth = np.square(lit(jittered(32)).mean(axis=1) - lit(jittered(4096)).mean(axis=1)).mean()
        u = jittered(64)
        f, net = np.stack([lit(u)] * 3) / 3.0, np.stack([u, random.permuted(u, axis=1)])
        told[edges] = [_roughness(f, net[:n]).mean() / truth for n in (1, 2)]
    of_few, of_many = told.values()
    assert points_of_tiles.ON_LINE * of_few[0] == pytest.approx(of_few[1], rel=0.35)
    assert of_many[0] == pytest.approx(of_few[0], rel=0.25)
    assert of_many[1] < 0.5 * of_few[1]


def test_points_go_where_values_differ():
    random = np.random.default_rng(3)
    net = (np.stack(np.divmod(np.arange(64), 8)) + random.random((2, 64)))[:, None] / 8
    net = np.repeat(net, 2, axis=1)
    net[:, 1] = net[:, 1, random.permutation(64)]
    # An edge along u[0] = 3/8 of height 2 in the sum of channels, in one of four pairs, and nothing.
    f = np.zeros((3, 2, 64))
    f[:2, 1] = net[0, 1] < 0.375
    np.testing.assert_allclose(_roughness(f, net), [0, 4 / 4])
    wanted = random.random((30, 40)) ** 2
    shared = _shared(wanted, 64, 8)
    assert set(np.unique(shared)) <= {16, 32, 64, 128, 256}
    assert abs(shared.mean() - 64) < 3
    assert np.corrcoef(shared.ravel(), wanted.ravel())[0, 1] > 0.9
    assert (_shared(np.zeros((2, 2)), 64, 8) == 8).all()
    assert _shared(wanted, 8, 8).min() == 8


def test_terms_add_up_and_order_changes_nothing(monkeypatch):
    monkeypatch.setattr(module, "TILE", 2)
    one = picture(5)
    other = picture(5, map_=lambda f, items: [f(item) for item in list(items)[::-1]][::-1])
    for name in ("radiance", "control_variate", "residual", "standard_error", "sample_count"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    np.testing.assert_allclose(one.radiance, one.control_variate + one.residual, rtol=1e-5, atol=1e-6)
    assert np.isfinite(one.standard_error).all() and (one.standard_error[:, : WIDTH - 4] > 0).all()


def test_polynomials_alone_take_no_samples():
    layer = picture(5, 256, "cv_only")
    assert not layer.residual.any() and not layer.sample_count.any()
    truth = Broken.truth()[:, :8]
    assert np.abs(layer.radiance[:, :8, 0] - truth).max() < 0.1 * truth.max()


def test_the_standard_error_is_of_the_errors_size():
    seeds = [picture(seed) for seed in range(60)]
    found = np.array([layer.radiance[..., :2].mean(axis=2) for layer in seeds]).std(axis=0)
    told = np.sqrt(np.mean([np.square(layer.standard_error[..., 0]) for layer in seeds], axis=0)) * 1.5
    # Pixels between the ends of the stripe and of what is seen.
    ratio = told[:, :7].mean() / found[:, :7].mean()
    assert 0.4 < ratio < 2.5


def test_points_are_few_where_noise_hides_them_and_many_where_they_make_a_pattern():
    def points(relative: float, noise: float, fewest: int = 4, pattern: bool = True) -> int:
        """Of a net that 16 points are usual of, that is wrong by so much of its mean, beside such noise."""
        rough = np.full((3, 5), 16**1.5 / ERROR * relative**2)
        return enough_points(rough, np.ones((3, 5)) if pattern else None, noise / 3, fewest, 16)

    assert points(0.01, 0.0) == points(0.01, 1e-3) == 16
    assert points(0.01, 1.0) == 4
    assert points(0.01, 1.0, fewest=0) == 16
    assert points(PATTERN * 1.7, 0.0) == points(PATTERN * 1.7, 1e-3) == 32
    assert points(9.0, 0.0) == MOST_TIMES * 16
    assert points(9.0, 0.0, pattern=False) == 16
    assert points(9.0, 0.0, fewest=0) == 16
    # What is hidden is no pattern.
    assert points(0.2, 0.3) == 32
    assert points(0.2, 1.0) == 8
    # Nor is what is dim beside other fog.
    rough = np.full((3, 5), 16**1.5 / ERROR)
    assert enough_points(rough, np.ones((3, 5)), 0.0, 4, 16, around=200.0) == 16
    # Nor what is in the dark beside what is bright.
    rough, bright = np.zeros((1, 4)), np.array([[1.0, 0, 0, 0]])
    rough[:, 1:] = 1e-6
    assert enough_points(rough, bright, 0.0, 4, 16) == 16
    assert enough_points(0 * rough, 0 * bright, 0.0, 4, 16) == 16


def test_specks_beside_hide_no_pattern():
    """Noise that is the same on average, in all pixels or in one of a hundred; of a net wrong by its mean."""
    random, rough, bright = np.random.default_rng(4), np.full((3, 5), 16**1.5 / ERROR), np.ones((3, 5))
    everywhere = np.abs(random.normal(size=(96, 160)))
    specks = np.where(random.random((96, 160)) < 0.01, 10.0, 0)
    noise = np.sqrt(np.mean(np.square(everywhere)))
    assert np.sqrt(np.mean(np.square(specks))) == pytest.approx(noise, rel=0.1)
    found = [hiding(deviation, 32) for deviation in (everywhere, specks)]
    np.testing.assert_allclose(found[0], noise, rtol=0.1)
    assert found[1].max() < 0.05 * noise
    few, many = (enough_points(rough, bright, 3 * noise, 4, 16, hiding=3 * of_tiles) for of_tiles in found)
    assert few == enough_points(rough, bright, 3 * noise, 4, 16) == 4 and many == MOST_TIMES * 16
    # No more than keep the pattern faint.
    faint = rough * (PATTERN_IN_NOISE * 1.7) ** 2
    assert enough_points(faint, bright, 3 * noise, 4, 16, hiding=3 * found[1]) == 32
    assert enough_points(0.01 * faint, bright, 3 * noise, 4, 16, hiding=3 * found[1]) == 4


def test_what_hides_is_told_of_each_tile():
    """Of tiles that the picture's edge cuts, too."""
    deviation = np.zeros((40, 70))
    deviation[32:, 64:] = 2.0
    found = hiding(deviation, 32)
    assert found.shape == (2, 3) and found[1, 2] == pytest.approx(2 / ROOT) and found.sum() == found[1, 2]
