# SPDX-License-Identifier: GPL-3.0-or-later
"""Nested adaptive quadrature: exact for what its rule is exact for, within its tolerance elsewhere."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from engine_core.integration import quadrature
from engine_core.integration.integrand import FunctionOnGrid, GridCells
from engine_core.integration.point_sets import SobolPoints
from engine_core.integration.problem import Pool, Problem
from engine_core.integration.quadrature import Quadrature, integrate_rest, sum_quadrature
from engine_core.integration.rules import grid_nodes, halves, nested_rules, new_nodes

Function = Callable[[np.ndarray], np.ndarray]


def _problem(
    f: Function, ndim: int, bins: tuple[int, ...], samples: float = 16, seed: int = 0, threads: int = 1
) -> Problem:
    return Problem(FunctionOnGrid(f, ndim, len(bins), np.float64), ndim, bins, samples, seed, Pool(threads))


def _rest(f: Function, rest: int, lanes: int, tolerance: float, **more: int) -> tuple:
    """`integrate_rest` of f, whose first dimension is the middle of each of ``lanes`` bins."""
    integrand = FunctionOnGrid(f, rest + 1, 1, np.float64)
    stage = integrand.first(GridCells(np.arange(lanes)[None], (lanes,)), np.full((1, lanes, 1), 0.5))
    values, errors, evaluations = integrate_rest(integrand, stage, lanes, tolerance, **more)
    assert evaluations == integrand.evaluations
    return values, errors, evaluations


def _middles(lanes: int) -> np.ndarray:
    return (np.arange(lanes) + 0.5) / lanes


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_rules_are_exact_to_their_degree(dimensions: int) -> None:
    nodes, rules = grid_nodes(dimensions), nested_rules(dimensions)
    assert rules.shape == (1 + dimensions, 3**dimensions)
    assert rules[0] @ (nodes**3).prod(axis=0) == pytest.approx(0.25**dimensions, abs=1e-15)
    for d in range(dimensions):
        others = np.delete(nodes, d, axis=0)
        exact = 0.5 * 0.25 ** (dimensions - 1)
        assert rules[1 + d] @ (nodes[d] * (others**3).prod(axis=0)) == pytest.approx(exact, abs=1e-15)
        # The trapezoidal rule takes the mean of the square's ends, 1/2, for 1/3.
        assert rules[1 + d] @ nodes[d] ** 2 == pytest.approx(0.5, abs=1e-15)


@pytest.mark.parametrize("dimensions", [1, 2, 3, 4])
def test_children_take_the_nodes_of_their_parent(dimensions: int) -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.cos(u + np.arange(dimensions)[:, None]).prod(axis=0)

    grid = grid_nodes(dimensions)
    for d in range(dimensions):
        new = new_nodes(dimensions, d)
        assert new.shape[1] == 2 * 3 ** (dimensions - 1)
        low, high = halves(f(grid)[None, :, None], f(new)[None, :, None], dimensions, d)
        half = grid.copy()
        half[d] /= 2
        np.testing.assert_array_equal(low[0, :, 0], f(half))
        half[d] += 0.5
        np.testing.assert_array_equal(high[0, :, 0], f(half))


@pytest.mark.parametrize("rest", [1, 2, 3])
def test_cubics_are_exact(rest: int) -> None:
    def cubic(u: np.ndarray) -> np.ndarray:
        return (1 + u[0]) * (1 + 2 * u[1:] - 3 * u[1:] ** 2 + 8 * u[1:] ** 3).prod(axis=0)

    values, _, _ = _rest(cubic, rest, 7, 1e-2)
    np.testing.assert_allclose(values[0], (1 + _middles(7)) * 3.0**rest, rtol=1e-13)


FAMILIES: dict[str, tuple[Function, Function]] = {  # of u and of the middles x, in one rest dimension
    "oscillatory": (lambda u: np.cos(9 * u[1] + u[0]), lambda x: (np.sin(9 + x) - np.sin(x)) / 9),
    "product peak": (
        lambda u: 1 / (0.01 + (u[1] - u[0]) ** 2),
        lambda x: 10 * (np.arctan(10 * (1 - x)) + np.arctan(10 * x)),
    ),
    "corner peak": (lambda u: (1 + 5 * u[1] + u[0]) ** -2, lambda x: 1 / ((1 + x) * (6 + x))),
    "continuous": (
        lambda u: np.exp(-5 * np.abs(u[1] - u[0])),
        lambda x: (2 - np.exp(-5 * x) - np.exp(-5 * (1 - x))) / 5,
    ),
    "discontinuous": (lambda u: np.where(u[1] < u[0], np.exp(u[1]), 0), np.expm1),
}


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("tolerance", [1e-1, 1e-3, 1e-5])
def test_the_tolerance_is_kept(family: str, tolerance: float) -> None:
    f, exact = FAMILIES[family]
    values, errors, _ = _rest(f, 1, 41, tolerance, max_levels=30)
    assert (errors <= tolerance).all()
    assert np.abs(values[0] - exact(_middles(41))).max() < tolerance


@pytest.mark.parametrize("rest", [2, 3])
def test_the_tolerance_is_kept_in_several_dimensions(rest: int) -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.exp(-2 * np.abs(u[1:] - u[0])).prod(axis=0)

    values, errors, _ = _rest(f, rest, 9, 0.02, max_levels=16)
    x = _middles(9)
    assert (errors <= 0.02).all()
    assert np.abs(values[0] - ((2 - np.exp(-2 * x) - np.exp(-2 * (1 - x))) / 2) ** rest).max() < 0.02


def test_no_node_of_an_interval_is_evaluated_twice() -> None:
    seen = []

    def f(u: np.ndarray) -> np.ndarray:
        seen.append(u.copy())
        return np.sqrt(np.abs(u[1] - u[0]))

    _rest(f, 1, 5, 1e-3, max_levels=20)
    points = np.concatenate(seen, axis=1)
    assert len(np.unique(points, axis=1).T) == points.shape[1] > 200


@pytest.mark.parametrize("rest", [1, 2, 3])
def test_a_bisection_costs_its_new_nodes_alone(rest: int) -> None:
    _, _, evaluations = _rest(lambda u: u[0], rest, 4, 1.0, min_levels=2)
    assert evaluations == 4 * (3**rest + 3 * 2 * 3 ** (rest - 1))


def test_a_jump_is_bisected_to_the_last_level() -> None:
    values, errors, evaluations = _rest(lambda u: (u[1] < u[0]) * 1.0, 1, 1, 0, min_levels=1, max_levels=30)
    # Its place 1/2 is a node, and one of the two intervals beside it has the jump.
    assert abs(values[0, 0] - 0.5) < 2.0**-30
    assert 0 < errors[0] < 2.0**-30
    assert evaluations == 3 + 2 * 30


def test_lanes_do_not_depend_on_each_other_nor_on_the_memory() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.where(u[1] + u[2] < 2 * u[0], 1.0, 0.1)

    together = _rest(f, 2, 50, 0.05)
    apart = _rest(f, 2, 50, 0.05, limit=500)
    assert together[2] == apart[2]
    for a, b in zip(together[:2], apart[:2], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15)


def test_powers_of_two_change_no_decision() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.exp(-(((u[2] - u[0]) / 0.1) ** 2))

    plain = Quadrature().estimate(_problem(f, 3, (5, 4)))
    for factor in (2.0**40, 2.0**-40):
        scaled = Quadrature().estimate(_problem(lambda u, factor=factor: factor * f(u), 3, (5, 4)))
        assert scaled.evaluations == plain.evaluations
        np.testing.assert_array_equal(scaled.value, factor * plain.value)


@pytest.mark.parametrize("bins", [(1,), (7,), (10, 10), (1, 1), (1, 30)])
def test_bins_of_a_function_of_the_rest_are_equal(bins: tuple[int, ...]) -> None:
    result = Quadrature(tolerance=1e-4).estimate(_problem(lambda u: np.exp(u[-1]), len(bins) + 1, bins))
    assert result.value.shape == (1, *bins)
    np.testing.assert_allclose(result.value, np.e - 1, rtol=1e-5)
    assert (result.sample_count == 1).all()


def test_without_rest_dimensions_it_is_the_mean_over_a_net() -> None:
    result = Quadrature().estimate(_problem(lambda u: u[0] * u[1], 2, (4, 4), samples=64))
    assert result.evaluations == 16 * 64
    x = (np.arange(4) + 0.5) / 4
    np.testing.assert_allclose(result.value[0], np.outer(x, x), rtol=2e-2)
    with pytest.raises(ValueError, match="rest dimensions"):
        _rest(lambda u: u[0], 0, 4, 1.0)


def test_the_error_is_honest() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.where(u[2] < 0.2 + 0.6 * u[0], 1 + u[1], 0)

    x, y = ((np.indices((16, 16)) + 0.5) / 16).reshape(2, 16, 16)
    exact = (0.2 + 0.6 * x) * (1 + y)
    for points in (2, 4):
        result = Quadrature(points=points).estimate(_problem(f, 3, (16, 16)))
        error = np.sqrt(((result.value[0] - exact) ** 2).mean())
        claimed = np.sqrt((result.standard_error[0] ** 2).mean())
        assert error < claimed < 12 * error
    alone = Quadrature(points=1).estimate(_problem(f, 3, (1, 1)))
    assert (alone.standard_error >= alone.value).all()  # One sample tells nothing.


def test_the_bias_is_as_documented() -> None:
    def ridge(u: np.ndarray) -> np.ndarray:
        return (0.5 + u[1]) * np.exp(-(((u[2] - 0.3 - 0.4 * u[0]) / 0.08) ** 2))

    # The same screen points with the finest quadrature: what is left is the default's bias.
    default, fine = (
        m.estimate(_problem(ridge, 3, (16, 16), seed=2))
        for m in (Quadrature(points=4), Quadrature(1e-6, 4, min_levels=6, max_levels=24))
    )
    bias = (default.value - fine.value) / fine.value.mean()
    assert abs(bias.mean()) < 1e-4
    assert 1e-5 < np.sqrt((bias**2).mean()) < 1e-3
    # Detail between the first nodes is not seen, and no error is reported.
    values, errors, _ = _rest(lambda u: (np.abs(u[1] - 0.53) < 0.02) * 1.0, 1, 1, 1e-3)
    assert values[0, 0] == errors[0] == 0


def test_what_is_not_finite_counts_as_nothing() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.where(u[1] < 0.25, np.nan, np.where(u[1] == 1, np.inf, 1.0))

    result = Quadrature().estimate(_problem(f, 2, (3,)))
    assert result.non_finite > 0
    np.testing.assert_allclose(result.value, 0.75, atol=0.02)
    assert np.isfinite(result.value).all()


def test_light_that_only_some_bins_see_costs_little() -> None:
    # Every 16th bin, none of which is among those first asked for the mean magnitude.
    def f(u: np.ndarray) -> np.ndarray:
        return np.where((u[0] * 4096).astype(int) % 16 == 5, np.exp(u[1]), 0)

    result = Quadrature().estimate(_problem(f, 2, (4096,)))
    np.testing.assert_allclose(result.value[0, 5::16], np.e - 1, rtol=1e-3)
    assert result.value.sum() == pytest.approx(result.value[0, 5::16].sum())
    assert result.evaluations < 4096 * 40


def test_channels_come_together() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.stack([np.exp(u[2]), 3 * u[0] * u[2] ** 2, 0 * u[0]])

    result = Quadrature(tolerance=1e-4).estimate(_problem(f, 3, (2, 3), samples=64))
    assert result.value.shape == result.standard_error.shape == (3, 2, 3)
    np.testing.assert_allclose(result.value[0], np.e - 1, rtol=1e-5)
    assert (result.value[2] == 0).all()


def test_threads_change_nothing() -> None:
    def f(u: np.ndarray) -> np.ndarray:
        return np.where(u[2] < u[0] * u[1], 1.0, 0.2)

    one, two = (
        Quadrature().estimate(_problem(f, 3, (200, 200), samples=32, threads=threads)) for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.value, two.value)
    assert one.evaluations == two.evaluations


@dataclass
class _Stage:
    values: np.ndarray | None
    lane: np.ndarray | None
    x: np.ndarray


class _HalfHit:
    """A camera whose rays hit where x > 1/2; elsewhere a background of 7. Light comes in one channel of 2."""

    rest_dimensions, staged, non_finite = 1, True, 0

    def first(self, bins: GridCells, u: np.ndarray) -> _Stage:
        x = ((bins.index[0][:, None] + u[0]) / bins.shape[0]).ravel()
        lane = np.flatnonzero(x > 0.5)
        return _Stage(np.where(x > 0.5, 0, 7.0) * np.ones((2, 1)), lane, x[lane])

    def rest(self, stage: _Stage, lane: np.ndarray | None, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lane = np.arange(u.shape[1]) if lane is None else lane
        which = np.flatnonzero(u[0] > 0)
        return which, ((1 + stage.x[lane]) * np.square(u[0]))[which][None]


def test_lanes_that_need_no_rest_are_left_alone() -> None:
    problem = Problem(_HalfHit(), 2, (8,), 32, 0, Pool(1))
    result = Quadrature().estimate(problem)
    assert (result.value[:, :4] == 7).all()
    assert (result.value[1, 4:] == 0).all()
    x = (np.arange(4) + 4.5) / 8
    np.testing.assert_allclose(result.value[0, 4:], (1 + x) / 3, rtol=0.05)
    # 9 + 8 nodes of each of the two points of the four bins that hit, and of the pilot's one.
    assert result.evaluations == 4 * 3 * 17


def test_bins_that_hit_nothing_take_no_light_from_others(monkeypatch: pytest.MonkeyPatch) -> None:
    class Dark(_HalfHit):
        def first(self, bins: GridCells, u: np.ndarray) -> _Stage:
            return replace(super().first(bins, u), values=None)

    monkeypatch.setattr(quadrature, "_BATCH", 27)  # a bin at once, of which the first hit nothing
    points = SobolPoints(range(1), 0, 0)
    points.prepare(1)
    bins = GridCells(np.arange(8)[None], (8,))
    sums = sum_quadrature(Dark(), bins, np.arange(8, dtype=np.uint32), points, 0, 1, 1e-3)
    assert (sums.values[0] > 0).tolist() == 4 * [False] + 4 * [True]
    missed = sum_quadrature(Dark(), bins[:4], np.arange(4, dtype=np.uint32), points, 0, 1, 1e-3)
    assert missed.values.shape == (1, 4)


@pytest.mark.parametrize(
    "wrong", [{"tolerance": 0}, {"tolerance": -1}, {"points": -1}, {"min_levels": 5, "max_levels": 4}]
)
def test_wrong_parameters_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Quadrature(**wrong)


def test_too_many_dimensions_are_refused() -> None:
    with pytest.raises(ValueError, match="8 dimensions"):
        Quadrature().estimate(_problem(lambda u: u[0], 10, (4, 4)))
