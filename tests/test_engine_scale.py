# SPDX-License-Identifier: GPL-3.0-or-later
"""The same picture at any size and place: no absolute epsilon, no acne, no leaks."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from scenes import WHITE, box, floor, place, sphere

from engine_core import (
    AreaLight,
    Camera,
    Laser,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    Volume,
    World,
    render,
)

SETTINGS = Settings(samples=16, threads=1)
FEW = Settings(samples=2, threads=1)
GRID = 2.0**-6  # float32 holds multiples of it exactly up to 2^18


def _exact_studio() -> Scene:
    """A scene with an occluder, and every vertex a multiple of `GRID`; lights of all kinds."""
    lights = [
        PointLight(60.0, position=(2.0, -1.0, 3.0)),
        PointLight(90.0, position=(-2.0, -1.0, 2.5), radius=0.5),
        PointLight(90.0, position=(-1.0, 2.0, 3.5), radius=0.75, sphere=False),
        SpotLight(150.0, light_to_world=place((0.5, -2.0, 3.0), (0.6, 0, 0)), radius=0.125, angle=0.9),
        AreaLight(80.0, light_to_world=place((1.5, 1.5, 3.0), (-0.4, 0.4, 0)), size=(1.0, 0.5)),
        SunLight(0.8, direction=(0.3, 0.4, -1.0), angle=0.1),
    ]
    glowing = Mesh([[1, -2, 0.5], [1.5, -2, 0.5], [1, -2, 1]], [[0, 1, 2]], materials=1, name="Glow")
    meshes = (
        floor(4.0),
        sphere((-0.75, 0, 0.75), 0.75, smooth=True, grid=GRID),
        box((0.5, -0.5, 0), (1.5, 0.5, 1.25)),
        glowing,
    )
    camera = Camera.look_at((0.5, -5.0, 2.5), (0, 0, 0.5), 48, 32)
    return Scene(camera, meshes, (Material(0.7), Material(0.5, 4.0)), lights, World(0.05))


def _placed(value: Light, scale: float, move: np.ndarray) -> Light:
    if isinstance(value, SunLight):
        return value
    if hasattr(value, "light_to_world"):
        matrix = value.light_to_world.copy()
        # A spot's radius is in scene units; an area light's size is in its matrix.
        matrix[:3, :3] *= scale if isinstance(value, AreaLight) else 1.0
        matrix[:3, 3] = matrix[:3, 3] * scale + move
        changes: dict[str, Any] = {"light_to_world": matrix}
    else:
        changes = {"position": value.position * scale + move}
    for length in ("radius", "length"):
        if hasattr(value, length):
            changes[length] = getattr(value, length) * scale
    return dataclasses.replace(value, power=value.power * scale**2, **changes)


def placed(scene: Scene, scale: float = 1.0, move: Any = (0, 0, 0)) -> Scene:
    """The scene scaled about its origin, then moved; with the radiance that it had."""
    move = np.asarray(move, float)
    matrix = scene.camera.camera_to_world.copy()
    matrix[:3, 3] = matrix[:3, 3] * scale + move
    clip = (scene.camera.clip_start * scale, scene.camera.clip_end * scale)
    camera = dataclasses.replace(scene.camera, camera_to_world=matrix, clip_start=clip[0], clip_end=clip[1])
    if camera.projection == "orthographic":
        camera = dataclasses.replace(camera, viewplane=camera.viewplane * scale)
    meshes = [
        dataclasses.replace(mesh, vertices=mesh.vertices.astype(float) * scale + move)
        for mesh in scene.meshes
    ]
    lights = [_placed(light, scale, move) for light in scene.lights]
    volumes = [
        Volume(v.scattering / scale, v.absorption / scale, v.anisotropy, v.emission / scale)
        for v in scene.volumes
    ]
    return dataclasses.replace(scene, camera=camera, meshes=meshes, lights=lights, volumes=volumes)


def _assert_same_picture(a: Scene, b: Scene) -> None:
    first, second = (render(scene, SETTINGS).combined for scene in (a, b))
    assert first[..., :3].std() > 0.01
    assert np.abs(first - second).max() < 1e-4 * first.max()


@pytest.mark.parametrize("scale", [2.0**-13, 2.0**13])
def test_scaled_scene_gives_the_same_picture(scale):
    _assert_same_picture(_exact_studio(), placed(_exact_studio(), scale))


@pytest.mark.parametrize("scale", [1e-4, 3e5])
def test_scale_that_is_no_power_of_two_gives_the_same_picture_up_to_edges(scale):
    first, second = (render(placed(_exact_studio(), s), SETTINGS).combined for s in (1.0, scale))
    difference = np.abs(first - second).max(axis=2)
    # Rounding moves single samples across edges; nothing else may change.
    assert np.median(difference) < 1e-4 * first.max()
    assert abs(first.mean() / second.mean() - 1) < 1e-3


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_moved_scene_gives_the_same_picture(axis):
    move = np.zeros(3)
    move[axis] = 2.0**17
    _assert_same_picture(_exact_studio(), placed(_exact_studio(), 1.0, move))


def test_small_scene_far_away_gives_the_same_picture():
    _assert_same_picture(
        placed(_exact_studio(), 2.0**-13), placed(_exact_studio(), 2.0**-13, (2.0**4, -(2.0**4), 0))
    )


@cache
def _exact_fog() -> tuple[Scene, np.ndarray]:
    """Fogs that overlap, the camera in one of them, lit by a point, a ball, a rectangle and a laser; and its
    picture.
    """
    clear = _exact_studio()
    laser = Laser(20.0, light_to_world=place((-2.0, -1.0, 2.0), (0.0, -1.0, 0.25)), radius=2.0**-5)
    fogs = [
        box((-4, -6, -0.5), (4, 4, 4.5), volume=0, surface=False),
        box((-1.5, -1.5, 0.25), (2.25, 1.5, 1.75), volume=1, surface=False),
    ]
    scene = dataclasses.replace(
        clear,
        camera=Camera.look_at((0.5, -5.0, 2.5), (0, 0, 0.5), 24, 16, clip_start=0.125, clip_end=64.0),
        meshes=(*clear.meshes[:-1], *fogs),
        lights=(*clear.lights[:2], clear.lights[4], laser),
        volumes=(Volume((0.1, 0.12, 0.15), 0.02, 0.5), Volume(0.4, (0, 0.1, 0.2), -0.3, 0.01)),
    )
    return scene, render(scene, FEW).combined


@pytest.mark.parametrize(
    ("scale", "move"), [(2.0**-13, 0), (2.0**13, 0), (1.0, (2.0**17, 0, 0)), (1.0, (0, -(2.0**17), 2.0**17))]
)
def test_fog_and_lasers_anywhere_give_the_same_picture(scale, move):
    scene, picture = _exact_fog()
    found = render(placed(scene, scale, move), FEW).combined
    assert picture[..., :3].std() > 0.01
    assert np.abs(found - picture).max() < 1e-4 * picture.max()


# -- acne ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("tilt", [(0, 0, 0), (0.3, 0.2, 0.1)])
@pytest.mark.parametrize("half", [100.0, 1e3, 1e5])
def test_huge_floor_has_no_acne(half, tilt):
    turn = place(rotation=tilt)
    mesh = floor(half)
    mesh = dataclasses.replace(mesh, vertices=mesh.vertices @ turn[:3, :3].T)
    eye, light = turn[:3, :3] @ (0, -4, 2), turn[:3, :3] @ (1, 1, 2)
    camera = Camera.look_at(eye, turn[:3, :3] @ (0, -1, 0), 32, 32)
    scene = Scene(
        camera, (mesh, sphere(turn[:3, :3] @ (30, 0, 1))), (WHITE,), [PointLight(100.0, position=light)]
    )
    film = render(scene, SETTINGS)
    # What each pixel's middle should be by the inverse square law.
    offset = (np.arange(32) + 0.5) / 32
    left, right, bottom, top = camera.viewplane
    x, y = np.meshgrid(left + (right - left) * offset, bottom + (top - bottom) * offset)
    axes = camera.camera_to_world[:3, :3]
    ray = (np.stack([x, y, -np.ones_like(x)], -1)) @ axes.T
    up = turn[:3, 2]
    point = eye + ray * (-(eye @ up) / (ray @ up))[..., None]
    towards = light - point
    square = (towards**2).sum(-1)
    truth = 100 / (4 * np.pi) / np.pi * (towards @ up) / square**1.5
    assert np.abs(film.combined[..., 0] / truth - 1).max() < 0.03


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("distance", [2.0, 50.0])
def test_lit_side_of_a_flat_sphere_has_no_acne(scale, distance):
    mesh = sphere(radius=scale, segments=128)
    camera = Camera.look_at((0, -distance * scale, 0), (0, 0, 0), 48, 48, field_of_view=1.2 / distance)
    # Parallel light along the view: all that is seen is lit, but for cosines.
    film = render(Scene(camera, (mesh,), (WHITE,), [SunLight(np.pi, direction=(0, 1, 0))]), SETTINGS)
    assert film.combined[..., 0].min() > 0.2


@pytest.mark.parametrize("segments", [8, 16, 64])
def test_smooth_sphere_has_no_terminator(segments):
    """Light from the side on a sphere of few, smooth faces: brightness falls evenly to 0, without steps."""
    mesh = sphere(segments=segments, smooth=True)
    camera = Camera(place((0, -5, 0), (np.pi / 2, 0, 0)), (-1, 1, -1, 1), 64, 64, projection="orthographic")
    light = SunLight(np.pi, direction=(-1, 0.6, 0))
    towards = -light.direction
    shadowed, open_ = (
        render(Scene(camera, (dataclasses.replace(mesh, casts_shadow=casts),), (WHITE,), [light]), SETTINGS)
        for casts in (True, False)
    )
    normal = render(
        Scene(camera, (mesh,), (WHITE,), [light]), dataclasses.replace(SETTINGS, normals=True)
    ).normal
    cosine = normal @ towards
    # Without shadows the shading normal alone decides; shadows may only darken what is turned away.
    lit = (shadowed.combined[..., 3] == 1) & (cosine > 0.25)
    assert lit.sum() > 300
    lost = 1 - shadowed.combined[lit, 0] / open_.combined[lit, 0]
    assert lost.max() < 0.02


# -- leaks ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shared", [True, False])
@pytest.mark.parametrize("rotation", [(0, 0, 0), (0.4, 0.7, 1.1)])
@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
def test_closed_room_lets_no_light_in(shared, rotation, scale):
    turn = place(rotation=rotation, scale=scale)
    room = box((-1, -2, -1), (1.5, 2, 1.25), shared=shared)
    room = dataclasses.replace(room, vertices=room.vertices @ turn[:3, :3].T)
    outside = [turn[:3, :3] @ p for p in ((3, 0, 0), (0, -2.05, 0), (1.51, 2.01, 1.26), (0, 0, 5))]
    lights: list[Light] = [PointLight(1e6 * scale**2, position=p) for p in outside]
    lights += [PointLight(1e6 * scale**2, position=outside[0], radius=1.4 * scale)]
    lights += [SunLight(1e6, direction=turn[:3, :3] @ d) for d in ((1, 1, -1), (0, 0, -1), (1, 0, 0))]
    for target in ((1.5, 2, 1.25), (-1, -2, -1), (1.5, 0, -1)):
        camera = Camera.look_at(
            turn[:3, :3] @ (0.1, 0.2, 0.1), turn[:3, :3] @ target, 32, 32, field_of_view=1.5
        )
        film = render(
            Scene(camera, (room,), (WHITE,), lights, World(1e6)), dataclasses.replace(SETTINGS, samples=32)
        )
        assert (film.combined[..., :3] == 0).all()
        assert (film.combined[..., 3] == 1).all()


@pytest.mark.parametrize("half", [10.0, 1e3, 1e5])
def test_shadow_touches_the_object_that_casts_it(half):
    """A thin slab that lies on a floor keeps all light off the floor's part beneath it."""
    slab_height = 0.02
    slab = box((-0.5, -0.5, 0), (0.5, 0.5, slab_height), visible_to_camera=False)
    camera = Camera(place((0, 0, 5)), (-0.4, 0.4, -0.4, 0.4), 16, 16, projection="orthographic")
    scene = Scene(camera, (floor(half), slab), (WHITE,), [SunLight(1.0, direction=(0, 0.01, -1))], World(1.0))
    film = render(scene, SETTINGS)
    assert (film.depth > 4.99).all()
    assert (film.combined[..., :3] == 0).all()
