# SPDX-License-Identifier: GPL-3.0-or-later
"""The example scenes that benchmarks make without Blender."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from benchmarks.chapters.direct import PrimarySpace
from benchmarks.scenes.core import MODELS, example, scene
from engine_core import Settings, render
from example_blends.model import Model, Ramp, Surface, Thing, View
from example_blends.shapes import ball, box, corner_normals, revolved


@pytest.mark.parametrize("name", MODELS)
def test_an_example_renders_without_blender(name: str) -> None:
    film = render(example(name, 16, 16), Settings(samples=2, threads=1))
    assert not film.messages
    assert np.isfinite(film.combined).all()
    assert film.combined[..., :3].mean() > 0.01


@pytest.mark.parametrize("name", ["veach_plates", "violin"])
def test_the_thesis_integrand_is_the_picture(name: str) -> None:
    """One light chosen a sample, in four dimensions: the mean is that of the renderer."""
    space = PrimarySpace(example(name, 16, 9))
    u = np.random.default_rng(2).random((space.dimensions, 200_000))
    values = space(u).mean(axis=0)
    wanted = render(space.scene, Settings(samples=64, integrator="sobol", threads=1)).combined[..., :3].mean()
    assert abs(values.mean() - wanted) < 4 * values.std() / np.sqrt(values.size) + 0.02 * wanted


def test_the_lamps_of_veachs_plates_have_equal_power_and_unlike_size() -> None:
    lights = example("veach_plates", 16, 16).lights
    assert len(lights) == 3 and all(light.sphere and light.visible_to_camera for light in lights)
    assert len({float(light.radius) for light in lights}) == 3
    assert np.ptp([light.power.max() for light in lights]) == 0


def test_slats_have_sixty_lights_of_many_radii() -> None:
    radii = {float(light.radius) for light in example("slats", 16, 16).lights}
    assert len(radii) == 60 and max(radii) > 100 * min(radii)


@pytest.mark.parametrize("shape", [ball(2.0, cells=6), revolved([(2, -0.5), (2, 0.5)], 96)])
def test_smooth_normals_point_from_the_middle_outwards(shape: tuple[np.ndarray, np.ndarray]) -> None:
    vertices, faces = shape
    out = vertices * (1, 1, 0) if len(vertices) == 192 else vertices
    out = out / np.linalg.norm(out, axis=1, keepdims=True)
    assert (corner_normals(vertices, faces) * out[faces]).sum(axis=-1).min() > 0.998


def test_a_ramp_runs_over_the_uv_map() -> None:
    """A glowing square whose left is red and whose right is blue, seen from above."""
    corners = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], float)
    uv = np.array([[(0, 0), (1, 0), (1, 1), (0, 1)]], float)
    ramp = Ramp(((0.0, (1, 0, 0)), (1.0, (0, 0, 1))))
    glow = Surface("Glow", "Emission", {"color": ramp, "strength": 2.0})
    thing = Thing("Square", (corners, np.array([(0, 1, 2, 3)])), glow, uv=uv)
    view = View((0, -0.001, 2), (0, 0, 0), lens=18)
    picture = render(scene(Model(view, [thing]), 16, 16), Settings(samples=16, threads=1)).combined
    place = (np.arange(16) + 0.5) / 16
    # At distance 2 a field of view of 90 degrees spans 4: the square is the middle half.
    inside = slice(5, 11)
    expected = (place * 4 - 2 + 1) / 2
    np.testing.assert_allclose(picture[8, inside, 2], 2 * expected[inside], atol=0.05)
    np.testing.assert_allclose(picture[8, inside, 0], 2 * (1 - expected[inside]), atol=0.05)


def test_the_dragon_is_read_from_a_folder(tmp_path: Path) -> None:
    from example_blends.dragon import HEIGHT, MESH, model

    vertices, faces = box((1, 1, 1))
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    with gzip.open(tmp_path / MESH, "wt") as file:
        file.write(f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\n")
        file.write(f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n")
        file.writelines(f"{x} {y} {z}\n" for x, y, z in vertices)
        file.writelines(f"3 {a} {b} {c}\n" for a, b, c in triangles)
    made = model(tmp_path)
    dragon = next(thing for thing in made.things if thing.name == "Dragon").shape[0]
    assert dragon[:, 2].min() == pytest.approx(0) and np.ptp(dragon[:, 2]) == pytest.approx(HEIGHT)
    assert np.isfinite(render(scene(made, 16, 16), Settings(samples=2, threads=1)).combined).all()
