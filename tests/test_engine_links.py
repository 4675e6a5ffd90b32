# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights linked to some meshes and fogs, and to what casts shadows in their light."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import box, mixed_lights, pictures, place

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
from engine_core.scene import Linking
from engine_core.shading.closures import Diffuse, Glossy

FOG = (Volume(0.05, 0.02),)
ABOVE = Camera(place((0, 0, 6)), (-2, 2, -1, 1), 32, 16, projection="orthographic")
LEFT, RIGHT = np.s_[:, :16, :3], np.s_[:, 16:, :3]


def plate(low: float, high: float, **fields: Any) -> Mesh:
    return box((low, -1, -0.1), (high, 1, 0), **fields)


def plates(*lights: Light, volumes: Any = FOG, meshes: Any = (), **fields: Any) -> Scene:
    """Two plates side by side, the right one of light set 1."""
    world = World(volume=0 if volumes else -1)
    both = plate(-2, 0), plate(0, 2, light_set=1)
    return Scene(ABOVE, (*both, *meshes), lights=lights, volumes=volumes, world=world, **fields)


def picture(scene: Scene, samples: int = 16, seed: int = 0) -> np.ndarray:
    film = render(scene, Settings(samples=samples, seed=seed))
    assert not film.messages
    return film.combined


ACROSS = place((-3, 0.1, 0.6), (0, -np.pi / 2 - 0.05, 0))
"""From the left, to the right plate's far end about."""


def across(**fields: Any) -> Laser:
    return Laser(10.0, light_to_world=ACROSS, radius=0.05, **fields)


def test_a_laser_lights_what_it_is_linked_to() -> None:
    parts = {"in_fog": False, "beam": False}
    whole = picture(plates(across(**parts)))
    linked = picture(plates(across(linking=Linking(receivers=frozenset({0})), **parts)))
    assert np.abs(linked[RIGHT]).max() < 1e-4 * whole[RIGHT].max()
    np.testing.assert_allclose(linked[LEFT], whole[LEFT], rtol=0.02, atol=1e-4 * whole.max())


def test_the_spot_of_a_laser_too() -> None:
    down = place((1, 0.2, 3))
    lit, dark = (
        picture(plates(Laser(1.0, light_to_world=down, radius=0.2, linking=links), volumes=()))
        for links in (Linking(frozenset({1})), Linking(frozenset({0})))
    )
    assert lit[RIGHT].any() and not dark[..., :3].any()


def test_a_laser_that_no_fog_scatters_is_a_spot() -> None:
    down = {"light_to_world": place((1, 0.2, 3)), "radius": 0.2}
    spot = Laser(1.0, in_fog=False, on_surfaces=False, beam=False, **down)
    for links in (Linking(fog=False), Linking(receivers=frozenset({1}))):
        np.testing.assert_array_equal(
            picture(plates(Laser(1.0, linking=links, **down))), picture(plates(spot))
        )


SCREEN = box((-0.6, -1, 0.2), (-0.5, 1, 1.2), visible_to_camera=False, shadow_set=3)


def test_a_laser_passes_what_does_not_block_it() -> None:
    free, blocked = picture(plates(across())), picture(plates(across(), meshes=(SCREEN,)))
    passing = picture(plates(across(linking=Linking(blockers=frozenset({0}))), meshes=(SCREEN,)))
    assert blocked[RIGHT].mean() < 0.1 * free[RIGHT].mean()
    np.testing.assert_allclose(passing[..., :3].mean(), free[..., :3].mean(), rtol=0.01)
    np.testing.assert_allclose(passing[..., :3], free[..., :3], rtol=0.1, atol=1e-2 * free.max())


def test_a_spot_behind_what_does_not_block_its_laser_is_as_smooth() -> None:
    down = {"light_to_world": place((1, 0.2, 3), (0, 0.2, 0)), "radius": 0.15}
    screen = box((-2, -1, 1), (2, 1, 1.1), visible_to_camera=False, shadow_set=3)
    free = pictures(plates(Laser(1.0, **down), volumes=()), 6, samples=4)
    through = Laser(1.0, linking=Linking(blockers=frozenset({0})), **down)
    passing = pictures(plates(through, volumes=(), meshes=(screen,)), 6, samples=4)
    np.testing.assert_allclose(passing.mean(), free.mean(), rtol=5e-3)
    assert passing.std(axis=0).mean() < 2 * free.std(axis=0).mean() + 1e-6 * free.mean()


LAMPS = {
    "bare": PointLight(20.0, position=(-1.5, 0, 1)),
    "ball": PointLight(20.0, position=(-1.5, 0, 1), radius=0.1),
    "disk": PointLight(20.0, position=(-1.5, 0, 1), radius=0.1, sphere=False),
    "spot": SpotLight(40.0, light_to_world=place((-1.5, 0, 1), (0, -1, 0)), angle=1.2),
    "area": AreaLight(30.0, light_to_world=place((-1.5, 0, 1), (0, -1, 0)), size=0.4),
    "sun": SunLight(1.0, direction=(1, 0, -0.8)),
}


