# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that nobody would make on purpose give a picture all the same."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import area_light, assert_picture_is_sound, floor, mixed_lights, nasty_scene, studio

import engine_core
from engine_core import Camera, Laser, PointLight, Scene, Settings, SunLight, Volume, World, render

SCENES = 100
AT_ONCE = 25


@pytest.mark.parametrize("first", range(0, SCENES, AT_ONCE))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_random_scenes_are_sound(first):
    for seed in range(first, first + AT_ONCE):
        scene, settings = nasty_scene(seed)
        film = render(scene, settings)
        try:
            assert_picture_is_sound(film)
        except AssertionError as error:
            raise AssertionError(f"nasty_scene({seed})") from error


@pytest.mark.parametrize("seed", [436, 645, 1333, 1718])
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_rays_that_graze_lights_come_to_an_end(seed):
    """These once went round in circles at faces that they grazed."""
    assert_picture_is_sound(render(*nasty_scene(seed)))


@pytest.mark.full
@pytest.mark.parametrize("first", range(SCENES, 20 * SCENES, AT_ONCE))
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_more_random_scenes_are_sound(first):
    test_random_scenes_are_sound(first)


def test_camera_inside_a_light_sees_and_is_lit():
    lights = [PointLight(10.0, position=(0, -6, 3), radius=2.0, visible_to_camera=True)]
    film = render(studio(lights=lights), Settings(samples=8))
    assert_picture_is_sound(film)
    assert (film.combined[..., :3] > 0).all()


@pytest.mark.parametrize("power", [1e-30, 1e10, 1e30])
def test_power_scales_the_picture(power):
    base, film = (render(studio(lights=[area_light(p)]), Settings(samples=4)) for p in (1.0, power))
    assert np.allclose(
        film.combined[..., :3].astype(float) / power, base.combined[..., :3], rtol=1e-4, atol=1e-9
    )


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(studio(48, 48, lights=[area_light(1e-36)]), id="next to no light"),
        pytest.param(
            studio(
                48,
                48,
                lights=[area_light(100)],
                world=World(0.0, volume=0),
                volumes=[Volume(absorption=10.0)],
            ),
            id="next to nothing comes through",
        ),
    ],
)
def test_next_to_nothing_is_a_picture_all_the_same(scene):
    film = render(scene, Settings(samples=4, standard_error=True))
    assert_picture_is_sound(film)
    assert film.combined[..., :3].max() > 0


@pytest.mark.parametrize("radius", [1e-30, 1e-15, 1e-6])
def test_ever_smaller_light_becomes_a_point(radius):
    def picture(r: float) -> np.ndarray:
        return render(
            studio(lights=[PointLight(50.0, position=(1, -2, 3), radius=r)]),
            Settings(integrator="sobol", samples=4),
        ).combined

    assert np.allclose(picture(radius), picture(0.0), rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("angle", [1e-30, 1e-20, 1e-10])
def test_ever_smaller_sun_becomes_parallel_light(angle):
    def picture(a: float) -> np.ndarray:
        sun = SunLight(3.0, direction=(0.2, 0.3, -1), angle=a)
        return render(studio(lights=[sun]), Settings(integrator="sobol", samples=4)).combined

    assert np.allclose(picture(angle), picture(0.0), rtol=1e-3, atol=1e-4)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("seen", [True, False])
def test_ordinary_scenes_warn_of_nothing(seen):
    """Black channels, lights without size and empty scenes are no reason for NumPy to print a line."""
    red = (1.0, 0.0, 0.0)
    lights = [dataclasses.replace(light, power=red, visible_to_camera=seen) for light in mixed_lights(6)]
    for some in ([], *([light] for light in lights), lights):
        render(studio(16, 16, some), Settings(samples=2, noise_threshold=0.1, min_samples=1, normals=True))
    render(Scene(Camera.look_at((0, -3, 0), (0, 0, 0), 4, 4)), Settings(samples=2))


def test_background_alone_is_exact():
    camera = Camera.look_at((0, 0, 5), (0, 0, 10), 20, 20, up=(0, 1, 0))
    film = render(Scene(camera, [floor()], world=World((0.1, 1e20, 0))), Settings(samples=3))
    assert np.allclose(film.combined, np.float32([0.1, 1e20, 0, 1]), rtol=1e-6)


@pytest.mark.parametrize("light", [PointLight(10.0, position=(0, 0, 2)), Laser(10.0)])
@pytest.mark.parametrize("volume", [-1, 0])
def test_a_scene_needs_no_mesh_and_no_material(light, volume):
    camera = Camera.look_at((0, -5, 2), (0, 0, 0), 32, 24)
    scene = Scene(camera, (), (), (light,), World(0.0, volume=volume), volumes=(Volume(0.1),))
    for integrator in ("control_variates", "sobol"):
        film = render(scene, Settings(2, integrator=integrator))
        assert_picture_is_sound(film)
        assert (film.combined[..., :3].max() > 0) == (volume == 0)


@pytest.mark.full
def test_4k_stays_within_two_gibibytes():
    code = f"""
import resource, sys
sys.path[:0] = {[str(Path(engine_core.__file__).parents[1]), str(Path(__file__).parent)]!r}
from engine_core import Settings, render
from scenes import mixed_lights, studio
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
film = render(studio(3840, 2160, mixed_lights(5)), Settings(samples=int(sys.argv[1]), normals=True))
assert film.combined.shape == (2160, 3840, 4)
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""
    pytest.importorskip("resource")
    used = []
    for samples in (1, 4):
        result = subprocess.run(
            [sys.executable, "-c", code, str(samples)], capture_output=True, text=True, timeout=600
        )
        assert result.returncode == 0, result.stderr
        used.append(float(result.stdout))
    assert max(used) < 2048
    # And more samples need no more.
    assert used[1] < used[0] * 1.2 + 100
