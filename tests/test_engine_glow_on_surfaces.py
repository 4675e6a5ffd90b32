# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces lit by glowing fog: closed forms, and that looking for what glows takes noise, not light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import PATCH, assert_mean, box, floor, patch_camera, sphere

from engine_core import Camera, Material, Mesh, Scene, Settings, Volume, World, render
from engine_core.bsdf.diffuse import Lambert
from engine_core.geometry.vectors import dot
from engine_core.shading.closures import Add, Diffuse, Glossy, Translucent
from engine_core.transport.direct_light import DirectLight, Pixels
from engine_core.transport.glow_on_surfaces import GlowDirections
from engine_core.transport.media import Media

GLOW, ABSORPTION = np.array([30.0, 15.0, 5.0]), np.array([0.5, 2.0, 0.0])
LOW, HIGH = np.array([-0.2, -0.15, 0.0]), np.array([0.1, 0.2, 0.3])


def over_the_floor(lift: float, surface: Any = None, world: Volume | None = None, **fields: Any) -> Scene:
    """A fire, and in sight `PATCH` alone."""
    fire = box(LOW + (0, 0, lift), HIGH + (0, 0, lift), volume=0, surface=False)
    volumes = [Volume(0.0, ABSORPTION, emission=GLOW), *([world] if world else [])]
    return Scene(
        patch_camera(pixels=1), [floor(), fire], [Material(0.8, surface=surface)],
        world=World(volume=1 if world else -1), volumes=volumes, **fields,
    )  # fmt: skip


def reflected(scene: Scene, u: np.ndarray, by_lobe: bool = False) -> np.ndarray:
    """(3, N) what the floor reflects by u (2, N). by_lobe : directions are the lobe's alone."""
    integrand = DirectLight(scene)
    if by_lobe:
        integrand._glowing._balls = []
    pixel = Pixels(np.zeros(1, int), np.zeros(1, int), np.zeros(1, int))
    hits = integrand.first(pixel, np.full((2, 1, 1), 0.5, np.float32))
    light = integrand.rest(hits, None, u[:, None].astype(np.float32), None)
    values = np.zeros((3, u.shape[1]))
    for row, of in zip(values, light.radiance, strict=True):
        np.add.at(row, light.which, of)
    return values


def grid(count: int) -> np.ndarray:
    return ((np.indices((count, count)) + 0.5) / count).reshape(2, -1)


def emitted(emission: np.ndarray, sigma: np.ndarray, length: np.ndarray) -> np.ndarray:
    """(3, N) light of a stretch of fog."""
    sigma = np.broadcast_to(np.maximum(sigma, 1e-9), 3)[:, None]
    return np.broadcast_to(emission, 3)[:, None] * -np.expm1(-sigma * length) / sigma


@pytest.mark.parametrize("around", [None, Volume(0.0, 0.3, emission=(1.0, 3.0, 2.0))], ids=("air", "fog"))
@pytest.mark.parametrize("lift", [0.01, 0.3, 3.0])
@pytest.mark.parametrize("surface", [None, Diffuse(0.8)], ids=("constant", "shader"))
def test_the_floor_under_a_fire(surface: Any, lift: float, around: Volume | None) -> None:
    """The irradiance is an integral over directions; the ball around the nearest fire holds the point."""
    x, y = grid(1000)
    x, weight, angle = x**3, 3 * x**2, 2 * np.pi * y  # most of them upwards
    direction = np.stack([np.sqrt(x) * np.cos(angle), np.sqrt(x) * np.sin(angle), np.sqrt(1 - x)])
    with np.errstate(divide="ignore"):
        low, high = ((end + (0, 0, lift) - PATCH)[:, None] / direction for end in (LOW, HIGH))
    start = np.maximum(np.minimum(low, high).max(axis=0), 0)
    length = np.maximum(np.maximum(low, high).min(axis=0) - start, 0)
    fog = Volume() if around is None else around
    of_fog, of_fire = np.broadcast_to(fog.extinction, 3), np.broadcast_to(ABSORPTION, 3)
    inside = of_fog + of_fire
    passed = np.exp(-of_fog[:, None] * start)
    light = emitted(fog.emission, of_fog, start)
    light += passed * emitted(GLOW + fog.emission, inside, length)
    endless = np.where(of_fog > 0, fog.emission / np.maximum(of_fog, 1e-9), 0)[:, None]
    light += passed * np.exp(-inside[:, None] * length) * endless
    expected = 0.8 * (weight * light).mean(axis=1) * np.exp(-of_fog / 64)
    found = reflected(over_the_floor(lift, surface, around), grid(512)).mean(axis=1)
    np.testing.assert_allclose(found, expected, rtol=4e-3)


SURFACES = {
    "rough": Glossy(0.8, 0.7, "GGX"),
    "glossy": Glossy(0.8, 0.4, "GGX"),
    "both": Add(Diffuse(0.4), Glossy(0.4, 0.5, "Beckmann")),
}


