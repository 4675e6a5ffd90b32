# SPDX-License-Identifier: GPL-3.0-or-later
"""What pilots learn of where fog is lit: grids, and that pictures are right by them, and better."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import box

from engine_core import Camera, Material, Scene, Settings, Sink, SunLight, Volume, World, render
from engine_core.integration.mapping import in_order
from engine_core.parts import parts_of
from engine_core.transport import guide_in_fog as module
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.guide_in_fog import CELLS, DIMENSIONS, Guide, stretched

WINDOW = 0.8, 1.6
"""Of the wall to the right: from where to where in y and z."""


def room() -> Scene:
    """Black walls about fog, and a window that lets in a sun and the sky."""
    low, high = WINDOW
    walls = [
        ((-3, -3, -0.2), (3, 3, 0)),
        ((-3, -3, 3), (3, 3, 3.2)),
        ((-3.2, -3, 0), (-3, 3, 3)),
        ((-3, 3, 0), (3, 3.2, 3)),
        ((-3, -3.2, 0), (3, -3, 3)),
        ((3, -3, 0), (3.2, low, 3)),
        ((3, high, 0), (3.2, 3, 3)),
        ((3, low, 0), (3.2, high, low)),
        ((3, low, high), (3.2, high, 3)),
    ]
    fog = replace(box((-3.1, -3.1, -0.1), (3.1, 3.1, 3.1)), volume=0, surface=False)
    return Scene(
        Camera.look_at((-1.5, -2.5, 1.5), (0.5, 2, 1.2), 48, 32, 1.2, clip_start=0.05),
        [*(box(*corners) for corners in walls), fog],
        [Material(0.0)],
        [SunLight(20.0, direction=(-1, -0.1, -0.4), angle=0.02)],
        World((0.5, 0.7, 1.0)),
        volumes=[Volume(scattering=0.1)],
    )


def learned(made: Scene, seed: int = 0) -> Guide:
    (part,) = parts_of(made, DirectLight(made), Settings(seed=seed), lambda: None)
    part.by.learn(in_order)
    return part.by.integrand.guide


def test_grids_are_fine_where_pilots_found_much_and_even_where_nothing_is_gained():
    square = np.array([np.eye(CELLS)[2], np.linspace(1, 1.5, CELLS), np.zeros(CELLS)])
    fine, *even = module._grids(square)
    assert (np.diff(fine) > 0).all() and fine[0] == 0 and fine[-1] == 1
    inside = 2 / CELLS, 3 / CELLS
    share = np.diff(np.interp(inside, fine, np.linspace(0, 1, CELLS + 1)))[0]
    # What is not the same everywhere is all in one cell, but for knots beside it.
    assert share == pytest.approx(1 - module.EVERYWHERE * (1 - 1 / CELLS), abs=1 / CELLS)
    np.testing.assert_allclose(even, np.broadcast_to(np.arange(CELLS + 1) / CELLS, (2, CELLS + 1)), atol=1e-6)


def test_what_is_stretched_has_the_same_integral():
    random = np.random.default_rng(1)
    knots = np.zeros((3, 2, DIMENSIONS, CELLS + 1))
    knots[..., 1:] = np.cumsum(random.uniform(0.2, 3, (3, 2, DIMENSIONS, CELLS)), axis=-1)
    knots = (knots / knots[..., -1:]).astype(np.float32)
    n = 16 * CELLS
    u = np.stack(np.meshgrid(*[(np.arange(n) + 0.5) / n] * DIMENSIONS)).reshape(DIMENSIONS, -1)
    u = u.astype(np.float32)
    for ray in range(3):
        place, weight = stretched(knots, np.full(u.shape[1], ray), u)
        assert place.min() > 0 and place.max() < 1
        for light in range(2):
            assert weight[light].mean(dtype=np.float64) == pytest.approx(1, rel=1e-5)
            f = np.prod(1 + place[:, light].astype(np.float64) ** 2, axis=0)
            assert (f * weight[light]).mean() == pytest.approx((4 / 3) ** DIMENSIONS, rel=1e-3)


def test_grids_change_smoothly_over_the_picture():
    guide = learned(room())
    assert np.abs(np.diff(guide._knots, axis=-1) * CELLS - 1).max() > 0.5
    x = np.linspace(0, 48, 481)
    knots = guide.knots(x, np.full(481, 11.3))
    assert (np.diff(knots, axis=-1) > 0).all()
    assert np.abs(np.diff(knots, axis=0)).max() < 0.1
    np.testing.assert_array_equal(knots[..., 0], 0)
    np.testing.assert_allclose(knots[..., -1], 1, atol=1e-6)


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
        films = np.array([render(made, Settings(4, seed=s)).volume for s in range(6)], np.float64)
        return films.std(axis=0, ddof=1).mean()

    guided = error()
    monkeypatch.setattr(module, "WORTH", (1e9, 2e9))
    assert guided < 0.85 * error()


def test_threads_change_nothing_and_a_cancelled_picture_ends():
    made = room()
    one, two = (render(made, Settings(4, threads=threads)) for threads in (1, 2))
    np.testing.assert_array_equal(one.combined, two.combined)

    class Cancel(Sink):
        def cancelled(self) -> bool:
            return True

    assert np.isfinite(render(made, Settings(1 << 12, threads=2), Cancel()).combined).all()
