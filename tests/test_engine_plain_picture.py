# SPDX-License-Identifier: GPL-3.0-or-later
"""What the first plain samples of a picture tell."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scenes import sphere, studio

from engine_core import Material, Settings, Volume, World, render
from engine_core.plain_picture import PlainPicture, mean_deviations
from engine_core.shading.closures import Emission


@pytest.mark.parametrize("step", ((0, 1), (1, 1)))
def test_the_deviation_is_that_of_pixels_and_not_of_what_is_linear(step: tuple[int, int]):
    random = np.random.default_rng(3)
    y, x = np.mgrid[:90, :170]
    black = (x + y) % 2 != 0
    noise = random.normal(scale=0.2, size=y.shape)
    # Of three hundred samples and more in each of 66 blocks.
    noisy = (5 + 0.3 * x - 0.1 * y + noise)[..., None] * [1, 1, 1]
    assert mean_deviations(noisy, step, np.ones_like(black)) == pytest.approx([0.2], rel=0.03)
    assert mean_deviations((0.3 * x)[..., None] * [1, 2, 3], step, ~black, black) < [1e-12, 1e-12]
    assert mean_deviations(np.ones((40, 2, 3)), step, black[:40, :2]) == [None]


def test_of_a_chessboard_each_half_is_told_by_itself():
    y, x = np.mgrid[:90, :170]
    black = (x + y) % 2 != 0
    radiance = (np.random.default_rng(4).random(black.shape) * black)[..., None] * [1, 1, 1]
    of_white, of_black = mean_deviations(radiance, (1, 1), ~black, black)
    assert of_white == 0
    assert of_black == pytest.approx(12**-0.5, rel=0.03)
    assert mean_deviations(radiance, (1, 1), np.zeros_like(black)) == [None]
    # A step between sides is no noise.
    side = x > 80
    stepped = (side * 5.0)[..., None] * [1, 1, 1]
    for step in ((0, 1), (1, 1)):
        assert mean_deviations(stepped, step, ~black, black, sides=side) == [0, 0]
        assert min(mean_deviations(stepped, step, ~black, black)) > 0.05


def test_fog_has_fewer_points_where_plain_samples_of_surfaces_hide_its_noise():
    made = studio()
    lamp = sphere((2, -2, 4), 0.5, materials=2)
    made = replace(
        made,
        meshes=[*made.meshes, lamp],
        materials=[*made.materials, Material(surface=Emission(20.0))],
        world=World(volume=0),
        volumes=[Volume(scattering=0.01)],
    )
    black = replace(made, materials=[Material(0.0), Material(0.0), made.materials[2]])
    told = [render(one, Settings(1)).statistics for one in (made, black)]
    assert "many triangles" in told[0]["control variate"]
    points = [int(one["fog lit by glowing meshes"].split()[1]) for one in told]
    assert points[0] < points[1] == 16


@pytest.mark.parametrize("width", [3, 33, 34, 97])
def test_what_hides_is_the_same_in_tiles_that_the_edge_cuts(width: int):
    radiance = np.random.default_rng(6).normal(1, 0.1, (64, width, 3)).astype(np.float32)
    picture = SimpleNamespace(_reflected=lambda: radiance, samples=1)
    found = PlainPicture.hiding(picture, 32)
    assert found.shape == (2, -(-width // 32))
    # Channels are summed, and deviate by themselves.
    np.testing.assert_allclose(found, found[0, 0], rtol=0.6)
    assert PlainPicture.hiding(SimpleNamespace(_reflected=lambda: radiance[:, :2], samples=1), 32) is None
