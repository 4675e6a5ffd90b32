# SPDX-License-Identifier: GPL-3.0-or-later
"""The method as in the thesis: its polynomials, its heap, its cost, and the bias of its alpha."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest

from engine_core.integration.integrand import FunctionOnGrid
from engine_core.integration.problem import Pool, Problem
from engine_core.integration.result import Result
from engine_core.integration.thesis_2020 import MAX_LEVELS, Thesis2020

Function = Callable[[np.ndarray], np.ndarray]


def _problem(
    f: Function, ndim: int, bins: tuple[int, ...], samples: float = 64, seed: int = 0, threads: int = 1
) -> Problem:
    return Problem(FunctionOnGrid(f, ndim, len(bins), np.float64), ndim, bins, samples, seed, Pool(threads))


def _estimate(f: Function, ndim: int, bins: tuple[int, ...], samples: float = 64, **method: float) -> Result:
    return Thesis2020(**method).estimate(_problem(f, ndim, bins, samples))


def _bump(u: np.ndarray) -> np.ndarray:
    """Smooth, with its detail off centre, and no two dimensions alike."""
    d = np.arange(len(u))[:, None]
    return np.exp(-((8 + d) * (u - 0.3 - 0.07 * d) ** 2).sum(axis=0)) + 0.1 * u[0]


def _disk(u: np.ndarray) -> np.ndarray:
    return np.where(((u[:2] - 0.5) ** 2).sum(axis=0) < 0.16, 1.0, 0.1)


BINS = [(1, (5,)), (2, (7,)), (2, (4, 3)), (3, (1, 1)), (3, (3, 5)), (4, (6, 7)), (4, (2, 3, 2)), (4, (1, 9))]


@pytest.mark.parametrize("per_bin", [False, True])
@pytest.mark.parametrize(("ndim", "bins"), BINS)
def test_quadratics_are_exact_without_a_residual(ndim: int, bins: tuple[int, ...], per_bin: bool) -> None:
    def quadratic(u: np.ndarray) -> np.ndarray:
        d = np.arange(ndim)[:, None]
        return (1 + (d + 1) * u - 2 * u * u).prod(axis=0)

    result = _estimate(
        quadratic, ndim, bins, 600 if per_bin else 6000 / math.prod(bins), share=0.5, per_bin=per_bin
    )
    exact = np.ones(bins)
    for d, n in enumerate(bins):
        edges = np.arange(n + 1) / n
        means = np.diff(edges + (d + 1) * edges**2 / 2 - 2 * edges**3 / 3) * n
        exact = exact * means.reshape([-1 if i == d else 1 for i in range(len(bins))])
    for d in range(len(bins), ndim):
        exact = exact * (1 + (d + 1) / 2 - 2 / 3)
    assert result.regions > len(bins) + 1
    np.testing.assert_allclose(result.control_variate[0], exact, rtol=1e-13)
    np.testing.assert_allclose(result.value[0], exact, rtol=1e-13)
    assert np.abs(result.residual).max() < 1e-13
    assert result.standard_error.max() < 1e-13


@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
@pytest.mark.parametrize("per_bin", [False, True])
def test_a_bisection_costs_its_new_nodes_alone(ndim: int, per_bin: bool) -> None:
    problem = _problem(_bump, ndim, (4,), 4000)
    result = Thesis2020(per_bin=per_bin).estimate(problem)
    roots = 4 if per_bin else 1
    built = roots * 3**ndim + (result.regions - roots) * 2 * 3 ** (ndim - 1)
    assert result.evaluations == problem.integrand.evaluations == built + result.sample_count.sum()
    # The budget is spent to less than one more split (of each tree).
    assert 0 <= 1000 - built < 2 * 3 ** (ndim - 1) * roots
    assert result.evaluations == 16000
    assert np.ptp(result.sample_count) <= 1


def test_no_node_of_an_interval_is_evaluated_twice() -> None:
    seen = []

    def f(u: np.ndarray) -> np.ndarray:
        seen.append(u[0].copy())
        return np.abs(u[0] - 0.37)

    Thesis2020()._build(_problem(f, 1, (3,)), 201)
    assert len(np.unique(np.concatenate(seen))) == 201


@pytest.mark.parametrize("ndim", [1, 2, 3])
def test_the_heap_takes_the_worst_region_each_time(ndim: int) -> None:
    trees, _ = Thesis2020(epsilon=0)._build(_problem(_bump, ndim, (3,)), 600)
    weights = {"simpson": np.array([1, 4, 1]) / 6, "trapezoid": np.array([1, 0, 1]) / 2}

    def rule(level: tuple, index: tuple, trapezoid: int) -> float:
        total, corner = 0.0, np.array(index) / 2.0 ** np.array(level)
        for node in itertools.product(range(3), repeat=ndim):
            w = math.prod(
                weights["trapezoid" if d == trapezoid else "simpson"][n] for d, n in enumerate(node)
            )
            u = corner + np.array(node) / 2 / 2.0 ** np.array(level)
            total += w * _bump(u[:, None])[0]
        return total * 2.0 ** -sum(level)

    def judged(level: tuple, index: tuple) -> tuple[float, int, tuple, tuple]:
        errors = [abs(rule(level, index, -1) - rule(level, index, d)) for d in range(ndim)]
        return max(errors), int(np.argmax(errors)), level, index

    regions = [judged((0,) * ndim, (0,) * ndim)]
    while len(regions) < trees.count:
        worst = max(regions)
        regions.remove(worst)
        _, d, level, index = worst
        for child in (0, 1):
            regions.append(
                judged(
                    tuple(n + (i == d) for i, n in enumerate(level)),
                    tuple(2 * n + child if i == d else n for i, n in enumerate(index)),
                )
            )
    expected = {(level, index) for _, _, level, index in regions}
    count = trees.count
    found = {
        (tuple(level), tuple(index))
        for level, index in zip(
            trees.level[:, :count].T.tolist(), trees.index[:, :count].T.tolist(), strict=True
        )
    }
    assert found == expected


@pytest.mark.parametrize("bins", [(1,), (7,), (100,), (1000,), (1920,), (1, 1), (7, 7), (100, 19), (3, 640)])
def test_sums_of_bins_equal_the_whole(bins: tuple[int, ...]) -> None:
    whole = _estimate(_disk, 3, (1,), 32000, share=0.25)
    result = _estimate(_disk, 3, bins, 32000 / math.prod(bins), share=0.25)
    assert result.regions == whole.regions == 443
    assert result.control_variate.mean() == pytest.approx(whole.control_variate.mean(), rel=1e-13)


@pytest.mark.parametrize("bins", [1, 2, 3, 7, 64, 100, 101, 127, 129, 1920, 2000])
def test_no_sliver_of_a_region_is_lost(bins: int) -> None:
    # With a constant all is size term: a regular grid, whose edges lie anywhere in the bins.
    result = _estimate(lambda u: 3 + 0 * u[0], 2, (bins,), 64000 / bins, share=0.1)
    assert result.regions > 1000
    np.testing.assert_allclose(result.control_variate, 3, rtol=1e-13)
    np.testing.assert_allclose(result.value, 3, rtol=1e-13)


@pytest.mark.parametrize("bins", [(11,), (5, 6)])
def test_bins_integrate_the_polynomial_that_samples_see(bins: tuple[int, ...]) -> None:
    method = Thesis2020(share=0.5)
    problem = _problem(_disk, 2, bins, 2000)
    result = method.estimate(problem)
    trees, _ = method._build(problem, 1000 * math.prod(bins))
    n = 990  # A multiple of all these numbers of bins.
    at = (np.stack(np.meshgrid(*[np.arange(n)] * 2, indexing="ij")).reshape(2, -1) + 0.5) / n
    h = trees.evaluate(np.zeros(n * n, np.int64), at)[0].reshape(bins[0], n // bins[0], n)
    means = h.mean(axis=(1, 2))
    if len(bins) == 2:
        means = h.reshape(*bins[:1], -1, bins[1], n // bins[1]).mean(axis=(1, 3))
    np.testing.assert_allclose(result.control_variate[0], means, atol=2e-3)


@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
def test_polynomials_interpolate_the_integrand_at_their_nodes(ndim: int) -> None:
    trees, _ = Thesis2020()._build(_problem(_bump, ndim, (3,)), 2000)
    slots = np.arange(trees.count)
    node = np.random.default_rng(1).integers(0, 2, (ndim, trees.count)) / 2  # Inside, or at a lower face.
    u = (trees.index[:, slots] + node) / 2.0 ** trees.level[:, slots]
    np.testing.assert_allclose(trees.evaluate(np.zeros(trees.count, np.int64), u)[0], _bump(u), rtol=1e-13)


def test_one_bin_is_its_own_control_variate() -> None:
    shared = _estimate(_bump, 3, (1, 1), 2000)
    own = _estimate(_bump, 3, (1, 1), 2000, per_bin=True)
    assert shared.regions == own.regions > 1
    np.testing.assert_allclose(shared.value, own.value, rtol=1e-14)


def test_bins_of_their_own_see_their_own_detail() -> None:
    own = _estimate(_bump, 2, (4, 3), 640, per_bin=True)
    apart = _estimate(lambda u: _bump(np.stack([(u[0] + 2) / 4, (u[1] + 1) / 3])), 2, (1, 1), 640)
    assert own.regions == 12 * apart.regions
    assert own.control_variate[0, 2, 1] == pytest.approx(apart.control_variate[0, 0, 0], rel=1e-13)


@pytest.mark.parametrize("per_bin", [False, True])
def test_powers_of_two_change_no_split(per_bin: bool) -> None:
    plain = _estimate(_bump, 3, (3, 4), 500, per_bin=per_bin)
    for factor in (2.0**40, 2.0**-40):
        scaled = _estimate(lambda u, factor=factor: factor * _bump(u), 3, (3, 4), 500, per_bin=per_bin)
        assert scaled.regions == plain.regions
        np.testing.assert_array_equal(scaled.value, factor * plain.value)
        np.testing.assert_array_equal(scaled.control_variate, factor * plain.control_variate)


def test_a_constant_added_is_added() -> None:
    plain = _estimate(_bump, 3, (3, 4), 500, epsilon=0)
    higher = _estimate(lambda u: _bump(u) + 8, 3, (3, 4), 500, epsilon=0)
    np.testing.assert_allclose(higher.value, plain.value + 8, rtol=1e-13)
    np.testing.assert_allclose(higher.residual, plain.residual, atol=1e-12)


def test_permuting_the_inner_dimensions_permutes_nothing_else() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.exp(-4 * u[1] * u[0] - ((u[2] - 0.3) / 0.2) ** 2)

    plain = _estimate(f, 3, (8,), 900)
    permuted = _estimate(lambda u: f(u[[0, 2, 1]]), 3, (8,), 900)
    np.testing.assert_allclose(plain.control_variate, permuted.control_variate, rtol=1e-12)


@pytest.mark.parametrize("per_bin", [False, True])
@pytest.mark.parametrize("samples", [1, 1.5, 2, 5])
def test_few_samples(per_bin: bool, samples: float) -> None:
    result = _estimate(_bump, 4, (3, 2), samples, per_bin=per_bin)
    assert result.regions == 0  # 81 nodes would be needed.
    assert (result.control_variate == 0).all()
    assert result.sample_count.sum() == result.evaluations == int(6 * samples)
    assert np.isinf(result.standard_error[0][result.sample_count == 1]).all()
    assert np.isfinite(result.standard_error[0][result.sample_count > 1]).all()


@pytest.mark.parametrize("per_bin", [False, True])
@pytest.mark.parametrize("ndim", [1, 2, 3, 4])
def test_what_is_not_finite_counts_as_nothing(ndim: int, per_bin: bool) -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.where((u < 0.3).all(axis=0), np.nan, np.where((u == 1).any(axis=0), np.inf, 1.0))

    result = _estimate(f, ndim, (4,), 6000, per_bin=per_bin)
    assert result.non_finite > 0
    for array in (result.value, result.standard_error, result.control_variate):
        assert np.isfinite(array).all()
    error = np.abs(result.value[0].mean() - (1 - 0.3**ndim))
    assert error < 5 * np.sqrt((result.standard_error**2).sum()) / 4 + 1e-7  # A jump is known to its region.


def test_nothing_is_nothing() -> None:
    result = _estimate(lambda u: 0 * u[0], 3, (4, 4), 400)
    assert (result.value == 0).all()
    assert (result.standard_error == 0).all()
    assert result.regions > 10


def test_unseen_regions_are_not_split_to_slivers() -> None:
    trees, _ = Thesis2020()._build(_problem(lambda u: 0 * u[0], 3, (4,)), 10000)
    assert np.ptp(trees.level[:, : trees.count].sum(axis=0)) <= 1
    assert np.ptp(trees.level[:, : trees.count]) <= 1


def test_a_point_spike_exhausts_its_splits() -> None:
    result_of = {}
    for ndim in (1, 4):
        f = lambda u: (u == 0).all(axis=0) * 1.0  # noqa: E731
        method = Thesis2020(epsilon=0)
        trees, _ = method._build(_problem(f, ndim, (2,)), 3**ndim + 2 * 3 ** (ndim - 1) * 400)
        level = trees.level[:, : trees.count]
        assert trees.count == 401
        assert level.max() == MAX_LEVELS
        result_of[ndim] = level
        volume = np.ldexp(1.0, -level.sum(axis=0))
        assert volume.sum() == 1
    # The corner's region has every dimension at its end.
    assert (result_of[4] == MAX_LEVELS).all(axis=0).any()


def test_channels_come_together() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.stack([_bump(u), 2 * _bump(u), 0 * u[0]])

    result = _estimate(f, 3, (4, 5), 200)
    assert result.value.shape == result.standard_error.shape == (3, 4, 5)
    np.testing.assert_allclose(2 * result.value[0], result.value[1], rtol=1e-14)
    assert (result.value[2] == 0).all()


@pytest.mark.parametrize("per_bin", [False, True])
def test_threads_and_runs_change_nothing(per_bin: bool) -> None:
    one, two, again, other = (
        Thesis2020(per_bin=per_bin).estimate(_problem(_disk, 2, (60, 55), 100, seed, threads))
        for threads, seed in ((1, 5), (2, 5), (2, 5), (2, 6))
    )
    for result in (two, again):
        np.testing.assert_array_equal(one.value, result.value)
        np.testing.assert_array_equal(one.standard_error, result.standard_error)
    assert (one.control_variate == other.control_variate).all()
    assert (one.value != other.value).any()


def _alpha_bias(samples: int) -> tuple[float, float, float]:
    """Mean error and its deviation over 40,000 bins of one polynomial, and what integration over all
    pairs of samples predicts for two samples."""
    bins = 40000

    def f(u: np.ndarray) -> np.ndarray:
        return np.exp(2 * u[1])

    # Nine evaluations make one region for all bins; f does not see the bins' dimension.
    result = _estimate(f, 2, (bins,), samples + 14 / bins, share=14.5 / (samples * bins + 14))
    assert result.regions == 1
    assert (result.sample_count == samples).mean() > 0.999
    error = result.value.ravel() - np.expm1(2) / 2
    # E[f1 + alpha (H - h1)], with alpha = (f1 - f2) / (h1 - h2).
    a, b = np.polynomial.legendre.leggauss(60), np.polynomial.legendre.leggauss(61)
    u, v = (a[0][:, None] + 1) / 2, (b[0][None] + 1) / 2
    quadratic = np.polynomial.Polynomial.fit([0, 0.5, 1], np.exp([0, 1, 2]), 2)
    h = quadratic.integ()(1) - quadratic.integ()(0)
    alpha = (np.exp(2 * u) - np.exp(2 * v)) / (quadratic(u) - quadratic(v))
    value = np.exp(2 * u) + alpha * (h - quadratic(u))
    predicted = (value * a[1][:, None] * b[1]).sum() / 4 - np.expm1(2) / 2
    return error.mean(), error.std() / np.sqrt(bins), predicted


def test_alpha_is_biased_at_two_samples_and_hardly_at_sixteen() -> None:
    error, deviation, predicted = _alpha_bias(2)
    assert abs(error - predicted) < 4 * deviation
    assert abs(error) > 10 * deviation
    errors = [abs(_alpha_bias(n)[0]) for n in (2, 4, 16)]
    # 1 %, 0.3 % and 0.1 % of the mean.
    assert errors[2] < errors[0] / 5 and errors[1] < errors[0]
    assert errors[2] < 2e-3 * np.expm1(2) / 2
    # One sample leaves alpha at 1: no bias.
    error, deviation, _ = _alpha_bias(1)
    assert abs(error) < 4 * deviation


@pytest.mark.parametrize("per_bin", [False, True])
def test_errors_agree_with_the_standard_errors(per_bin: bool) -> None:
    bins = (8, 8)
    exact = _estimate_exact_disk(8)
    squares, claimed, means = 0.0, 0.0, 0.0
    seeds = 60
    for seed in range(seeds):
        result = Thesis2020(per_bin=per_bin).estimate(_problem(_disk, 2, bins, 64, seed))
        error = result.value[0] - exact
        squares, claimed = squares + error**2, claimed + result.standard_error[0] ** 2
        means = means + error / seeds
    assert 0.8 < np.sqrt(np.sum(squares) / np.sum(claimed)) < 1.25
    # What bias of alpha is left at 60 samples: less than a tenth of a run's error.
    assert np.sqrt((means**2).mean()) < (0.1 + 1.2 / np.sqrt(seeds)) * np.sqrt(np.mean(squares) / seeds)


def _estimate_exact_disk(n: int) -> np.ndarray:
    """(n, n) means of `_disk`, its chords' lengths integrated along the other dimension."""
    x = (np.arange(n * 4000) + 0.5) / (n * 4000)
    half = np.sqrt(np.maximum(0.16 - (x - 0.5) ** 2, 0))[:, None]
    edges = np.arange(n + 1) / n
    covered = np.diff(np.clip(edges, 0.5 - half, 0.5 + half), axis=1) * n
    return 0.1 + 0.9 * covered.reshape(n, 4000, n).mean(axis=1)


