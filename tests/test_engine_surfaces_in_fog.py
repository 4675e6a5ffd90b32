# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces in fog: what of their light is left, before them and behind, and what glowing fog adds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import box, floor, studio

from engine_core import (
    Camera,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SunLight,
    Volume,
    World,
    render,
)
from engine_core.shading.closures import Diffuse, Glossy, Holdout, Mix, Transparent
from engine_core.transport.direct_light import ALPHA, RGB, DirectLight, Pixels
from engine_core.transport.light_choice import EveryLight


def looked_at(scene: Scene, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """What is seen straight ahead (channels,), and what surfaces there reflect (3,) besides."""
    integrand = DirectLight(scene, **settings)
    pixel = Pixels(np.zeros(1, int), np.zeros(1, int), np.zeros(1, int))
    hits = integrand.first(pixel, np.full((2, 1, 1), 0.5, np.float32))
    seen = hits.values[:, 0].astype(float)
    reflected = np.zeros(3)
    if len(hits.points):
        u = np.full((integrand.rest_dimensions, 1, 1), 0.5, np.float32)
        reflected = integrand.rest(hits, None, u, EveryLight()).radiance.sum(axis=1, dtype=float)
    return seen, reflected


def looking_down(*meshes: Mesh, **fields: Any) -> Scene:
    """A camera 5 above the origin that sees what is 0.5 below it or further."""
    camera = Camera.look_at((0, 0, 5), (0, 0, 0), 1, 1, up=(0, 1, 0), clip_start=0.5)
    return Scene(camera, meshes, **fields)


SIGMA = np.array([0.2, 0.5, 0.9])
FOG = (Volume(SIGMA / 4, SIGMA * 3 / 4), Volume(0.1), Volume(SIGMA, emission=(1, 2, 3)))
LAYER = box((-3, -3, 0), (3, 3, 1), volume=0, surface=False)  # it lies on the floor
LAMP = PointLight(100.0, position=(1, 0, 2))
IRRADIANCE = 100 / (4 * np.pi) / 5 * (2 / np.sqrt(5)) / np.pi


@pytest.mark.parametrize("closure", (None, Diffuse(0.8)), ids=("constant", "shader"))
def test_a_surface_in_fog_is_lit_and_seen_through_it(closure: Any) -> None:
    material = Material(0.8, surface=closure)
    scene = looking_down(floor(), LAYER, materials=(material,), lights=(LAMP,), volumes=FOG)
    seen, reflected = looked_at(scene)
    # A unit on the way up, and the lower half of the way to the lamp.
    expected = 0.8 * IRRADIANCE * np.exp(-SIGMA * (1 + np.sqrt(5) / 2))
    np.testing.assert_allclose(reflected, expected, rtol=1e-5)
    np.testing.assert_array_equal(seen, [0, 0, 0, 1])
    everywhere = replace(scene, world=World(volume=1))
    expected *= np.exp(-0.1 * (4.5 + np.sqrt(5)))
    np.testing.assert_allclose(looked_at(everywhere)[1], expected, rtol=1e-5)


def test_no_sun_shines_through_the_worlds_medium() -> None:
    scene = looking_down(floor(), LAYER, lights=(SunLight(2.0),), volumes=FOG)
    np.testing.assert_allclose(looked_at(scene)[1], 0.8 * 2 / np.pi * np.exp(-SIGMA * 2), rtol=1e-5)
    assert not looked_at(replace(scene, world=World(1.0, volume=1)))[1].any()


def test_a_light_that_casts_no_shadow_shines_through_fog_as_well() -> None:
    """As in Cycles."""
    scene = looking_down(floor(), LAYER, lights=(replace(LAMP, casts_shadow=False),), volumes=FOG)
    np.testing.assert_allclose(looked_at(scene)[1], 0.8 * IRRADIANCE * np.exp(-SIGMA), rtol=1e-5)


@pytest.mark.parametrize("closure", (None, Diffuse(0.8)), ids=("constant", "shader"))
def test_background_and_alpha_behind_fog(closure: Any) -> None:
    material = Material(0.8, surface=closure)
    behind = floor(1, 9)  # the camera, or there would be no surface to have the material
    scene = looking_down(LAYER, behind, materials=(material,), world=World((1, 2, 3)), volumes=FOG)
    passed = np.exp(-SIGMA)
    np.testing.assert_allclose(looked_at(scene)[0], [*passed * (1, 2, 3), 1], rtol=1e-6)
    np.testing.assert_allclose(looked_at(scene, transparent=True)[0], [0, 0, 0, 1 - passed.mean()], rtol=1e-5)
    glowing = replace(scene, meshes=(replace(LAYER, volume=2), behind))
    glow = np.array([1, 2, 3]) * (1 - passed) / SIGMA
    np.testing.assert_allclose(looked_at(glowing)[0], [*passed * (1, 2, 3) + glow, 1], rtol=1e-6)
    seen = looked_at(glowing, transparent=True)[0]
    np.testing.assert_allclose(seen, [*glow, 1 - passed.mean()], rtol=1e-5)
    # Whatever lies behind is black in fog without end.
    np.testing.assert_array_equal(looked_at(replace(scene, world=World(1.0, volume=1)))[0], [0, 0, 0, 1])


def test_a_holdout_in_fog_leaves_the_fogs_alpha() -> None:
    passed = np.exp(-SIGMA)
    held = looking_down(floor(holdout=True), LAYER, volumes=FOG)
    by_shader = looking_down(floor(), LAYER, volumes=FOG, materials=(Material(surface=Holdout()),))
    for scene in (held, by_shader):
        np.testing.assert_allclose(looked_at(scene)[0], [0, 0, 0, 1 - passed.mean()], atol=1e-6)


def test_layers_of_alpha_in_fog() -> None:
    clear, tint = 0.75, np.array([0.9, 0.5, 0.3])
    veil = Material(surface=Mix(1 - clear, Transparent(tint), Diffuse(0.6)))
    sheets = [floor(0.2, z, materials=1) for z in (3.0, 2.0)]
    scene = looking_down(
        floor(), *sheets, box((-3, -3, -1), (3, 3, 2.5), volume=0, surface=False),
        materials=(Material(0.8), veil), lights=(PointLight(100.0, position=(1, 0, 4)),), volumes=FOG,
    )  # fmt: skip
    through = clear * tint
    _, reflected = looked_at(scene)

    def lit(z: float, albedo: float, inside: float) -> np.ndarray:
        square = 1 + (4 - z) ** 2
        share = inside / (4 - z)
        return (
            albedo * 100 / (4 * np.pi**2) * (4 - z) / square**1.5 * np.exp(-SIGMA * share * np.sqrt(square))
        )

    # The way from the floor to the lamp passes beside the sheets.
    layers = lit(3, 0.15, 0) + through * np.exp(-0.5 * SIGMA) * lit(2, 0.15, 0.5)
    layers = layers + through**2 * np.exp(-2.5 * SIGMA) * lit(0, 0.8, 2.5)
    np.testing.assert_allclose(reflected, layers, rtol=1e-4)
    scene = replace(scene, volumes=(Volume(SIGMA, emission=(1, 2, 3)),))
    seen, _ = looked_at(scene)
    glow = np.array([1, 2, 3]) / SIGMA
    glow = through * glow * (1 - np.exp(-0.5 * SIGMA)) + through**2 * glow * (
        np.exp(-0.5 * SIGMA) - np.exp(-2.5 * SIGMA)
    )
    np.testing.assert_allclose(seen, [*glow, 1], rtol=1e-5)
    # Without the floor: what is absorbed, and what of the sheets is opaque.
    open_air = replace(scene, meshes=scene.meshes[1:])
    alpha = 1 - (through**2 * np.exp(-3.5 * SIGMA)).mean()
    assert looked_at(open_air, transparent=True)[0][ALPHA] == pytest.approx(alpha, rel=1e-5)


@pytest.mark.parametrize("closure", (None, Diffuse(0.8)), ids=("constant", "shader"))
def test_a_lamp_is_seen_through_the_fog_before_it(closure: Any) -> None:
    lamp = PointLight(100.0, position=(0, 0, 2), radius=0.5, visible_to_camera=True)
    scene = looking_down(
        floor(), box((-3, -3, -1), (3, 3, 3), volume=0, surface=False),
        materials=(Material(0.8, surface=closure),), lights=(lamp,), volumes=FOG,
    )  # fmt: skip
    clear = looked_at(replace(scene, meshes=(floor(),)))[0][RGB]
    assert clear.min() > 0
    np.testing.assert_allclose(looked_at(scene)[0][RGB], clear * np.exp(-0.5 * SIGMA), rtol=1e-4)


def glow_on_floor(scene: Scene, count: int = 192) -> np.ndarray:
    """(3,) what the floor reflects straight up, the mean over a grid of directions."""
    integrand = DirectLight(scene)
    pixel = Pixels(np.zeros(1, int), np.zeros(1, int), np.zeros(1, int))
    hits = integrand.first(pixel, np.full((2, 1, 1), 0.5, np.float32))
    u = ((np.indices((count, count)) + 0.5) / count).reshape(2, 1, -1).astype(np.float32)
    return integrand.rest(hits, None, u, None).radiance.sum(axis=1, dtype=float) / count**2


@pytest.mark.parametrize(
    "closure", (None, Diffuse(0.8), Glossy(0.8, 1.0, "GGX")), ids=("constant", "shader", "rough")
)
def test_glowing_fog_lights_surfaces(closure: Any) -> None:
    layer = box((-3e3, -3e3, 1), (3e3, 3e3, 2), volume=2, surface=False)
    scene = looking_down(floor(), layer, materials=(Material(0.8, surface=closure),), volumes=FOG)
    cosine = (np.arange(2000) + 0.5) / 2000
    glow = np.array([[1], [2], [3]]) / SIGMA[:, None] * -np.expm1(-SIGMA[:, None] / cosine)
    found = glow_on_floor(scene)
    passed = np.exp(-SIGMA)  # on the way up again
    if isinstance(closure, Glossy):
        assert found.min() > 0
        found = found / glow_on_floor(replace(scene, volumes=(*FOG[:2], Volume(SIGMA, emission=1.0))))
        np.testing.assert_allclose(found, (1, 2, 3), rtol=1e-4)
    else:
        np.testing.assert_allclose(found, 0.8 * passed * 2 * (glow * cosine).mean(axis=1), rtol=3e-3)


def test_glow_passes_through_layers_and_stops_at_what_is_opaque() -> None:
    layer = box((-3e3, -3e3, 1), (3e3, 3e3, 2), volume=0, surface=False)
    tint = np.array([0.9, 0.5, 0.3])
    veil = Material(surface=Transparent(tint))

    def lit(*sheets: Mesh) -> np.ndarray:
        return glow_on_floor(
            looking_down(
                floor(), layer, *sheets, materials=(Material(0.8), veil, Material(0.5)),
                volumes=(Volume(0, emission=(1, 2, 3)),),
            )
        )  # fmt: skip

    def sheet(z: float, material: int) -> Mesh:
        return floor(3e3, z, materials=material, visible_to_camera=False)

    clear = lit()
    # Radiance grows with the way through: halves of the layer add up to it.
    np.testing.assert_allclose(lit(sheet(0.5, 1)), tint * clear, rtol=4e-3)
    np.testing.assert_allclose(lit(sheet(1.5, 1)), (1 + tint) / 2 * clear, rtol=4e-3)
    np.testing.assert_allclose(
        lit(sheet(1.25, 1), sheet(1.5, 1)), (1 + tint + 2 * tint**2) / 4 * clear, rtol=4e-3
    )
    np.testing.assert_allclose(lit(sheet(1.25, 1), sheet(1.5, 2)), (1 + tint) / 4 * clear, rtol=4e-3)
    assert not lit(sheet(0.5, 2)).any()


def test_an_orthographic_camera_sees_fog_from_its_near_plane_on() -> None:
    matrix = np.eye(4)
    matrix[:3, 3] = (0, 0, 5)
    camera = Camera(matrix, (-1, 1, -1, 1), 1, 1, projection="orthographic", clip_start=0.5)
    scene = replace(
        looking_down(floor(), LAYER, lights=(LAMP,), volumes=FOG), camera=camera, world=World(volume=1)
    )
    expected = np.exp(-SIGMA * (1 + np.sqrt(5) / 2) - 0.1 * (4.5 + np.sqrt(5)))
    np.testing.assert_allclose(looked_at(scene)[1], 0.8 * IRRADIANCE * expected, rtol=1e-5)


def test_a_picture_lit_by_fog_alone() -> None:
    """By control variates and by samples alone: nothing but what glows lights this scene."""
    layer = box((-4, -4, 1), (4, 4, 2), volume=0, surface=False)
    scene = replace(studio(24, 16), volumes=(Volume((0, 0, 0), 0.2, emission=(1, 0.5, 0.1)),))
    scene = replace(scene, meshes=(*scene.meshes, layer))
    means = [
        render(scene, Settings(samples=samples, integrator=integrator, threads=1))
        .combined[..., :3]
        .mean(axis=(0, 1))
        for integrator, samples in (("control_variates", 32), ("sobol", 64))
    ]
    dark = replace(scene, materials=2 * (Material(0.0),))
    seen = render(dark, Settings(samples=16, threads=1)).combined[..., :3].mean(axis=(0, 1))
    assert (means[0] > 1.05 * seen).all()
    np.testing.assert_allclose(means[0], means[1], rtol=5e-3)


@pytest.mark.parametrize("radius", (0.0, 0.2))
def test_samples_that_call_for_more_are_no_brighter_than_others(radius: float) -> None:
    """All noise is of one pixel, a quarter of which is lit: its first sample tells how many there are, and
    stays in the picture. Of eighty pictures the mean was a quarter of the truth.
    """
    width, height = 7, 5
    camera = Camera.look_at((0, 0, 5), (0, 0, 0), width, height, up=(0, 1, 0))
    half = 0.5 * 4.99 * np.tan(0.35) / width
    scene = Scene(
        camera,
        (floor(materials=0), floor(half, 0.01, materials=1)),
        materials=(Material(0.0), Material(1.0)),
        lights=(PointLight(100.0, radius=radius, position=(1, 0, 2)),),
        volumes=(Volume(0.01),),
        world=World(volume=0),
    )
    films = [render(scene, Settings(samples=1, seed=seed, threads=1)) for seed in range(80)]
    assert max(film.sample_count.max() for film in films) > 1
    found = np.array([film.layers[0].radiance[height // 2, width // 2, 0] for film in films], float)
    square = 1 + 1.99**2
    lit = 100 / (4 * np.pi) * 1.99 / square**1.5 / np.pi * np.exp(-0.01 * (4.99 + np.sqrt(square)))
    error = found.std() / np.sqrt(len(found))
    assert abs(found.mean() - lit / 4) < 3 * error
    assert error < 0.3 * lit / 4