@pytest.mark.parametrize("name", LAMPS)
def test_what_does_not_block_a_light_casts_no_shadow(name: str) -> None:
    lamp = LAMPS[name]
    # A sun does not get through a world of fog.
    volumes = () if name == "sun" else FOG
    linked = replace(lamp, linking=Linking(blockers=frozenset({0})))
    free = picture(plates(lamp, volumes=volumes), 64)
    dark, passing = (
        picture(plates(light, volumes=volumes, meshes=(SCREEN,)), 64) for light in (lamp, linked)
    )
    np.testing.assert_allclose(passing[..., :3].mean(axis=0), free[..., :3].mean(axis=0), rtol=0.03)
    np.testing.assert_allclose(passing[..., :3].mean(), free[..., :3].mean(), rtol=2e-3)
    assert dark[RIGHT].mean() < 0.8 * free[RIGHT].mean()


def test_fog_is_between_where_nothing_blocks() -> None:
    free, linked, shadowless = (
        picture(plates(lamp), 4)[LEFT].mean()
        for lamp in (
            LAMPS["bare"],
            replace(LAMPS["bare"], linking=Linking(blockers=frozenset())),
            replace(LAMPS["bare"], casts_shadow=False),
        )
    )
    assert linked == pytest.approx(free, rel=0.01) and shadowless > 1.05 * free


def test_lights_with_blockers_of_their_own_side_by_side() -> None:
    """Each has its shadows, whatever the others have: their pictures add up."""
    lamps = [LAMPS[name] for name in ("bare", "ball", "spot", "area")]
    links = [
        Linking(),
        Linking(blockers=frozenset({0})),
        Linking(blockers=frozenset({3})),
        Linking(frozenset({0})),
    ]
    linked = [replace(lamp, linking=of) for lamp, of in zip(lamps, links, strict=True)]
    alone = sum(picture(plates(lamp, meshes=(SCREEN,)), 64)[..., :3].astype(float) for lamp in linked)
    together = picture(plates(*linked, meshes=(SCREEN,)), 64)[..., :3]
    np.testing.assert_allclose(together.mean(axis=(0, 1)), alone.mean(axis=(0, 1)), rtol=0.01)
    np.testing.assert_allclose(together.mean(axis=(0, 2)), alone.mean(axis=(0, 2)), rtol=0.05)


SEEDS = 10


@pytest.mark.parametrize(("count", "shiny"), ((12, True), (60, False)))
def test_many_lights_linked_at_random(count: int, shiny: bool) -> None:
    random = np.random.default_rng(count)
    lights = mixed_lights(count)
    sets = [frozenset(s for s in (0, 1) if random.random() < 0.5) for _ in lights]
    linked = [replace(light, linking=Linking(of)) for light, of in zip(lights, sets, strict=True)]
    surface = Material(surface=Glossy(0.8, roughness=0.4) if shiny else Diffuse(0.8))
    found = pictures(plates(*linked, volumes=(), materials=(surface,)), SEEDS, samples=4)
    for number, part in enumerate((LEFT, RIGHT)):
        own = [light for light, of in zip(lights, sets, strict=True) if number in of]
        truth = pictures(plates(*own, volumes=(), materials=(surface,)), SEEDS, samples=8)
        mine, theirs = (x[(slice(None), *part)].mean(axis=(1, 2)) for x in (found, truth))
        error = np.sqrt(mine.var(axis=0, ddof=1) / SEEDS + theirs.var(axis=0, ddof=1) / SEEDS)
        assert (np.abs(mine.mean(axis=0) - theirs.mean(axis=0)) < 4 * error + 1e-5 * theirs.mean()).all()


@pytest.mark.parametrize("count", (20, 40))
def test_bright_lights_of_others_make_no_noise(count: int) -> None:
    """Where a dim one alone is linked, it is what is sampled, however many there are."""
    random = np.random.default_rng(0)
    lights: list[Light] = [PointLight(0.2, position=(1, 0, 1), radius=0.05, linking=Linking(frozenset({1})))]
    for position in random.uniform((-2, -1, 0.5), (2, 1, 1.5), (count, 3)):
        bright = PointLight(20.0, position=position, radius=0.05, linking=Linking(frozenset({0})))
        lights.append(bright)
    found = pictures(plates(*lights, volumes=()), 6, samples=16)[:, :, 17:]
    assert found.std(axis=0, ddof=1).mean() < 0.02 * found.mean()


def test_emission_is_linked_mesh_by_mesh() -> None:
    glow = Material(emission=5.0)
    lamps = [
        box((x - 0.1, -0.1, 0.8), (x + 0.1, 0.1, 1), materials=1, visible_to_camera=False, linking=links)
        for x, links in ((-1, Linking(frozenset({1}))), (1, Linking(frozenset({0}))))
    ]
    both = {"materials": (Material(0.8), glow), "volumes": ()}
    found = picture(plates(meshes=lamps, **both), 64)[..., :3]
    one, other = (picture(plates(meshes=[replace(lamp, linking=Linking())], **both), 64) for lamp in lamps)
    np.testing.assert_allclose(found[:, :16].mean(), other[LEFT].mean(), rtol=0.02)
    np.testing.assert_allclose(found[:, 16:].mean(), one[RIGHT].mean(), rtol=0.02)


def test_fogs_that_differ_in_what_lights_them() -> None:
    fogs = (Volume(0.05), Volume(0.3, light_set=2))
    lamp = replace(LAMPS["bare"], linking=Linking(frozenset({0, 1})))
    body = box((-0.5, -0.5, 0.2), (0.5, 0.5, 0.8), surface=False, volume=1)
    film = render(plates(lamp, volumes=fogs, meshes=(body,)), Settings(samples=1))
    assert film.messages == ['Light "Light" is linked to some fogs and not to others; it lights all of them.']