def test_it_follows_a_quadratic_better_than_chance() -> None:
    """The point of it all: smooth3 of the reference table at 16 and 64 samples (viltrum: 6.8e-5, 1.1e-5)."""

    def smooth(u: np.ndarray) -> np.ndarray:
        x, y, z = u
        return (1 + x * y + z * z) * np.exp(-(x + 2 * y) * z)

    # Gauss-Legendre in all dimensions of all bins is exact to rounding.
    g, w = np.polynomial.legendre.leggauss(6)
    x = ((np.arange(32)[:, None] + (g + 1) / 2) / 32).ravel()
    z, wz = np.polynomial.legendre.leggauss(20)
    values = smooth((x[:, None, None], x[None, :, None], (z + 1) / 2)) @ wz / 2
    exact = np.einsum("aibj,i,j->ab", values.reshape(32, 6, 32, 6), w / 2, w / 2)
    for samples, limit in ((16, 8e-5), (64, 1.2e-5)):
        result = _estimate(smooth, 3, (32, 32), samples)
        assert np.sqrt(((result.value[0] - exact) ** 2).mean()) / exact.mean() < limit


@pytest.mark.parametrize("wrong", [{"share": 1}, {"share": -0.1}, {"epsilon": -1}])
def test_wrong_parameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Thesis2020(**wrong)
