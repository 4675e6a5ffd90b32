# SPDX-License-Identifier: GPL-3.0-or-later
"""Openings by which the sky gets into fog: where they are found, and that what goes through them is right."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scenes import box, picture_of_sky, walls_with_window

from engine_core import Camera, Material, PointLight, Scene, Settings, SunLight, Volume, World, render
from engine_core import parts as module
from engine_core.geometry.frame import frame_of
from engine_core.parts import parts_of, pixels_at
from engine_core.shading.closures import Transparent
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.emitters import ImageWorldEmitter, WorldEmitter
from engine_core.transport.emitters.openings import Openings, Rectangles
from engine_core.transport.openings import find_openings, rectangles
from engine_core.transport.single_scattering import SingleScattering

WINDOW = 0.8, 1.6
SIZE = 48, 32
SEEDS = 24


def room(g: float = 0.0, **changes) -> Scene:
    """Walls about fog, and a window in the one to the right that lets in the sky."""
    fog = replace(box((-3.1, -3.1, -0.1), (3.1, 3.1, 3.1)), volume=0, surface=False)
    scene = Scene(
        Camera.look_at((-1.5, -2.5, 1.5), (0.5, 2, 1.2), *SIZE, 1.2, clip_start=0.05),
        [*walls_with_window(WINDOW), fog],
        [Material(0.0)],
        world=World((0.5, 0.7, 1.0)),
        volumes=[Volume(scattering=0.1, anisotropy=g)],
    )
    return replace(scene, **changes)


PANE = box((3.02, 0.7, 0.7), (3.04, 1.7, 1.7), materials=1)
"""In the window, of coloured glass."""

SCENES = {
    "one colour": room(),
    "forwards": room(0.8),
    "picture": room(world=World(image=picture_of_sky())),
    "picture and colour": room(world=World((0.5, 0.7, 1.0), image=picture_of_sky())),
    "sun and lamp": room(
        lights=[
            SunLight(9.0, direction=(-1, -0.1, -0.4), angle=0.12),
            PointLight(3.0, position=(0, 0, 2.6), radius=0.2),
        ]
    ),
    "pane": room(
        meshes=[*room().meshes, PANE],
        materials=[Material(0.0), Material(surface=Transparent((0.9, 0.6, 0.3)))],
    ),
    "lens": room(camera=replace(room().camera, aperture=0.05, focus_distance=3.0)),
    "two media": room(
        meshes=[*room().meshes, replace(box((0, 0, 0), (2, 2, 2)), volume=1, surface=False)],
        volumes=[Volume(scattering=0.1), Volume(scattering=(0.5, 0.3, 0.1), absorption=0.1)],
    ),
}


def found(scene: Scene, seed: int = 0) -> Openings | None:
    integrand = DirectLight(scene)
    scattering = SingleScattering(
        integrand.frame,
        integrand.media,
        integrand.lights,
        integrand.surfaces,
        integrand.shader,
        integrand.stage.rays,
        Settings(),
    )
    return find_openings(scattering, partial(pixels_at, scene.camera.region), scene.camera.region, seed)


def worlds() -> list[WorldEmitter | ImageWorldEmitter]:
    return [WorldEmitter(World((0.5, 0.7, 1.0))), ImageWorldEmitter(World(image=picture_of_sky()))]


BOX = Rectangles(
    np.array([-1, -2, 0], np.float32),
    np.array([1, 2, 1.5], np.float32),
    np.array([0, 0, 4, 5]),
    np.array([[-1.5, 0.2, -0.5, -0.3], [0.3, 0.4, 0.0, -1.9]], np.float32),
    np.array([[-0.5, 1.1, 0.6, 0.3], [1.2, 1.3, 0.4, 1.9]], np.float32),
)
"""Two windows in its left side, one behind, and a strip in its roof."""

POINTS = np.array([
    [0.1, 0.2, 0.3], [-0.999, -1.0, 0.7], [-0.9, 1.9, 0.01], [0.0, 1.97, 0.2], [0.999, -1.999, 1.499],
    [-1.5, -1.0, 0.7], [0.0, 0.0, 1.7], [-1.0, 0.0, 0.5], [0.0, 0.0, 1.5], [1e3, 0, 0],
])  # fmt: skip
"""Within the box, next to its sides, on them, and outside."""


@pytest.mark.parametrize("world", worlds(), ids=["colour", "picture"])
@pytest.mark.parametrize("point", POINTS, ids=str)
def test_densities_are_those_of_what_is_sampled(world, point):
    world.openings = openings = Openings(BOX, np.array([1.0, 0.3, 0.7, 0.0]), 0.8)
    n = 256
    u = (np.stack(np.meshgrid(np.arange(n), np.arange(n))).reshape(2, -1) + 0.5).astype(np.float32) / n
    position = np.repeat(point[:, None], n * n, axis=1)
    direction, measure = world.sample(None, position, None, u[0], u)
    density = world.pdf(None, position, None, direction)
    assert np.isfinite(direction).all() and (density > 0).all()
    np.testing.assert_allclose(1 / measure, density, rtol=2e-3)
    # No direction is much rarer than of a world without openings.
    of_all = world.pdf_in_space(direction)
    assert (density > 0.199 * of_all).all()
    # All of space, and moments of it, where the world itself is seen from everywhere.
    unit = direction / np.linalg.norm(direction, axis=0)
    for f, expected in ((np.ones(n * n), 1), (unit[0], 0), (unit[2], 0), (unit[1] ** 2, 1 / 3)):
        assert (measure * f).mean() / (4 * np.pi) == pytest.approx(expected, abs=0.02)
    # Through each rectangle go as many as its density says.
    if not BOX.hold(position[:, :1])[0]:
        np.testing.assert_allclose(density, of_all, rtol=1e-5)
        return
    which, _ = BOX.through(position.astype(np.float32), direction.astype(np.float32))
    share = np.bincount(which[which >= 0], minlength=len(BOX)) / which.size
    sky = np.random.default_rng(1).normal(size=(3, 1 << 18))
    sky = (sky / np.linalg.norm(sky, axis=0)).astype(np.float32)
    position = np.repeat(point[:, None], sky.shape[1], axis=1).astype(np.float32)
    density = openings.pdf(world, position, sky) * (4 * np.pi)
    assert density.mean() == pytest.approx(1, abs=float(4.5 * density.std() / density.size**0.5 + 1e-3))
    which, _ = BOX.through(position, sky)
    for k in range(len(BOX)):
        part = density * (which == k)
        assert share[k] == pytest.approx(part.mean(), abs=float(4.5 * part.std() / part.size**0.5 + 4e-3))


def test_windows_are_told_apart():
    """Three rows of eight windows, of which directions leave at random places."""
    random = np.random.default_rng(2)
    y, z = (a.ravel() for a in np.meshgrid(np.arange(4) * 0.9, np.arange(3) * 0.8))
    which = random.integers(0, len(y), 4000)
    place = np.stack([y[which], z[which]]) + random.uniform(0, 0.3, (2, 4000))
    low, high = np.array([-1.0, -1, -1]), np.array([5.0, 5, 5])
    made = rectangles(low, high, np.zeros(4000, np.intp), place)
    assert len(made) == 12 and (made.side == 0).all()
    size = made.last - made.first
    assert (size > 0.3).all() and (size < 0.34).all()
    # Each place is in one, and none overlap.
    inside = ((place[:, None] >= made.first[..., None]) & (place[:, None] <= made.last[..., None])).all(
        axis=0
    )
    assert (inside.sum(axis=0) == 1).all()


def test_one_window_is_one_rectangle_and_few_places_are_none():
    random = np.random.default_rng(3)
    low, high = np.zeros(3), np.ones(3)
    place = random.uniform(0.2, 0.7, (2, 3000))
    made = rectangles(low, high, np.full(3000, 5), place)
    assert len(made) == 1
    np.testing.assert_allclose(
        np.concatenate([made.first, made.last]).ravel(), [0.18, 0.18, 0.72, 0.72], atol=5e-3
    )
    assert rectangles(low, high, np.full(40, 5), place[:, :40]) is None
    # All in one place, or on a line.
    same = np.full((2, 500), 0.3)
    for places in (same, np.stack([same[0], random.uniform(0, 1, 500)])):
        made = rectangles(low, high, np.zeros(500, np.intp), places)
        assert ((made.last > made.first) & np.isfinite(made.first)).all()


@pytest.mark.parametrize("seed", range(8))
def test_places_of_one_coordinate_are_not_told_apart(seed):
    random = np.random.default_rng(seed)
    line = np.stack([np.zeros(2000), random.random(2000)])
    place = np.concatenate([line, random.random((2, 40))], axis=1)
    made = rectangles(np.zeros(3), np.ones(3), np.full(2040, 2), place)
    assert (made.last > made.first).all()
    # Where float32 has hardly a digit left for it.
    low = np.ones(3, np.float32)
    for size in (1e-4, 1e-6, 1e-7, 0.0):
        place = (1 + size * random.random((2, 2000))).astype(np.float32)
        made = rectangles(low, low + np.float32(size), np.full(2000, 2), place)
        assert made is None or (made.last > made.first).all()


@pytest.mark.parametrize("name", SCENES)
def test_the_window_of_a_room_is_found(name):
    scene, frame = SCENES[name], frame_of(SCENES[name])
    for seed in range(3):
        made = found(scene, seed)
        assert made is not None
        sides = made._rectangles
        assert (sides.side == 3).all()
        ends = sides.first.min(axis=1), sides.last.max(axis=1)
        first, last = (x / frame.scale + frame.origin[1:] for x in ends)
        np.testing.assert_allclose([first, last], np.repeat([WINDOW], 2, axis=0).T, atol=0.08)


def test_where_there_is_no_room_there_are_no_openings():
    made = room()
    fog = made.meshes[-1]
    floor = box((-50, -50, -0.3), (50, 50, -0.2))
    for meshes in ([fog], [fog, floor], [fog, box((-9, -9, -9), (9, 9, 9))]):
        assert found(replace(made, meshes=meshes)) is None
    # Nor are they looked for without a world, or by other integrators.
    dark = replace(made, world=World(), lights=[PointLight(5.0, position=(0, 0, 2), radius=0.5)])
    for scene, integrator in ((dark, "control_variates"), (made, "sobol")):
        integrand = DirectLight(scene)
        parts_of(scene, integrand, Settings(integrator=integrator), lambda: None)
        assert all(getattr(group, "openings", None) is None for group in integrand.lights.groups)


DEAR = "sun and lamp", "picture and colour", "two media"


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.full) if name in DEAR else name for name in SCENES]
)
def test_mean_over_seeds_is_that_of_plain_samples(name):
    scene = SCENES[name]
    # Of 24 blocks of 8 x 8 pixels.
    count = 2 * SEEDS if "picture" in name else SEEDS
    ours, truth = (
        np.stack([
            render(scene, Settings(seed=seed, threads=1, **settings)).volume.astype(np.float64)
            for seed in range(seeds)
        ]).reshape(seeds, 4, 8, 6, 8, 3).mean(axis=(2, 4)).sum(axis=-1)
        for seeds, settings in ((count, {"samples": 1}), (6, {"samples": 256, "integrator": "sobol"}))
    )  # fmt: skip
    variance = ours.var(axis=0, ddof=1) / count + truth.var(axis=0, ddof=1) / 6
    z = (ours.mean(axis=0) - truth.mean(axis=0)) / np.sqrt(variance)
    # Blocks are wrong by what nets have in common.
    assert np.sqrt(np.square(z).mean()) < 2 and np.abs(z).max() < 5.5
    wholes = [a.mean(axis=(1, 2)) for a in (ours, truth)]
    error = np.sqrt(sum(a.var(ddof=1) / len(a) for a in wholes))
    assert abs(wholes[0].mean() - wholes[1].mean()) < 4 * error


@pytest.mark.parametrize("name", ["one colour", "picture", "forwards"])
def test_openings_gain(monkeypatch, name):
    """By as many points."""
    scene = SCENES[name]
    monkeypatch.setattr("engine_core.net_picture.enough_points", lambda *_: 16)
    truth = render(scene, Settings(512, integrator="sobol", seed=99)).volume

    def error() -> float:
        films = [render(scene, Settings(1, seed=seed, threads=1)).volume for seed in range(6)]
        return float(np.mean([np.square(film - truth).mean() for film in films]))

    with_openings = error()
    monkeypatch.setattr(module, "open_worlds", lambda *_: False)
    assert with_openings < 0.5 * error()


def test_fog_behind_black_surfaces_is_not_seen():
    """Though another surface lets light through."""
    scene = SCENES["pane"]
    integrand = DirectLight(scene)
    (part,) = parts_of(scene, integrand, Settings(), lambda: None)
    x, y = (a.ravel() for a in np.meshgrid(np.arange(48), np.arange(32)))
    rays = part.plain.first(pixels_at(scene.camera.region, x, y), np.full((2, x.size, 1), 0.5, np.float32))
    media, frame = rays.media, integrand.frame
    end = rays.origin[:, media.ray] + rays.direction[:, media.ray] * media.end
    end = end / frame.scale + frame.origin[:, None]
    # But for the pane, all of it is within the walls.
    inside = (np.abs(end[:2]).max(axis=0) < 3.001) & (end[2] > -0.001) & (end[2] < 3.001)
    window = ((end[1:] > WINDOW[0] - 0.01) & (end[1:] < WINDOW[1] + 0.01)).all(axis=0)
    assert (inside | window).all() and not inside.all()


def test_pictures_do_not_depend_on_threads():
    one, two = (render(room(), Settings(2, seed=5, threads=n)) for n in (1, 2))
    np.testing.assert_array_equal(one.combined, two.combined)
