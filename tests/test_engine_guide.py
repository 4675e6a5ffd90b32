# SPDX-License-Identifier: GPL-3.0-or-later
"""What pilots learn of where fog is lit: grids, and that pictures are right by them, and better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import box, walls_with_window

from engine_core import Camera, Material, Scene, Settings, Sink, SunLight, Volume, World, render
from engine_core.integration.mapping import in_order
from engine_core.parts import parts_of
from engine_core.transport import guide as module
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.guide import CELLS, DIMENSIONS, GRIDS, Guide

WINDOW = 0.8, 1.6
"""Of the wall to the right: from where to where in y and z."""


def room() -> Scene:
    """Black walls about fog, and a window that lets in a sun and the sky."""
    fog = replace(box((-3.1, -3.1, -0.1), (3.1, 3.1, 3.1)), volume=0, surface=False)
    return Scene(
        Camera.look_at((-1.5, -2.5, 1.5), (0.5, 2, 1.2), 48, 32, 1.2, clip_start=0.05),
        [*walls_with_window(WINDOW), fog],
        [Material(0.0)],
        [SunLight(20.0, direction=(-1, -0.1, -0.4), angle=0.12)],
        World((0.5, 0.7, 1.0)),
        volumes=[Volume(scattering=0.1)],
    )


def learned(made: Scene, seed: int = 0) -> Guide | None:
    """Of the sky."""
    *_, part = parts_of(made, DirectLight(made), Settings(seed=seed), lambda: None)
    assert part.name == "fog lit by the world"
    part.by.learn(in_order)
    return part.by.integrand.guide


def spread(density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Grids of one tile, and what part of many points they put in each cell, by the densities of cells."""
    guide = Guide(module._grids(density)[None, None, None], [0], 16, (0, 0))
    n = 2 * CELLS
    u = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n] * DIMENSIONS, indexing="ij")).reshape(DIMENSIONS, -1)
    tiles = np.zeros((4, 1), np.intp), np.array([[1], [0], [0], [0]], np.float32)
    place, weight = guide.stretched(0, tiles, np.zeros(u.shape[1], np.intp), u.astype(np.float32))
    cells = np.minimum((place * CELLS).astype(np.intp), CELLS - 1)
    flat = np.ravel_multi_index(cells, [CELLS] * DIMENSIONS)
    return np.bincount(flat, minlength=CELLS**DIMENSIONS).reshape(density.shape) / u.shape[1], weight


def test_points_are_spread_as_the_density_says_though_dimensions_depend_on_each_other():
    density = np.full([CELLS] * DIMENSIONS, 0.2 / CELLS**DIMENSIONS)
    some = np.arange(0, CELLS, 3)
    density[some, some, (2 * some) % CELLS] += 0.8 / len(some)
    share, weight = spread(density)
    # Four of 1,728 cells, but for knots that lie beside each dimension's.
    assert share[some, some, (2 * some) % CELLS].sum() > 0.4
    assert weight.mean(dtype=np.float64) == pytest.approx(1, rel=1e-5)
    even, weight = spread(np.full([CELLS] * DIMENSIONS, 1.0))
    np.testing.assert_allclose(even, CELLS**-DIMENSIONS, rtol=1e-5)
    np.testing.assert_allclose(weight, 1, rtol=1e-5)


def test_what_few_points_tell_is_that_of_each_dimension_and_nothing_is_learned_of_what_is_even():
    shape = 1, 1, *[CELLS] * DIMENSIONS
    random = np.random.default_rng(3)
    along = random.uniform(0.1, 1, (DIMENSIONS, CELLS)) ** 4
    square = np.einsum("i,j,k->ijk", *along).reshape(shape)
    product = np.sqrt(square / square.sum())
    product *= (1 - module.EVERYWHERE) / product.sum()
    one = np.zeros(shape)
    one[0, 0, 2, 3, 4] = 1
    # By one point, and by many that are as bright as each other.
    few = module._density(square, np.full(shape, square.sum() ** 2 / square.size))
    np.testing.assert_allclose(few, product + module.EVERYWHERE / square.size, rtol=1e-9)
    many = module._density(one, one * 1e-12)
    assert many[0, 0, 2, 3, 4] > 0.79
    even = np.full(shape, 2.0)
    for nothing in (even, 0 * even):
        found = module._density(nothing, nothing * nothing)
        np.testing.assert_allclose(found, 1 / square.size)
        assert module._gain(nothing) == pytest.approx(1)
    assert module._gain(one) == pytest.approx(CELLS**DIMENSIONS)


