# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole rays of small lights in fog: against points of the same lights, and how much they leave to chance."""

from __future__ import annotations

import gc
import itertools
import weakref
from functools import cache

import numpy as np
import pytest
from scenes import assert_picture_is_sound, box, floor, place
from test_engine_fog import LIGHT, OCCLUDER, THIN, bounds, fog, rays_of, spot_at
from test_engine_fog_pictures import CAMERA, OUTSIDE, downwards, scene

from engine_core import (
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    Volume,
    parts,
    render,
    screen_picture,
)
from engine_core.shading.closures import Mix, Transparent
from engine_core.shading.coordinates import BACK
from engine_core.shading.values import OfSurface
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.ray_rule import PointsOfRay, ScatteredAlongRay
from engine_core.transport.scattered_light import ScatteredLight

DENSE = Volume(scattering=(0.9, 0.5, 0.3), absorption=0.1, anisotropy=-0.4)
DEEP, GREY = Volume(scattering=(9.0, 5.0, 3.0)), Volume(scattering=6.0, absorption=1.0)
AIMED = (0.0, 0.0, -2.5)
BEFORE = (0.05, 0.1, -1.5)


def disk(radius, position=LIGHT) -> PointLight:
    return PointLight(30.0, position=tuple(position), radius=radius, sphere=False)


def ball(radius, position=LIGHT) -> PointLight:
    return PointLight(30.0, position=tuple(position), radius=radius)


def sun(angle) -> SunLight:
    return SunLight(30.0, direction=(-0.5, -1.0, -0.3), angle=angle)


NESTED = (bounds((-1.6, -1.4, -4), (1.4, 1.3, 0.3)), bounds((0.5, -0.5, -2.2), (1.9, 0.9, -1.2), 1))
CASES: dict[str, tuple[Light | tuple[Light, ...], int, tuple]] = {
    "disk": (disk(0.1), 0, ()),
    "ball": (ball(0.1), 0, ()),
    "wide disk": (disk(0.6), 0, ()),
    "wide ball": (ball(0.6), 0, ()),
    "disk before the camera": (disk(0.2, BEFORE), 0, ()),
    "ball before the camera": (ball(0.2, BEFORE), 0, ()),
    "disk on the view's axis": (disk(0.1, (0, 0, -1.8)), 0, ()),
    "ball on the view's axis": (ball(0.1, (0, 0, -1.8)), 0, ()),
    "spot": (spot_at(LIGHT, AIMED, power=30.0, radius=0.1, sphere=False, angle=1.0, blend=0.3), 0, ()),
    "sharp spot": (spot_at(LIGHT, AIMED, power=30.0, radius=0.1, angle=0.8, blend=0.0), 0, ()),
    "spot before the camera": (
        spot_at(BEFORE, (1, 0, -2), power=30.0, radius=0.1, angle=0.8, blend=0.2),
        0,
        (),
    ),
    "light partly in a box": (ball(0.3, (1.2, 0.2, -1.5)), -1, NESTED[:1]),
    "fog in fog": (disk(0.2), -1, NESTED),
    "disk in deep fog": (disk(0.1), 2, ()),
    "spot in deep fog": (spot_at(LIGHT, AIMED, power=30.0, radius=0.1, sphere=False, angle=1.0), 2, ()),
    "disk in deep grey fog": (disk(0.1), 3, ()),
    "sun": (sun(0.04), -1, NESTED[:1]),
    "sun in fogs": (sun(0.04), -1, NESTED),
    "suns of three angles": ((sun(0.0), sun(0.02), sun(0.5)), -1, NESTED[:1]),
    "twenty suns": (tuple(sun(0.005 * i) for i in range(1, 21)), -1, NESTED[:1]),
    "far away": (ball(60.0, (900.0, 700.0, -1000.0)), -1, NESTED[:1]),
}


