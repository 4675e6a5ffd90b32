# SPDX-License-Identifier: GPL-3.0-or-later
"""What is seen by itself is integrated apart: unbiased, and sharp where it matters."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scenes import area_light, blocks, box, pictures, studio

from engine_core import AreaLight, Camera, Material, PointLight, Scene, Settings, World, render

LAMP = PointLight(50.0, position=(0.4, -1.0, 1.5), radius=0.2, visible_to_camera=True)


def scene(**fields) -> Scene:
    """A lamp in the frame, a glowing box, and a sky."""
    lit = studio(32, 32, [LAMP, area_light(20.0)], world=World((0.2, 0.3, 0.5)), **fields)
    glow = replace(box((-1.9, -1, 0), (-1.5, -0.6, 0.5)), materials=2)
    return replace(lit, meshes=(*lit.meshes, glow), materials=(*lit.materials, Material(0.0, 0.0)))


@cache
def truth() -> tuple[np.ndarray, np.ndarray]:
    """Means of blocks, and their standard errors."""
    wanted = blocks(pictures(scene(), 4, samples=512, first=5000, integrator="sobol"))
    return wanted.mean(axis=0), wanted.std(axis=0, ddof=1) / 2


@pytest.mark.parametrize(("samples", "seeds"), [(1, 48), (16, 24)])
def test_the_mean_over_seeds_is_the_truth(samples, seeds):
    wanted, spread = truth()
    estimates = blocks(pictures(scene(), seeds, samples=samples))
    own = estimates.std(axis=0, ddof=1) / np.sqrt(seeds)
    # One pair of nets in many lies this far: 2 x 2 blocks, three colours, two sample counts.
    assert (np.abs(estimates.mean(axis=0) - wanted) < 4.5 * np.hypot(own, spread) + 1e-4 * wanted).all()


def test_rims_of_lamps_are_as_good_as_of_many_rays():
    dark = replace(scene(), lights=(LAMP, AreaLight(1e-3, size=(1, 1))), world=World(0.0))
    converged = pictures(dark, 1, samples=2048, integrator="sobol")[0]
    few = render(dark, Settings(samples=4))
    plain = render(dark, Settings(samples=4, integrator="sobol"))

    def error(film):
        return np.square(film.combined[..., :3] - converged).mean()

    assert error(few) < 0.05 * error(plain)


def test_a_lamp_seen_through_a_gap_narrower_than_a_pixel_converges():
    walls = [box((-3, -1, -3), (-0.01, -0.9, 3)), box((0.01, -1, -3), (3, -0.9, 3))]
    lights = (replace(LAMP, position=(0.0, 0.0, 0.0), radius=0.4), AreaLight(1e-3, size=(1, 1)))
    camera = Camera.look_at((0, -5, 0), (0, 0, 0), 32, 32, np.radians(40))
    gap = Scene(camera, walls, [Material(0.1)], lights, World(0.0))
    converged = pictures(gap, 1, samples=4096, integrator="sobol")[0]
    # The gap lies between two columns, and a sixth of either's rays or less meet it.
    few = pictures(gap, 8, samples=1)
    lit = converged[14:18, 15:17]
    error = np.square(few[:, 14:18, 15:17] - lit).mean(axis=0)
    assert (error < np.square(0.1 * lit)).all()


def test_a_pixel_alone_and_a_row_of_pixels_are_unbiased_too():
    for size in ((1, 1), (1, 9), (9, 1)):
        small = scene()
        camera = replace(small.camera, width=size[0], height=size[1], region=None)
        small = replace(small, camera=camera)
        film = render(small, Settings(samples=16))
        assert np.isfinite(film.combined).all() and film.combined.shape[:2] == size[::-1]
