# SPDX-License-Identifier: GPL-3.0-or-later
"""The example scenes that benchmarks make without Blender."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from benchmarks.chapters import fog
from benchmarks.chapters.common import own_error, relative_error
from benchmarks.chapters.direct import PrimarySpace
from benchmarks.scenes import fog_chart
from benchmarks.scenes.core import FOGS, MODELS, example, scene
from engine_core import Laser, Scene, Settings, SpotLight, SunLight, render
from engine_core.integration import integrate
from example_blends.model import Fog, Lamp, Model, Ramp, Surface, Thing, View, diffuse
from example_blends.pumpkin import carved, welded
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


@pytest.fixture
def assets(tmp_path: Path) -> Path:
    """A folder whose dragon is a box."""
    from example_blends.dragon import MESH

    vertices, faces = box((1, 1, 1))
    triangles = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    with gzip.open(tmp_path / MESH, "wt") as file:
        file.write(f"ply\nformat ascii 1.0\nelement vertex {len(vertices)}\nproperty float x\n")
        file.write(f"element face {len(triangles)}\nproperty list uchar int vertex_indices\nend_header\n")
        file.writelines(f"{x} {y} {z}\n" for x, y, z in vertices)
        file.writelines(f"3 {a} {b} {c}\n" for a, b, c in triangles)
    return tmp_path


def test_the_dragon_is_read_from_a_folder(assets: Path) -> None:
    from example_blends.dragon import HEIGHT, model

    made = model(assets)
    dragon = next(thing for thing in made.things if thing.name == "Dragon").shape[0]
    assert dragon[:, 2].min() == pytest.approx(0) and np.ptp(dragon[:, 2]) == pytest.approx(HEIGHT)
    assert np.isfinite(render(scene(made, 16, 16), Settings(samples=2, threads=1)).combined).all()


def test_the_green_beam_passes_behind_the_dragon(assets: Path) -> None:
    from example_blends.green_dragon import model

    made = model(assets)
    view, beam = np.array(made.view.position), made.lamps[0]
    start, end, dragon = (np.array(p) for p in (beam.position, beam.target, (0, 0, 1.5)))
    middle = (start + end) / 2
    assert beam.kind == "LASER" and np.linalg.norm(middle - view) > np.linalg.norm(dragon - view)
    laser = scene(made, 16, 16).lights[0]
    assert isinstance(laser, Laser) and laser.length == np.inf and laser.power[1] == 700
    np.testing.assert_allclose(-laser.light_to_world[:3, 2], (end - start) / np.linalg.norm(end - start))


# Fog


@pytest.mark.parametrize("name", FOGS)
def test_fog_fills_a_box_or_all_space(name: str) -> None:
    made = example(name, 16, 9)
    bounds = [mesh for mesh in made.meshes if mesh.volume >= 0]
    assert len(made.volumes) == 1 and len(bounds) + (made.world.volume >= 0) == 1
    assert 0.02 < made.volumes[0].extinction.min() < 0.5
    eye = made.camera.camera_to_world[:3, 3]
    for mesh in bounds:
        assert not mesh.surface and len(mesh.triangles) == 12
        # All lights shine in it; a sun comes from outside.
        for light in made.lights:
            if not isinstance(light, SunLight):
                place = light.position if hasattr(light, "position") else light.light_to_world[:3, 3]
                assert (place > mesh.vertices.min(axis=0)).all() and (place < mesh.vertices.max(axis=0)).all()
    assert np.isfinite(eye).all()


def test_every_kind_of_lamp_of_a_model() -> None:
    spot = {"spot_size": 0.5, "spot_blend": 0.25, "shadow_soft_size": 0.1, "use_soft_falloff": False}
    lamps = [
        Lamp("Spot", "SPOT", (0, 0, 3), 10, (1, 0.5, 0), (0, 0, 0), properties=spot),
        Lamp("Sun", "SUN", (0, 0, 3), 2, target=(3, 0, 0), properties={"angle": 0.01}),
        Lamp("Laser", "LASER", (0, 0, 3), 5, target=(0, 4, 3), properties={"radius": 0.02, "length": 7.0}),
    ]
    fogs = Fog("Cloud", 0.2, (1, 0.5, 0.25), 0.6, (0.0, 0.1, 0.2)), Fog("Air", 0.01)
    things = [
        Thing("Cloud", box((1, 1, 1)), fogs[0]),
        Thing("Ball", ball(1.0, cells=2), diffuse("Red", (1, 0, 0))),
    ]
    made = scene(Model(View((0, -5, 0), (0, 0, 0)), things, lamps, fog=fogs[1]), 8, 8)
    light, sun, laser = made.lights
    assert isinstance(light, SpotLight) and light.sphere
    assert (light.angle, light.blend, light.radius) == (0.5, 0.25, 0.1)
    np.testing.assert_allclose(light.power, (10, 5, 0))
    np.testing.assert_allclose(sun.direction, np.array([1, 0, -1]) / np.sqrt(2))
    assert (laser.radius, laser.length) == (0.02, 7.0)
    np.testing.assert_allclose(-laser.light_to_world[:3, 2], (0, 1, 0), atol=1e-12)
    cloud, solid = made.meshes
    assert (cloud.volume, cloud.surface, solid.volume, solid.surface) == (0, False, -1, True)
    assert made.world.volume == 1 and made.volumes[1].extinction[0] == pytest.approx(0.01)
    np.testing.assert_allclose(made.volumes[0].scattering, [(0.2, 0.1, 0.05)])
    np.testing.assert_allclose(made.volumes[0].extinction, (0.2, 0.2, 0.25))
    assert made.volumes[0].anisotropy[0] == 0.6


def test_a_stage_has_twelve_coloured_spots() -> None:
    lights = example("stage", 16, 9).lights
    assert len(lights) == 12 and all(isinstance(light, SpotLight) for light in lights)
    assert len({tuple((light.power / light.power.max()).round(3)) for light in lights}) >= 6


def test_a_pumpkin_is_open_in_front_alone() -> None:
    """Every edge of its shell that has one triangle alone is at a hole, and all holes are in its face."""
    triangles, edges = carved()
    vertices, faces = welded(triangles, 1.0)
    sides = np.sort(np.concatenate([faces[:, [i, (i + 1) % 3]] for i in range(3)]), axis=1)
    found, count = np.unique(sides, axis=0, return_counts=True)
    assert set(count) == {1, 2} and (count == 1).sum() == len(edges)
    assert vertices[found[count == 1], 1].max() < 0


def shown_in_fog(name: str) -> tuple[Scene, type]:
    return fog.prepared(example(name, 16, 9)), fog.LasersOnScreen if name == "laser" else fog.FogOnScreen


@pytest.mark.parametrize("name", ["occluder", "laser"])
def test_the_thesis_integrand_is_the_picture_of_fog(name: str) -> None:
    made, space = shown_in_fog(name)
    f = space(made)
    found = integrate(f, f.dimensions, (9, 16), 2048, method="sobol", dtype=np.float32).value
    wanted = render(made, Settings(samples=256, integrator="sobol", threads=1)).combined[..., :3]
    assert found.mean() == pytest.approx(wanted.mean(), rel=0.02)
    assert np.abs(np.moveaxis(found, 0, -1) - wanted).mean() < 0.05 * wanted.mean()


def test_fog_is_shown_alone() -> None:
    made, _ = shown_in_fog("lighthouse")
    assert not any(light.visible_to_camera for light in made.lights)
    assert all(not np.any(material.reflectance) for material in made.materials)
    laser = shown_in_fog("laser")[0].lights[0]
    assert laser.in_fog and not (laser.on_surfaces or laser.beam or laser.spot)


def test_every_light_meets_every_fog_depth_and_anisotropy() -> None:
    cells = fog_chart.cells()
    lights, gs, depths = fog_chart.LIGHTS, fog_chart.ANISOTROPIES, fog_chart.DEPTHS
    assert len({(cell.light, cell.fog) for cell in cells}) == len(lights) * len(fog_chart.FOGS) - 4
    assert len({(cell.light, cell.g) for cell in cells}) == len(lights) * len(gs)
    assert len({(cell.light, cell.depth) for cell in cells}) == len(lights) * len(depths)
    assert len({(cell.fog, cell.g) for cell in cells}) == len(fog_chart.FOGS) * len(gs)
    assert len({(cell.fog, cell.depth) for cell in cells}) == len(fog_chart.FOGS) * len(depths)
    assert len({(cell.g, cell.depth) for cell in cells}) == len(gs) * len(depths)


def test_an_error_is_told_through_the_noise_of_converged_pictures() -> None:
    random = np.random.default_rng(4)
    shape, own, error = (200, 200, 3), 0.05, 0.01
    truth = 1 + random.random(shape)
    one, other = (truth + own * random.standard_normal(shape) for _ in range(2))
    picture = truth + error * random.standard_normal(shape)
    mean = truth.mean()
    # The mean of products of n pairs is off by own^2 / sqrt(n).
    bound = 4 * own**2 / np.sqrt(truth.size)
    assert abs((relative_error(picture, one, other) * mean) ** 2 - error**2) < bound
    assert abs(own_error(one, other) * mean - own / np.sqrt(2)) < 4 * own / np.sqrt(truth.size)
    assert np.isnan(relative_error(truth, truth + own, truth - own))


@pytest.mark.parametrize("name", ["lighthouse", "laser"])
def test_quadrature_along_rays_makes_the_same_picture(name: str) -> None:
    """Whatever else is sampled: places on lights, and beams."""
    scene_ = fog.prepared(example(name, 16, 9))
    method, _ = (fog.LASER_METHODS if name == "laser" else fog.METHODS)["quadrature"]
    wanted = render(scene_, Settings(samples=512, integrator="sobol", threads=1)).combined[..., :3]
    found = [method(scene_, 4 * fog.POINT_OF_QUADRATURE, seed).picture.mean() for seed in range(8)]
    spread = np.std(found, ddof=1) / np.sqrt(len(found))
    assert abs(np.mean(found) - wanted.mean()) < 4 * spread + 0.02 * wanted.mean()