def mean(integrand, rays, each: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """(N,) means of channels' sums, and their standard errors."""
    u = np.random.default_rng(seed).random((integrand.rest_dimensions, len(rays), each), np.float32)
    which, values = integrand.rest(rays, None, u)
    assert np.isfinite(values).all()
    values = values.sum(axis=0, dtype=np.float64)
    if which is not None:
        values = np.bincount(which, values, len(rays) * each)
    values = values.reshape(len(rays), each)
    return values.mean(axis=1), values.std(axis=1) / each**0.5


def of_case(name: str, sampling="auto"):
    lights, world, meshes = CASES[name]
    lights = lights if isinstance(lights, tuple) else (lights,)
    made = fog(lights, [THIN, DENSE, DEEP, GREY], world, [OCCLUDER, *meshes], sampling, end=5.0)
    assert len(made.small) + len(made.sizeless) == len(lights)
    return made


@pytest.mark.parametrize("name", CASES)
def test_whole_rays_are_unbiased(name):
    made = of_case(name)
    lights = np.union1d(made.small, made.sizeless)
    whole, points = (kind(made, lights) for kind in (ScatteredAlongRay, PointsOfRay))
    rays = rays_of(whole, 48)
    single, error = mean(ScatteredLight(made, lights), rays, 20_000 // len(lights), 1)
    for integrand, each in ((whole, 400), (points, 1500)):
        ours, own = mean(integrand, rays, each, 2)
        both = np.hypot(error, own)
        assert abs(ours.sum() - single.sum()) < 4 * np.sqrt(np.square(both).sum())
        # A few rays see what is rare, of which variance tells too little.
        assert np.quantile(np.abs(ours - single) / np.maximum(both, 1e-3 * single.max()), 0.9) < 2.5


RED = (0.9, 0.3, 0.1)
CLEAR = {
    "coloured": Transparent(RED),
    "clear from one side": Mix(BACK, Transparent(RED), Transparent(0.0)),
    "clear from the other": Mix(BACK, Transparent(0.0), Transparent(RED)),
    "fading": Transparent(OfSurface(lambda points: 0.5 + 0.5 * np.sin(2 * points.position))),
    "nearly clear": Transparent(OfSurface(lambda points: 0.99 + 0.005 * np.sin(2 * points.position))),
    "striped": Transparent(OfSurface(lambda points: 1.0 * (np.sin(9 * points.position) > 0))),
}
BEHIND: dict[str, tuple[Light, int]] = {
    "point": (disk(0.0), 0),
    "ball": (ball(0.1), 0),
    "spot": (spot_at(LIGHT, AIMED, power=30.0, angle=1.0), 0),
    "sun": (sun(0.02), -1),
}


SOME = {
    ("coloured", "point"),
    ("clear from one side", "point"),
    ("fading", "spot"),
    ("nearly clear", "ball"),
    ("striped", "sun"),
}


@pytest.mark.parametrize(
    ("closure", "name"),
    [
        pytest.param(*case, marks=() if case in SOME else pytest.mark.full)
        for case in itertools.product(CLEAR, BEHIND)
    ],
)
def test_whole_rays_see_what_clear_surfaces_let_through(closure, name):
    """Of panes that cross the camera's rays, and of a ball."""
    lights, world = BEHIND[name]
    panes = [place((x, 0.0, -2.0), (0.0, angle, 0.0)) for x, angle in ((0.5, 1.2), (-0.4, 1.7), (0.4, 0.3))]
    corners = np.array([[-0.5, -2, 0], [0.5, -2, 0], [0.5, 2, 0], [-0.5, 2, 0]])
    meshes = [
        Mesh(corners @ matrix[:3, :3].T + matrix[:3, 3], [[0, 1, 2], [0, 2, 3]], materials=1)
        for matrix in panes
    ]
    meshes += [OCCLUDER, *(NESTED[:1] if world < 0 else ())]
    materials = (Material(), Material(surface=CLEAR[closure]))
    made = fog([lights], [THIN], world, meshes, materials=materials, end=5.0)
    whole, points = (kind(made, np.arange(1)) for kind in (ScatteredAlongRay, PointsOfRay))
    rays = rays_of(whole, 48)
    single, error = mean(ScatteredLight(made, np.arange(1)), rays, 20_000, 1)
    for integrand, each in ((whole, 400), (points, 1500)):
        ours, own = mean(integrand, rays, each, 2)
        both = np.hypot(error, own)
        assert abs(ours.sum() - single.sum()) < 4 * np.sqrt(np.square(both).sum())
        assert np.quantile(np.abs(ours - single) / np.maximum(both, 1e-3 * single.max()), 0.9) < 2.5
    assert whole.counts["transparent crossings"] > 0
    # Without noise, but for a ball's points and what is finer than nodes.
    radiance, told = whole.along(rays, None)
    off = np.abs(radiance.sum(axis=0) - single).sum() / single.sum()
    assert off < (0.02 if name == "point" and closure != "striped" else 0.2) and (told[0] >= 0).all()


def test_whole_rays_are_gone_with_what_knows_them():
    """Without waiting for cycles to be found: they hold a scene's triangles."""
    made = of_case("ball")
    whole = ScatteredAlongRay(made, made.small)
    there = weakref.ref(whole)
    gc.disable()
    try:
        del whole
        assert there() is None
    finally:
        gc.enable()


@pytest.mark.parametrize("light", [disk, ball])
@pytest.mark.parametrize("aside", [0.0, 1e-6, 1e-3, 0.3, 1.0])
def test_rays_through_a_lamp_see_what_its_points_bring(light, aside):
    """None of it is the peak that one without size would have there."""
    made = fog([light(0.1, (0.1 * aside, 0, -2))], [THIN], 0, end=5.0)
    whole, single = (kind(made, made.small) for kind in (ScatteredAlongRay, ScatteredLight))
    middle = Pixels(*np.full((2, 8), 16, np.int32), np.zeros(8, np.int32))
    rays = whole.first(middle, np.zeros((2, 8, 1), np.float32))
    (ours, own), (truth, error) = mean(whole, rays, 4000, 4), mean(single, rays, 20_000, 5)
    assert abs(ours.mean() - truth.mean()) < 4 * np.sqrt(np.square([own, error]).mean() / 4)
    by_nodes, told = whole.along(rays, None)
    assert np.isfinite(told).all() and abs(by_nodes.sum(axis=0).mean() / truth.mean() - 1) < 0.25
    assert whole.counts["non-finite samples"] == 0


def test_lights_of_next_to_no_size_are_as_bright_as_without():
    def bright(radius: float) -> float:
        spot = SpotLight(800.0, light_to_world=downwards(), angle=0.6, radius=radius)
        return float(
            render(scene(PointLight(300.0, position=OUTSIDE, radius=radius), spot), Settings(4)).volume.mean()
        )

    for radius in (1e-9, 1e-20, 1e-30):
        assert bright(radius) == pytest.approx(bright(0.0), rel=0.01)


def test_nodes_say_the_same_by_themselves_and_among_others():
    made = of_case("spot before the camera")
    whole = ScatteredAlongRay(made, made.small)
    rays = rays_of(whole, 120)
    together = whole.along(rays, None)[0]
    alone = [whole.along(rays, np.array([number]))[0] for number in range(len(rays))]
    np.testing.assert_allclose(np.concatenate(alone, axis=1), together, rtol=1e-4, atol=1e-7)


@pytest.mark.parametrize(
    ("name", "less", "by"),
    [("disk", 25, 0.01), ("ball", 12, 0.03), ("spot", 25, 0.08), ("sharp spot", 8, 0.08), ("sun", 25, 0.03)],
)
def test_opposite_points_leave_little_to_chance(name, less, by):
    """Of a sample, against one of a point; and of what nodes say."""
    made = of_case(name)
    whole = ScatteredAlongRay(made, made.small)
    rays = rays_of(whole, 200)
    truth, error = mean(whole, rays, 256, 3)
    _, of_points = mean(ScatteredLight(made, made.small), rays, 256, 3)
    assert np.square(of_points).sum() > less**2 * np.square(error).sum()
    by_nodes = whole.along(rays, None)[0].sum(axis=0)
    assert np.sqrt(np.square(by_nodes - truth).mean()) < by * truth.mean()


LIT = scene(
    PointLight(300.0, position=OUTSIDE, radius=0.1),
    SpotLight(800.0, light_to_world=downwards(), angle=0.6, blend=0.2, radius=0.08),
)


@cache
def blocks(samples: int, seeds: range, integrator: str) -> np.ndarray:
    """(S, K) sums of channels of fog, in blocks of pixels."""
    found = []
    for seed in seeds:
        radiance = render(LIT, Settings(samples, seed=seed, integrator=integrator, threads=2)).volume
        found.append(radiance.sum(axis=-1, dtype=np.float64).reshape(4, 8, 6, 8).mean(axis=(1, 3)).ravel())
    return np.stack(found)


@pytest.mark.parametrize("where", ["small", "given up"])
def test_pictures_are_unbiased(where, monkeypatch):
    """Blocks of the mean over seeds; by a net where polynomials are given up."""
    if where == "given up":
        monkeypatch.setattr(screen_picture, "HOPELESS", ((0.0, -1.0),))
        monkeypatch.setattr(screen_picture, "EVERYWHERE", -1.0)
    film = render(LIT, Settings(1))
    told = film.statistics["fog lit by small lights"]
    assert told == "built" if where == "small" else told.startswith("about")
    assert_picture_is_sound(film)

    ours, truth = blocks.__wrapped__(1, range(16), "control_variates"), blocks(32, range(8), "sobol")
    error = sum(a.var(axis=0, ddof=1) / len(a) for a in (ours, truth))
    error += np.square(1e-3 * truth.mean())
    z = (ours.mean(axis=0) - truth.mean(axis=0)) / np.sqrt(error)
    assert np.sqrt(np.square(z).mean()) < 1.6 and np.abs(z).max() < 5
    wholes = [a.mean(axis=1) for a in (ours, truth)]
    error = np.sqrt(sum(a.var(ddof=1) / len(a) for a in wholes))
    assert abs(wholes[0].mean() - wholes[1].mean()) < 4 * error


def test_what_serves_lights_goes_by_their_size():
    def told(radius: float, lights: int = 1) -> set[str]:
        lamps = [PointLight(300.0, position=(x, 1.5, 4.5), radius=radius) for x in np.arange(lights) / 9]
        return {name for name in render(scene(*lamps), Settings(1)).statistics if name.startswith("fog")}

    assert told(0.0) == {"fog lit by points"}
    assert told(0.1) == {"fog lit by small lights"}
    assert told(0.5) == told(0.1, parts.MOST_SMALL + 1) == {"fog lit by lights"}
    film = render(scene(ball(0.1), disk(0.5)), Settings(1))
    assert {"fog lit by small lights", "fog lit by lights"} <= set(film.statistics)


@pytest.mark.parametrize("bars", [0, 40])
def test_what_is_noise_to_whole_rays_has_a_net(bars):
    """A sun behind bars, whose shadows are less than a step between nodes."""
    meshes = [floor(8), bounds((-3, -3, 0.01), (3, 3, 3))]
    meshes += [box((3.2, y, 0), (3.3, y + 0.05, 6)) for y in np.linspace(-3, 3, bars)]
    sunlight = SunLight(3.0, direction=(-1.0, -0.1, -0.3), angle=0.0093)
    film = render(Scene(CAMERA, meshes, [Material(0.0)], [sunlight], volumes=[THIN]), Settings(1))
    assert ("fog lit by suns" if bars else "fog lit by small lights") in film.statistics


def test_where_no_ray_meets_fog_nothing_is_small():
    made = scene(PointLight(300.0, position=OUTSIDE, radius=0.1))
    away = Scene(
        made.camera, [bounds((50, 50, 50), (51, 51, 51))], [*made.materials], made.lights, volumes=[THIN]
    )
    film = render(away, Settings(1))
    assert not film.volume.any()
