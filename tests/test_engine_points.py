# SPDX-License-Identifier: GPL-3.0-or-later
"""Points in primary space: nets where Sobol promises nets, and uniform for every bin."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from scipy import stats
from scipy.stats import qmc

from engine_core.integration.point_sets import PointSet, SobolPoints, staged_points
from engine_core.integration.sobol import (
    MAX_DIMENSIONS,
    digital_shift,
    hash_combine,
    mix,
    owen_scramble,
    sobol,
    unit_float,
)

# Keys of 64 x 64 pixels.
KEYS = hash_combine(np.arange(4096) % 64, np.arange(4096) // 64)
INTEGRATORS = ("sobol", "monte_carlo")
SPLITS = (1, 2)


def _made(name: str, count: int, split: int = 1, seed: int = 3) -> tuple[PointSet, PointSet]:
    """Points of the screen (2) and of the light (3), for ``count`` samples of the screen."""
    screen, light = staged_points(name, 2, 3, split, seed)
    screen.prepare(count)
    light.prepare(count * split)
    return screen, light


def _elementary_counts(points: np.ndarray, splits: tuple[int, ...]) -> np.ndarray:
    """How many of the points (D, N) lie in each box of 2^-splits[d] along dimension d."""
    cell = np.zeros(points.shape[1], np.int64)
    for x, bits in zip(points, splits, strict=True):
        cell = (cell << bits) + np.floor(x.astype(np.float64) * (1 << bits)).astype(np.int64)
    return np.bincount(cell, minlength=1 << sum(splits))


def _assert_net(points: np.ndarray, t: int) -> None:
    """Points (D, 2^m) are a (t, m, D)-net in base 2: every box of volume 2^(t - m) has 2^t of them."""
    dimensions, count = points.shape
    m = count.bit_length() - 1
    for splits in itertools.product(range(m - t + 1), repeat=dimensions):
        if sum(splits) == m - t:
            assert (_elementary_counts(points, splits) == 1 << t).all(), splits


@pytest.mark.parametrize("m", [0, 3, 10])
def test_sobol_points_are_those_of_scipy(m):
    index = np.arange(1 << m, dtype=np.uint32)
    ours = np.stack([sobol(index, d) for d in range(MAX_DIMENSIONS)], axis=1) * 2.0**-32
    theirs = qmc.Sobol(MAX_DIMENSIONS, scramble=False).random(1 << m)
    # SciPy walks each block of 2^m points in Gray code order.
    assert np.array_equal(np.unique(ours, axis=0), np.unique(theirs, axis=0))


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("start", [0, 64, 192])
def test_screen_points_of_every_pixel_are_nets(start, split):
    screen, _ = _made("sobol", 256, split)
    for net in screen.points(KEYS[:20], start, 64).transpose(1, 0, 2):
        _assert_net(net, t=0)


@pytest.mark.parametrize("split", [2, 4, 16])
def test_light_points_of_a_split_are_nets(split):
    _, light = _made("sobol", 64, split)
    for net in light.points(KEYS[:10], 0, 64).transpose(1, 0, 2):
        _assert_net(net, t=1)
        _assert_net(net[:2], t=0)
    # Those of one camera ray are a net of their own.
    for net in light.points(KEYS[:10], 3 * split, split).transpose(1, 0, 2):
        _assert_net(net[:2], t=0)


def test_screen_and_light_points_together_are_nets():
    screen, light = _made("sobol", 256)
    both = np.concatenate([p.points(KEYS[:4], 0, 256) for p in (screen, light)]).transpose(1, 0, 2)
    for net in both:
        for pair in itertools.combinations(net, 2):
            _assert_net(np.stack(pair), t=3)
        _assert_net(net[2:4], t=1)  # the point on the light


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("split", SPLITS)
def test_any_division_into_passes_gives_the_same_points(name, split):
    for whole, grown in zip(_made(name, 64, split), _made(name, 1, split), strict=True):
        expected = whole.points(KEYS, 0, 64)
        for start, count in ((0, 1), (1, 1), (2, 2), (4, 60)):
            grown.prepare(start + count)
            assert np.array_equal(
                grown.points(KEYS[5:9], start, count), expected[:, 5:9, start : start + count]
            )


def test_owen_scrambling_keeps_nets():
    index = np.arange(256, dtype=np.uint32)
    for seed in range(20):
        net = np.stack([owen_scramble(sobol(index, d), seed * 7 + d) for d in range(2)])
        _assert_net(unit_float(net), t=0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_a_digital_shift_keeps_nets_and_makes_others(dtype):
    net = np.stack([unit_float(sobol(np.arange(64, dtype=np.uint32), d), dtype) for d in range(2)])
    assert np.array_equal(digital_shift(net, 0), net)
    for number in (1, 7):
        shifted = digital_shift(net, number)
        assert shifted.dtype == dtype and shifted.min() > 0 and shifted.max() < 1
        assert np.abs(shifted - net).max() > 0.1
        for rows in (1, 2, 4, 8, 16, 32, 64):
            cell = (shifted[0] * rows).astype(int) * (64 // rows) + (shifted[1] * (64 // rows)).astype(int)
            assert len(np.unique(cell)) == 64
    mixed = digital_shift(net, np.arange(64) % 3)
    for number in range(3):
        assert np.array_equal(mixed[:, number::3], digital_shift(net, number)[:, number::3])
    many = digital_shift(np.full((1, 4096), 0.3, dtype), np.arange(4096))
    assert abs(many.mean() - 0.5) < 4 / np.sqrt(12 * 4096)


def test_owen_scrambling_keeps_blocks_of_indices():
    index = np.arange(256, dtype=np.uint32)
    moved = owen_scramble(index, 5)
    for size in (1, 2, 16, 256):
        blocks = moved.reshape(-1, size) // size
        assert (blocks == blocks[:, :1]).all()
    assert len(np.unique(moved)) == 256


@pytest.mark.parametrize("bits", [32, 23])
@pytest.mark.parametrize("seeds", [7, np.arange(9)[:, None]])
@pytest.mark.parametrize("count", [1, 3, 64, 4096, 40000])
def test_owen_scrambling_flips_each_bit_by_a_coin_of_the_higher_ones(count, seeds, bits):
    x = np.random.default_rng(count).integers(0, 1 << 32, count, dtype=np.uint32)
    expected = x.astype(np.uint64) + np.zeros(np.shape(seeds), np.uint64)
    for bit in range(bits):
        coin = hash_combine(seeds, bit)
        higher = (x.astype(np.uint64) >> np.uint64(32 - bit)).astype(np.uint32)
        flip = mix(mix(higher ^ coin) + coin) >> np.uint32(31)
        expected ^= flip.astype(np.uint64) << np.uint64(31 - bit)
    assert np.array_equal(owen_scramble(x, seeds, bits), expected)


def test_owen_scrambling_makes_a_point_uniform():
    scrambled = np.array([owen_scramble(np.array([0x12345678], np.uint32), seed)[0] for seed in range(1000)])
    assert stats.kstest(unit_float(scrambled), "uniform").pvalue > 1e-3


def test_unit_floats_are_inside_the_open_interval():
    extreme = np.array([0, 1, 511, 512, 2**31, 2**32 - 512, 2**32 - 1], np.uint32)
    values = unit_float(extreme)
    assert values.dtype == np.float32
    assert (values > 0).all() and (values < 1).all()
    assert (2 * values - 1 != 0).all()  # never the very centre of a disk
    assert np.array_equal(values.astype(np.float64), (extreme // 512 + 0.5) / 2**23)


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("split", SPLITS)
def test_each_sample_is_uniform_over_the_pixels(name, split):
    points = np.concatenate([p.points(KEYS, 0, 64) for p in _made(name, 64, split)])
    worst = min(stats.kstest(x[:, i], "uniform").pvalue for x in points for i in (0, 1, 7, 63))
    assert worst > 1e-3 / 20


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("sample", [0, 5])
def test_dimensions_are_independent_over_the_pixels(name, split, sample):
    points = np.concatenate([p.points(KEYS, 0, 8)[:, :, sample] for p in _made(name, 8, split)])
    for a, b in itertools.combinations(points, 2):
        _assert_uniform_square(a, b)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_neighbouring_pixels_are_independent(name):
    points = _made(name, 8)[0].points(KEYS, 0, 8)[0].reshape(64, 64, 8)
    _assert_uniform_square(points[:, :-1, 0].ravel(), points[:, 1:, 0].ravel())
    _assert_uniform_square(points[:-1, :, 3].ravel(), points[1:, :, 3].ravel())


def test_pseudo_random_samples_of_a_pixel_are_independent():
    points = np.concatenate([p.points(KEYS[:2], 0, 1 << 16) for p in _made("monte_carlo", 1 << 16)])
    for pixel in points.transpose(1, 0, 2):
        for a, b in itertools.combinations(pixel, 2):
            _assert_uniform_square(a, b)
        for lag in (1, 2, 64):
            _assert_uniform_square(pixel[0, :-lag:2], pixel[0, lag::2])


@pytest.mark.parametrize("name", INTEGRATORS)
@pytest.mark.parametrize("split", SPLITS)
def test_screen_and_light_points_of_a_pixel_do_not_repeat_each_other(name, split):
    screen, light = _made(name, 64, split)
    for a in screen.points(KEYS, 0, 64):
        for b in light.points(KEYS, 0, 64 * split)[:, :, ::split]:
            correlation = ((a - 0.5) * (b - 0.5)).mean(axis=1) * 12
            # Independent orders: deviation 1/8 in each pixel. The pixels of a net share its order.
            assert np.square(correlation).mean() < 4 / 64


@pytest.mark.parametrize("name", INTEGRATORS)
def test_another_seed_gives_other_points(name):
    base = _made(name, 16)
    for seed in (4, -3, 2**32 - 1):
        for mine, other in zip(base, _made(name, 16, seed=seed), strict=True):
            assert (mine.points(KEYS, 0, 16) == other.points(KEYS, 0, 16)).mean() < 1e-3


@pytest.mark.parametrize("samples", [4, 64, 1024])
@pytest.mark.parametrize("split", SPLITS)
def test_sobol_integrates_a_smooth_function_better_than_chance(samples, split):
    error = {}
    for name in INTEGRATORS:
        screen, light = _made(name, samples, split)
        x = screen.points(KEYS[:256], 0, samples).astype(np.float64).sum(axis=0)
        y = light.points(KEYS[:256], 0, samples * split).astype(np.float64).sum(axis=0)
        mean = (np.exp(x) * np.exp(y).reshape(256, samples, split).mean(axis=2)).mean(axis=1)
        error[name] = np.sqrt(np.square(mean / (np.e - 1) ** 5 - 1).mean())
    assert error["sobol"] < 3.0 / samples**0.4 * error["monte_carlo"]


def test_dimensions_beyond_the_tables_last_are_pseudo_random():
    points = SobolPoints(range(MAX_DIMENSIONS + 2), 0, 0)
    points.prepare(1024)
    u = points.points(KEYS[:8], 0, 1024)
    assert u.shape[0] == MAX_DIMENSIONS + 2
    for d in range(MAX_DIMENSIONS, MAX_DIMENSIONS + 2):
        _assert_uniform_square(u[d].ravel(), u[0].ravel())
        # No net: its stratification would leave exactly one in each of 1024 intervals.
        assert len(np.unique((u[d, 0] * 1024).astype(int))) < 900
        assert len(np.unique((u[0, 0] * 1024).astype(int))) == 1024


def _assert_uniform_square(a: np.ndarray, b: np.ndarray, cells: int = 8) -> None:
    """Points (a, b) fill the unit square evenly, by a chi-square test at 1e-5."""
    counts, _, _ = np.histogram2d(a, b, cells, ((0, 1), (0, 1)))
    assert stats.chisquare(counts.ravel()).pvalue > 1e-5
