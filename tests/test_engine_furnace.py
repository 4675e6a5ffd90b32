# SPDX-License-Identifier: GPL-3.0-or-later
"""A white convex object in a white world sends back all the light it gets: it can't be seen."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import WHITE, box, place, sphere

from engine_core import Camera, Material, Mesh, Scene, Settings, World, render

OBJECTS = {
    "box": box((-0.7, -0.8, -0.9), (0.8, 0.7, 0.6)),
    "box of loose faces": box((-0.7, -0.8, -0.9), (0.8, 0.7, 0.6), shared=False),
    "flat sphere": sphere(radius=0.9),
    "smooth sphere": sphere(radius=0.9, smooth=True),
    "coarse smooth sphere": sphere(radius=0.9, smooth=True, segments=8),
}


def _camera(projection: str) -> Camera:
    if projection == "orthographic":
        matrix = place((0, 0, 5), (0.6, 0, 0)) @ np.eye(4)
        matrix[:3, 3] = matrix[:3, 2] * 5
        return Camera(matrix, (-1.2, 1.2, -1.2, 1.2), 32, 32, projection="orthographic")
    return Camera.look_at((1.5, -2.5, 1.5), (0, 0, 0), 32, 32, field_of_view=0.8)


def _render(mesh: Mesh, projection: str = "perspective", reflectance=1.0, world=1.0, **settings):
    scene = Scene(_camera(projection), (mesh,), (Material(reflectance),), world=World(world))
    return render(scene, Settings(samples=64, threads=1, **settings))


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("integrator", ["sobol", "monte_carlo"])
def test_white_furnace_hides_a_convex_object(name, projection, integrator):
    film = _render(OBJECTS[name], projection, integrator=integrator)
    assert (film.depth < 1e9).any() and (film.depth > 1e9).any()
    assert np.abs(film.combined - 1).max() < 1e-5


def test_furnace_returns_the_reflectance():
    film = _render(box(), "orthographic", reflectance=(0.25, 0.5, 0.75), world=(4.0, 2.0, 1.0))
    inside = film.combined[12:20, 12:20, :3]
    assert np.abs(inside - (1.0, 1.0, 0.75)).max() < 1e-5


def test_transparent_background_is_the_object_alone():
    film = _render(OBJECTS["flat sphere"], transparent=True, integrator="sobol")
    alpha = film.combined[..., 3]
    assert alpha.min() == 0 and alpha.max() == 1
    assert ((alpha > 0) & (alpha < 1)).any()
    # Premultiplied: a pixel's radiance is its coverage.
    assert np.abs(film.combined[..., :3] - alpha[..., None]).max() < 1e-5


def test_concave_corner_is_darker_than_the_world():
    # The furnace does not pass because nothing is ever in shadow.
    film = _render(box(low=(1, 1, 1), high=(-1, -1, -1)), reflectance=1.0)
    scene = Scene(
        Camera.look_at((0, 0, 0), (1, 0.2, 0.1), 16, 16),
        (box((-1, -1, -1), (1, 1, 1)),),
        (WHITE,),
        world=World(1.0),
    )
    inside = render(scene, Settings(samples=16, threads=1))
    assert (inside.combined[..., :3] == 0).all() and (inside.combined[..., 3] == 1).all()
    assert np.isfinite(film.combined).all()