@pytest.mark.parametrize("surface", SURFACES)
@pytest.mark.parametrize("lift", [0.05, 0.4, 2.0])
def test_any_surface_gets_the_light_that_its_lobes_find(surface: str, lift: float) -> None:
    scene = over_the_floor(lift, SURFACES[surface])
    u = np.random.default_rng(5).random((2, 1 << 19))
    ours, plain = (reflected(scene, u, by_lobe) for by_lobe in (False, True))
    error = np.hypot(*(values.std(axis=1) / u.shape[1] ** 0.5 for values in (ours, plain)))
    difference = np.abs(ours.mean(axis=1) - plain.mean(axis=1))
    assert ours.mean() > 0 and (difference < 4.5 * error).all()


@pytest.mark.parametrize("surface", [None, Glossy(0.8, 0.7, "GGX")], ids=("diffuse", "rough"))
def test_a_small_fire_makes_no_specks(surface: Any) -> None:
    """Samples deviate by 1.8 times their mean, not by 11; the brightest has 4 times that, not 140."""
    u = np.random.default_rng(3).random((2, 1 << 17))
    ours, plain = (
        reflected(over_the_floor(2.0, surface), u, by_lobe).mean(axis=0) for by_lobe in (False, True)
    )
    assert ours.std() < 2.5 * ours.mean() and ours.max() < 10 * ours.mean()
    assert ours.std() < 0.3 * plain.std()


def test_directions_have_the_density_that_they_are_weighed_by() -> None:
    """Moments of the cosine, whatever bodies glow: some hold the point, others are dark or hidden."""
    rng = np.random.default_rng(1)
    for _ in range(8):
        bodies = []
        for _ in range(12):
            centre, half = rng.normal(size=3), 10 ** rng.uniform(-2, 0.3)
            bodies.append(box(centre - half, centre + half, volume=rng.integers(3), surface=False))
        volumes = [Volume(0.1, 0.2, emission=e) for e in (0.0, 1.0, 1e4)]
        scene = Scene(patch_camera(), bodies, [Material()], volumes=volumes)
        media = Media.of(scene, DirectLight(scene).frame)
        count = 1 << 17
        normal = np.repeat(rng.normal(size=(3, 1)), count, axis=1).astype(np.float32)
        normal /= np.sqrt(dot(normal, normal))
        lobe = Lambert(np.ones((3, count), np.float32), normal, normal)
        position = np.repeat(rng.normal(size=(3, 1)), count, axis=1).astype(np.float32)
        u = rng.random((2, count)).astype(np.float32)
        direction, value = GlowDirections(media).sample(lobe, np.arange(count), position, u)
        np.testing.assert_allclose(dot(direction, direction), 1, rtol=1e-5)
        cosine = dot(direction, normal).astype(float)
        samples = np.stack([value[0], value[0] * cosine, value[0] * cosine**6]).astype(float)
        assert_mean(samples.T, (1, 2 / 3, 1 / 4), sigmas=4.5)


def test_where_all_that_glows_is_around_the_lobe_is_sampled() -> None:
    u = np.random.default_rng(2).random((2, 4096))
    room = replace(
        over_the_floor(0.3), meshes=[floor(), box((-4, -4, -1), (4, 4, 3), volume=0, surface=False)]
    )
    np.testing.assert_array_equal(reflected(room, u), reflected(room, u, by_lobe=True))


def test_pictures_lit_by_fires_are_unbiased() -> None:
    """Of many fires, among all kinds of surfaces: the means of blocks are what lobes alone find."""
    surfaces = [Material(0.8), Material(surface=SURFACES["glossy"]), Material(surface=Translucent(0.7))]
    sheet = np.array([(-1.5, 1, 0), (1.5, 1, 0), (1.5, 1, 1.2), (-1.5, 1, 1.2)])
    fires = [
        sphere((x, y, 0.5), 0.15, volume=0, surface=False)
        for x in (-1.6, -0.5, 0.5, 1.6)
        for y in (0.5, 1.5, 2)
    ]
    meshes = [
        floor(),
        sphere((0, 0, 0.5), 0.5, smooth=True, materials=1),
        Mesh(sheet, [(0, 1, 2), (0, 2, 3)], materials=2),
        *fires,
    ]
    camera = Camera.look_at((0, -5, 2), (0, 0, 0.5), 48, 32, 0.7)
    scene = Scene(camera, meshes, surfaces, volumes=[Volume(0.0, ABSORPTION, emission=GLOW)])

    def blocks(samples: int, seeds: range) -> np.ndarray:
        films = [render(scene, Settings(samples, seed=s)).combined[..., :3] for s in seeds]
        return np.array(films).reshape(-1, 4, 8, 4, 12, 3).mean(axis=(2, 4), dtype=float)

    ours = blocks(8, range(10))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("engine_core.transport.glow_on_surfaces.brightest", lambda media: [])
        plain = blocks(64, range(100, 110))
    error = np.hypot(ours.std(axis=0, ddof=1), plain.std(axis=0, ddof=1)) / 10**0.5
    difference = np.abs(ours.mean(axis=0) - plain.mean(axis=0))
    assert (difference < 5 * error + 1e-3 * plain.mean()).all()
