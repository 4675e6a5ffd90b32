# SPDX-License-Identifier: GPL-3.0-or-later
"""Maps along rays and the phase function against their densities, their integrals and their worst inputs."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate, stats

from engine_core.transport import phase
from engine_core.transport.distance_maps import (
    LONGEST,
    EquiAngular,
    FreePath,
    Tabulated,
    UntruncatedPath,
    within_depth,
)

CELLS, SAMPLES = 64, 100_000


def _tabulated(foot, distance, length):
    inner = EquiAngular(foot, distance, length)
    u = np.linspace(0, 1, 9)[:, None]
    return Tabulated(inner, np.exp(-3 * u * u) * np.ones_like(foot))


MAPS = {
    "equiangular": lambda n: EquiAngular(np.full(n, 1.5), np.full(n, 0.3), np.full(n, 4.0)),
    "equiangular, light behind": lambda n: EquiAngular(np.full(n, -2.0), np.full(n, 0.01), np.full(n, 4.0)),
    "free path, thin": lambda n: FreePath(np.full(n, 0.01), np.full(n, 4.0)),
    "free path, thick": lambda n: FreePath(np.full(n, 20.0), np.full(n, 4.0)),
    "tabulated": lambda n: _tabulated(np.full(n, 1.5), np.full(n, 0.3), np.full(n, 4.0)),
}


@pytest.mark.parametrize("make", MAPS.values(), ids=MAPS)
def test_samples_are_distributed_as_the_density_says(make):
    rng = np.random.default_rng(5)
    t = make(SAMPLES).sample(rng.random(SAMPLES))
    assert t.min() >= 0 and t.max() <= 4
    # Cells of about the same share, between quantiles of the samples themselves.
    edges = np.concatenate([[0], np.quantile(t, np.arange(1, CELLS) / CELLS), [4]])
    nodes, weights = np.polynomial.legendre.leggauss(16)
    step = np.diff(edges)
    at = (edges[:-1, None] + step[:, None] * (nodes + 1) / 2).ravel()
    expected = (make(len(at)).pdf(at).reshape(CELLS, 16) * weights).sum(axis=1) * step / 2
    assert expected.sum() == pytest.approx(1, abs=2e-3)
    found = np.histogram(make(SAMPLES).sample(rng.random(SAMPLES)), edges)[0]
    expected *= SAMPLES / expected.sum()
    chi_square = (np.square(found - expected) / expected).sum()
    assert stats.chi2.sf(chi_square, CELLS - 1) > 1e-3


@pytest.mark.parametrize("make", MAPS.values(), ids=MAPS)
def test_the_ends_of_the_unit_interval_are_those_of_the_segment(make):
    assert np.allclose(make(2).sample(np.array([0.0, 1.0])), [0, 4], atol=1e-9)


TINY = [1, 1e-3, 1e-6, 1e-9, 1e-30, 1e-150, 1e-300, 0]


@pytest.mark.parametrize("foot", [-5.0, -1e-9, 0.0, 1e-9, 1.0, 3.0, 3 + 1e-9, 1e6, 1e30])
def test_equiangular_survives_a_light_on_the_ray(foot):
    """Finite, within the segment, and exact in the mean of f / pdf, wherever the light is."""
    u = np.linspace(0, 1, 4097)
    n = len(u)
    for distance in TINY:
        at = EquiAngular(np.full(n, foot), np.full(n, distance), np.full(n, 3.0))
        t = at.sample(u)
        pdf = at.pdf(t)
        assert np.isfinite(t).all() and np.isfinite(pdf).all() and (pdf > 0).all()
        assert t.min() >= 0 and t.max() <= 3 and (np.diff(t) >= 0).all()
        assert t[0] == 0 and t[-1] == pytest.approx(3, rel=1e-6)
        assert np.allclose(at.cdf(t), u, atol=1e-6)
        # What is as the density is constant.
        d = at.distance
        value = 1 / (pdf * (d * d + np.square(t - foot)))
        assert np.allclose(value, at.weight, rtol=1e-6)


def test_equiangular_integrates_what_falls_off_from_a_light():
    rng = np.random.default_rng(2)
    for _ in range(40):
        foot, distance, length = rng.uniform(-3, 5), 10 ** rng.uniform(-3, 1), 10 ** rng.uniform(-2, 1)

        def f(t, foot=foot, distance=distance):
            return np.exp(-0.4 * t) / (distance**2 + (t - foot) ** 2)

        u = (np.arange(20_000) + 0.5) / 20_000
        at = EquiAngular(*(np.full(len(u), x) for x in (foot, distance, length)))
        t = at.sample(u)
        middle = [foot] if 0 < foot < length else None
        exact = integrate.quad(f, 0, length, points=middle, epsabs=0, epsrel=1e-11, limit=500)[0]
        assert (f(t) / at.pdf(t)).mean() == pytest.approx(exact, rel=1e-7)


@pytest.mark.parametrize("sigma", [0, 1e-12, 1e-9, 1e-3, 1, 1e4])
@pytest.mark.parametrize("length", [1e-6, 1, 1e6, 1e30, np.inf])
def test_free_paths_in_fogs_of_all_densities(sigma, length):
    length = float(within_depth(np.array([sigma]), np.array([length]))[0])
    if not np.isfinite(length):
        return  # what has no extinction scatters nothing
    u = np.linspace(0, 1, 1001)
    at = FreePath(np.full(1001, float(sigma)), np.full(1001, length))
    t = at.sample(u)
    pdf = at.pdf(t)
    assert np.isfinite(t).all() and np.isfinite(pdf).all()
    assert t[0] == 0 and t[-1] == pytest.approx(length) and t.max() <= length and (np.diff(t) >= 0).all()
    assert (t[1:] > 0).all()
    # sigma exp(-sigma t) over its density is the probability of scattering, to the last digits.
    depth = sigma * length
    if sigma:
        inside = pdf > 0
        ratio = sigma * np.exp(-sigma * t[inside]) / pdf[inside]
        assert np.allclose(ratio, -np.expm1(-depth), rtol=1e-12)
    else:
        assert np.allclose(pdf * length, 1)
    if sigma and depth > 1e-3:
        assert np.allclose(-np.expm1(-sigma * t), u * -np.expm1(-depth), rtol=1e-9, atol=1e-15)


def test_untruncated_paths_leave_the_segment_as_often_as_light_does():
    u = (np.arange(100_000) + 0.5) / 100_000
    at = UntruncatedPath(np.full(u.shape, 0.7), np.ones(u.shape))
    assert (at.sample(u) > 1).mean() == pytest.approx(np.exp(-0.7), abs=1e-4)
    t = np.linspace(0, 40, 100_001)
    assert integrate.simpson(at.pdf(t[:100_000]), x=t[:100_000]) == pytest.approx(1, abs=1e-4)
    none = UntruncatedPath(np.zeros(2), np.ones(2))
    assert (none.sample(np.array([0.1, 0.9])) > 1e200).all() and (none.pdf(np.ones(2)) == 0).all()


def test_a_table_that_is_constant_or_vanishes_does_no_harm():
    u = np.linspace(0, 1, 101)
    inner = EquiAngular(np.full(101, 1.0), np.full(101, 0.2), np.full(101, 3.0))
    for factor in (np.ones((9, 101)), np.zeros((9, 101)), np.full((9, 101), 1e-30)):
        at = Tabulated(inner, factor)
        t = at.sample(u)
        assert np.allclose(t, inner.sample(u), atol=1e-9) and np.allclose(at.pdf(t), inner.pdf(t))
    only_the_end = np.zeros((9, 101))
    only_the_end[-1] = 1
    at = Tabulated(inner, only_the_end)
    t = at.sample(u)
    assert np.isfinite(t).all() and (at.pdf(t) > 0).all() and t[0] == 0 and t[-1] == pytest.approx(3)


def test_the_longest_depth_is_that_of_1e_30():
    assert np.exp(-LONGEST) == pytest.approx(1e-30)


# -- phase function ----------------------------------------------------------------------------------


@pytest.mark.parametrize("g", [-1.0, -0.99, -0.5, -1e-9, 0.0, 1e-9, 0.3, 0.8, 0.99, 0.9999, 1.0])
def test_the_phase_function_is_a_density_of_mean_cosine_g(g):
    g = float(phase.bounded(g))
    # In the squared sine of half the angle, whose logarithm tells a peak from its surroundings.
    s = np.linspace(np.log(1e-14), np.log(0.5), 20_001)
    small = np.exp(s)
    peak = [(small, 1 - small), (1 - small, small)]
    total = mean = 0.0
    for less, more in peak:
        weight = 4 * np.pi * phase.value(less, more, g) * small
        total += integrate.simpson(weight, x=s)
        mean += integrate.simpson(weight * (more - less), x=s)
    assert total == pytest.approx(1, abs=2e-4)
    assert mean == pytest.approx(g, abs=3e-4)


@pytest.mark.parametrize("g", [-0.9, -0.4, 0.0, 1e-7, 0.6, 0.95, 0.9999])
def test_scattered_directions_are_distributed_as_the_phase_function(g):
    rng = np.random.default_rng(8)
    before = np.array([0.48, -0.6, 0.64])[:, None] * np.ones(SAMPLES)
    after = phase.sample(before, g, rng.random((2, SAMPLES)))
    assert np.allclose((after * after).sum(axis=0), 1, atol=1e-12)
    assert (after * before).sum(axis=0).mean() == pytest.approx(g, abs=0.006)
    # Cells of equal probability in the cosine, by the cdf from the half angle; and equal ones about the axis.
    less, more = phase.half_angle(before, after)
    root = np.sqrt((1 - g) ** 2 * more + (1 + g) ** 2 * less)
    # 1 - cdf, as the quotient that has no difference: (1 + g)^2 less / (root (root + 1 - g)) ... for all g.
    beyond = 2 * (1 + g) * less / (root * (root + 1 - g))
    side = np.cross([0.48, -0.6, 0.64], [0, 0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, [0.48, -0.6, 0.64])
    phi = np.arctan2(up @ after, side @ after)
    found, _, _ = np.histogram2d(beyond, phi, (16, 16), [[0, 1], [-np.pi, np.pi]])
    expected = SAMPLES / 256
    assert stats.chi2.sf((np.square(found - expected) / expected).sum(), 255) > 1e-3


def test_half_angles_keep_their_digits():
    angle = 10.0 ** np.arange(-12, 0)
    before = np.array([np.zeros(12), np.zeros(12), np.ones(12)])
    after = np.array([np.sin(angle), np.zeros(12), np.cos(angle)])
    less, more = phase.half_angle(before, after)
    assert np.allclose(less, np.sin(angle / 2) ** 2, rtol=1e-6) and np.allclose(less + more, 1)
