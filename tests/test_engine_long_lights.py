# SPDX-License-Identifier: GPL-3.0-or-later
"""How rays pass tubes: means of 1 / D against quadrature, and what is degenerate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import integrate

from engine_core.transport.long_lights import past

THICKNESS = 0.05


def of_one(core, vector, direction, thickness: float = THICKNESS) -> tuple[float, float, float]:
    """What `past` says of one ray, as numbers."""
    core, vector, direction = (np.array(x, float)[:, None] for x in (core, vector, direction))
    direction /= np.linalg.norm(direction)
    foot = (vector * direction).sum(axis=0)
    beside = vector - foot * direction
    square = (beside * beside).sum(axis=0) + thickness**2
    found = past(core, vector, foot, direction, square)
    return tuple(float(x[0]) for x in found)


def distance(y: float, core, vector, direction, thickness: float = THICKNESS) -> float:
    """Of the place y on the core from the ray, softened."""
    direction = np.array(direction) / np.linalg.norm(direction)
    place = np.array(vector) + y * np.array(core)
    beside = place - place @ direction * direction
    return np.sqrt(beside @ beside + thickness**2)


@pytest.mark.parametrize("seed", range(20))
def test_mean_is_that_of_quadrature_and_the_nearest_place_is_nearest(seed: int):
    random = np.random.default_rng(seed)
    ray = random.normal(size=3) * 0.7, random.normal(size=3) + (0, 0, 2), random.normal(size=3)
    square, near, along = of_one(*ray)
    mean = integrate.quad(lambda y: 1 / distance(y, *ray), -1, 1, points=[near], epsabs=1e-10)[0] / 2
    assert square**-0.5 == pytest.approx(mean, rel=1e-6)
    least = min(distance(y, *ray) for y in np.linspace(-1, 1, 2001))
    assert distance(near, *ray) == pytest.approx(least, rel=1e-3)
    assert along == pytest.approx(ray[0] @ ray[2] / np.linalg.norm(ray[2]))


@pytest.mark.parametrize("vector", [(0.3, 0, 2), (0, 0, 2), (0, 0, 0), (1e8, 0, 2)])
def test_a_ray_along_a_tube_is_as_far_from_all_of_it(vector: tuple[float, ...]):
    square, near, along = of_one((0, 0, 0.5), vector, (0, 0, 1))
    assert square == pytest.approx(vector[0] ** 2 + THICKNESS**2, rel=1e-5)
    assert near == pytest.approx(0, abs=1e-6)
    assert along == pytest.approx(0.5)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("core", [(0, 0, 0), (1e-20, 0, 0), (1, 0, 0)])
@pytest.mark.parametrize("thickness", [1e-18, 1e-3])
def test_nasty_rays_leave_finite_numbers(scale: float, core: tuple[float, ...], thickness: float):
    for vector in ((0, 0, 0), (0, 0, 1), (1, 1e-9, 0), (1, 0, 0)):
        for direction in ((1, 0, 0), (0, 1, 0), (1, 1e-9, 0)):
            found = of_one(np.multiply(scale, core), np.multiply(scale, vector), direction, thickness * scale)
            assert np.isfinite(found).all()
            assert found[0] > 0 and abs(found[1]) <= 1