def test_what_is_stretched_has_the_same_integral():
    random = np.random.default_rng(1)
    knots = np.zeros((2, 2, 2, GRIDS, CELLS + 1))
    knots[..., 1:] = np.cumsum(random.uniform(0.2, 3, (2, 2, 2, GRIDS, CELLS)), axis=-1)
    guide = Guide((knots / knots[..., -1:]).astype(np.float32), [0, 2], 16, (0, 0))
    n = 8 * CELLS
    u = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n] * DIMENSIONS)).reshape(DIMENSIONS, -1)
    u = u.astype(np.float32)
    weights = random.dirichlet(np.ones(4), 3).T.astype(np.float32)
    tiles = np.arange(4)[:, None].repeat(3, axis=1), weights
    for ray in range(3):
        for light in guide.gaining:
            place, weight = guide.stretched(light, tiles, np.full(u.shape[1], ray), u)
            assert place.min() > 0 and place.max() < 1
            assert weight.mean(dtype=np.float64) == pytest.approx(1, rel=1e-5)
            f = np.prod(1 + place.astype(np.float64) ** 2, axis=0)
            assert (f * weight).mean() == pytest.approx((4 / 3) ** DIMENSIONS, rel=2e-3)


def test_grids_change_smoothly_over_the_picture():
    guide = learned(room())
    assert np.abs(np.diff(guide._knots, axis=-1) * CELLS - 1).max() > 0.5
    x = np.linspace(0, 48, 481)
    tiles = guide.tiles(x, np.full(481, 11.3))
    np.testing.assert_allclose(tiles[1].sum(axis=0), 1, rtol=1e-6)
    u = np.array([[0.3], [0.6], [0.2]], np.float32)[: guide.dimensions].repeat(481, axis=1)
    place, weight = guide.stretched(guide.gaining[0], tiles, np.arange(481), u)
    assert np.abs(np.diff(place, axis=-1)).max() < 0.02
    assert np.abs(np.diff(np.log(weight), axis=-1)).max() < 0.2


def test_light_that_gains_nothing_has_no_guide():
    made = replace(room(), meshes=[mesh for mesh in room().meshes if not mesh.surface])
    assert learned(made) is None


def test_guided_pictures_are_unbiased():
    """The mean over seeds, of the whole picture and of its quarters, is that of plain samples."""
    made = room()

    def quarters(film):
        return film.volume.reshape(2, 16, 2, 24, 3).mean(axis=(1, 3, 4), dtype=np.float64)

    plain = np.array(
        [quarters(render(made, Settings(256, integrator="sobol", seed=900 + s))) for s in range(6)]
    )
    ours = np.array([quarters(render(made, Settings(4, seed=s))) for s in range(24)])
    error = np.hypot(ours.std(axis=0, ddof=1) / 24**0.5, plain.std(axis=0, ddof=1) / 6**0.5)
    difference = ours.mean(axis=0) - plain.mean(axis=0)
    assert (np.abs(difference) < 4.5 * error + 1e-3 * plain.mean()).all()


def test_a_guide_makes_the_error_less(monkeypatch):
    made = room()

    def error():
        films = np.array([render(made, Settings(4, seed=s)).volume for s in range(24)], np.float64)
        return np.sqrt(films.var(axis=0, ddof=1).mean())

    guided = error()
    monkeypatch.setattr(module, "WORTH", (1e9, 2e9))
    # .78, and .70 to .86 of eight seeds each; six were too few to tell.
    assert guided < 0.9 * error()


def test_threads_change_nothing_and_a_cancelled_picture_ends():
    made = room()
    one, two = (render(made, Settings(4, threads=threads)) for threads in (1, 2))
    np.testing.assert_array_equal(one.combined, two.combined)

    class Cancel(Sink):
        def cancelled(self) -> bool:
            return True

    assert np.isfinite(render(made, Settings(1 << 12, threads=2), Cancel()).combined).all()
