# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog through a lens: where it sees a lamp, points of it about that, and nets of such points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import floor, place, sphere

from engine_core import (
    AreaLight,
    Camera,
    Laser,
    Material,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    Volume,
    World,
    parts,
    render,
)
from engine_core.geometry.frame import frame_of
from engine_core.geometry.warps import (
    about_angle,
    concentric_disk,
    polar_in_disk,
    regular_polygon,
    square_of_disk,
    square_of_polygon,
)
from engine_core.transport.camera_rays import CameraRays

POLYGONS = [(3, 0.3), (5, -1.0), (8, 0.0)]


def points(count: int = 1 << 16) -> np.ndarray:
    """(2, count) one in each cell of a grid."""
    edge = round(count**0.5)
    random = np.random.default_rng(0).random((2, edge, edge))
    return ((np.indices((edge, edge)) + random) / edge).reshape(2, -1)


def test_the_square_of_a_disk_is_where_its_points_come_from():
    u = points(1 << 12)
    np.testing.assert_allclose(square_of_disk(*concentric_disk(*u)), u, atol=1e-6)


@pytest.mark.parametrize("corners, rotation", POLYGONS)
def test_the_square_of_a_polygon_is_where_its_points_come_from(corners, rotation):
    u = points(1 << 12)
    found = square_of_polygon(corners, rotation, *regular_polygon(corners, rotation, *u))
    np.testing.assert_allclose(found, u, atol=2e-6)


@pytest.mark.parametrize("corners, rotation", [(0, 0.0), *POLYGONS])
@pytest.mark.parametrize("x, y", [(0, 0), (0.3, -0.2), (0, 0.999), (1.001, 0), (-0.8, 0.9), (2, 2), (40, -9)])
def test_polar_points_of_a_lens_are_of_all_of_it(corners, rotation, x, y):
    """By integrals of what is 1, and of what is not even."""
    u = points()
    px, py, weight = polar_in_disk(np.full(u.shape[1], x), np.full(u.shape[1], y), *u, corners, rotation)
    assert weight.min() >= 0 and np.isfinite(weight).all()
    at = concentric_disk(*u) if corners < 3 else regular_polygon(corners, rotation, *u)

    def f(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return 1 + x + 2 * x * y + np.sin(3 * y)

    assert weight.mean() == pytest.approx(1, abs=3e-3)
    assert (weight * f(px, py)).mean() == pytest.approx(f(*at).mean(), abs=6e-3)


def test_polar_points_take_away_one_over_the_distance():
    u = points(1 << 12)
    for x, most in ((0.0, 1e-6), (0.5, 0.5), (0.9, 0.95), (1.3, 1.0), (3.0, 0.5)):
        px, py, weight = polar_in_disk(np.full(u.shape[1], x), np.zeros(u.shape[1]), *u)
        found = weight / np.maximum(np.hypot(px - x, py), 1e-12)
        assert found.std() <= most * found.mean()


@pytest.mark.parametrize("middle, half", [(0.3, 0.2), (-3.0, 1.5), (9.0, 3.0)])
def test_points_about_an_angle_are_of_all_of_the_circle(middle, half):
    u = (np.arange(1 << 14) + 0.5) / (1 << 14)
    for part in (0.75, half / np.pi):
        turned, weight = about_angle(u, middle, half, np.array(part))
        assert ((turned >= 0) & (turned < 1)).all()
        near = np.abs(np.mod(2 * np.pi * turned - middle + np.pi, 2 * np.pi) - np.pi) < half
        assert near.mean() == pytest.approx(part, abs=1e-3)
        f = 1 + np.sin(2 * np.pi * turned) ** 3 + np.cos(6 * np.pi * turned + 1)
        assert (f * weight).mean() == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("focus", [3.0, 16.0])
def test_rays_about_a_spot_are_those_that_see_its_cone(focus, monkeypatch):
    """In front of what is in focus, and behind."""
    to_the_side = np.array([[0, 0, -1, -1], [1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1.0]])
    spot = SpotLight(300.0, light_to_world=to_the_side, angle=0.5)
    scene = seen_through_a_lens(spot, aperture=0.7, focus_distance=focus, width=96, height=64)

    def wrong() -> float:
        films = [render(scene, Settings(1, seed=s)) for s in range(6)]
        return float(np.sqrt(np.square([film.volume - truth for film in films]).mean()))

    truth = render(scene, Settings(256, seed=9, integrator="sobol")).volume
    ours = wrong()
    monkeypatch.setattr(parts, "_lit_through_lens", lambda *_: None)
    assert ours < 0.8 * wrong()


CAMERAS = [
    {},
    {"blades": 5, "blade_rotation": 0.4, "aperture_ratio": 1.7},
    {"projection": "orthographic", "viewplane": (-2, 2, -1.5, 1.5)},
]


@pytest.mark.parametrize("how", CAMERAS)
def test_a_lens_sees_a_lamp_where_its_ray_meets_it(how):
    camera = replace(Camera.look_at((1, -5, 2), (0, 0, 0), 32, 24, aperture=0.3, focus_distance=4.0), **how)
    lamp = PointLight(1.0, position=np.array([0.2, 1.0, 0.1]))
    scene = Scene(camera, (sphere((0, 0, 0), 1.0),), lights=(lamp,))
    frame = frame_of(scene)
    rays, position = CameraRays(camera, frame), (lamp.position - frame.origin) * frame.scale
    (image,) = rays.image_of(position[:, None])[0].T
    # Pixels about its image, from which the lens sees it through one of its own points.
    x, y = (a.ravel() + int(at) for a, at in zip(np.mgrid[-1:2, -1:2], image, strict=True))
    place = np.random.default_rng(1).random((2, 9, 1)).astype(np.float32)
    at = rays.seen_at(position, x, y, place)
    # As wide as the disk in its polygon.
    inside = np.hypot(*at)[:, 0] < (np.cos(np.pi / how["blades"]) if "blades" in how else 1)
    assert 1 <= inside.sum() < 9
    x, y, place, at = x[inside], y[inside], place[:, inside], at[:, inside]
    if "blades" in how:
        lens = np.stack(square_of_polygon(how["blades"], how["blade_rotation"], *at))
    else:
        lens = np.stack(square_of_disk(*at))
    origin, direction = rays.rays(x, y, np.concatenate([place, lens.astype(np.float32)]))
    away = position - origin
    away -= direction * ((away * direction).sum(1) / (direction * direction).sum(1))[:, None]
    assert (
        np.linalg.norm(away, axis=1).max(initial=0) < 1e-5 * np.linalg.norm(position - origin, axis=1).max()
    )


def seen_through_a_lens(*lights, **lens) -> Scene:
    camera = Camera.look_at((0, -6, 2), (0, 0, 1), 48, 32, aperture=0.2, focus_distance=4.0)
    meshes = (floor(4.0), sphere((0.9, 0.5, 0.8), 0.5))
    fog = (Volume(scattering=0.12, anisotropy=0.3),)
    # Of black surfaces there is no noise that would hide the fog's.
    return Scene(
        replace(camera, region=None, **lens), meshes, (Material(0.0),), lights, World(volume=0), volumes=fog
    )


LIGHTS = {
    "lamps in the picture": (
        PointLight(60.0, position=np.array([0.5, 1.0, 1.6])),
        PointLight(90.0, position=np.array([-1.2, 2.0, 0.9]), radius=0.02),
    ),
    "a lamp beside": (PointLight(300.0, position=np.array([5.0, -1.0, 6.0])),),
    "many lamps": tuple(
        PointLight(20.0, position=np.array([x, 1.5, z]), radius=0.03)
        for x in (-2.0, -1.2, -0.4, 0.4, 1.2, 2.0)
        for z in (0.6, 1.4, 2.2)
    ),
    "a ball and a pane": (
        PointLight(90.0, position=np.array([-1.2, 1.0, 1.5]), radius=0.4),
        AreaLight(90.0, light_to_world=place((1.5, 1.0, 3.0), (0, 0, -1)), size=0.8),
    ),
    "a laser": (
        Laser(
            30.0,
            light_to_world=np.array([[0, 0, -1, -3], [1, 0, 0, 0.4], [0, 1, 0, 1.2], [0, 0, 0, 1.0]]),
            radius=0.02,
            beam=False,
            spot=False,
        ),
    ),
}


def in_focus(lamp: tuple[float, float, float]) -> dict[str, float]:
    """Of the camera's plane, how far a place is."""
    towards = np.array([0, 6, -1]) / 37**0.5
    return {"focus_distance": float((np.array(lamp) - (0, -6, 2)) @ towards)}


@pytest.mark.parametrize("lens", [in_focus((0.5, 1.0, 1.6)), in_focus((0.5, 1.0, 1.6)) | {"aperture": 0.02}])
def test_fog_about_lamps_that_are_sharp_is_right(lens):
    """They have blocks of pixels of their own, which no net counts again."""
    scene = seen_through_a_lens(*LIGHTS["lamps in the picture"], **lens)
    about = (slice(14, 26), slice(20, 36))

    def pictures(samples: int, seeds: int, integrator: str = "control_variates") -> np.ndarray:
        films = [render(scene, Settings(samples, seed=s, integrator=integrator)) for s in range(seeds)]
        return np.array([film.volume[about].mean() for film in films], np.float64)

    assert "fog around lights" in render(scene, Settings(1)).statistics
    ours, plain = pictures(1, 12), pictures(256, 8, "sobol")
    error = np.hypot(ours.std(ddof=1) / 12**0.5, plain.std(ddof=1) / 8**0.5)
    assert abs(ours.mean() - plain.mean()) < 4 * error
    assert error < 0.01 * plain.mean()


@pytest.mark.parametrize(
    "name, most",
    [
        ("lamps in the picture", 0.4),
        ("a lamp beside", 0.5),
        ("many lamps", 0.7),
        ("a ball and a pane", 0.7),
        ("a laser", 0.5),
    ],
)
def test_nets_through_a_lens_are_right_and_calm(name, most):
    """Blocks of pixels, in the mean over seeds, as of plain samples; and fog by one sample less wrong."""
    scene = seen_through_a_lens(*LIGHTS[name])

    def pictures(samples: int, seeds: int, integrator: str = "control_variates") -> np.ndarray:
        films = [render(scene, Settings(samples, seed=s, integrator=integrator)) for s in range(seeds)]
        return np.array([film.volume + film.laser for film in films], np.float64)

    def blocks(a: np.ndarray) -> np.ndarray:
        return a.reshape(len(a), 4, 8, 6, 8, 3).mean(axis=(2, 4, 5))

    ours, plain, many = pictures(1, 12), pictures(1, 6, "sobol"), pictures(64, 4, "sobol")
    error = np.hypot(blocks(ours).std(axis=0, ddof=1) / 12**0.5, blocks(many).std(axis=0, ddof=1) / 2)
    apart = blocks(ours).mean(axis=0) - blocks(many).mean(axis=0)
    assert (np.abs(apart) < 5 * error + 2e-3 * many.mean()).all()
    assert np.sqrt(ours.var(axis=0).mean()) < most * np.sqrt(plain.var(axis=0).mean())


def test_all_of_a_laser_is_built_through_a_lens():
    laser = replace(LIGHTS["a laser"][0], beam=True, spot=True)
    film = render(seen_through_a_lens(laser), Settings(2))
    assert "followed" in film.statistics["lasers in fog"]
    assert "followed" in film.statistics["lasers on surfaces"]
    assert "parts of the lens" in film.statistics["lasers seen"]
    assert film.layers[-1].radiance.max() > 0
    alone = render(seen_through_a_lens(*LIGHTS["a lamp beside"]), Settings(2, integrator="cv_only"))
    assert any("CV Only" in message for message in alone.messages)
    assert alone.volume.any() and "fog lit by points" not in alone.statistics


BEAM = SpotLight(
    100.0, light_to_world=np.diag([1.0, 1, 1, 1]) + [[0, 0, 0, 0], [0, 0, 0, 3], [0, 0, 0, 5], [0] * 4]
)


@pytest.mark.parametrize("width, height", [(1, 1), (2, 2), (5, 3), (66, 34)])
def test_pictures_that_are_dark_or_small_are_no_matter(width, height):
    for light in (BEAM, *LIGHTS["lamps in the picture"], *LIGHTS["a laser"]):
        scene = seen_through_a_lens(light, width=width, height=height)
        for seed in range(4):
            assert np.isfinite(render(scene, Settings(1, seed=seed)).combined).all()


TO_LAMP = float(np.linalg.norm(np.array([0, -6, 2]) - np.array([0, 0, 1])))


@pytest.mark.parametrize(
    "lens",
    [
        {"focus_distance": TO_LAMP},
        {"focus_distance": TO_LAMP * 1.001},
        {"aperture": 1e-30},
        {"aperture": 1e-3},
        {"aperture": 0.02},
        {},
        {"aperture": 3.0, "blades": 3, "aperture_ratio": 0.5},
    ],
)
@pytest.mark.parametrize("kind", ["a lamp", "where a laser ends"])
def test_what_has_no_bound_at_a_corner_of_cells_makes_no_blot(kind, lens):
    """In the middle of the picture, where the camera looks: all four pixels' cells meet there."""
    light = PointLight(60.0, position=np.array([0.0, 0, 1]))
    if kind != "a lamp":
        down = np.eye(4) + [[0] * 4, [0] * 4, [0, 0, 0, 4], [0] * 4]
        light = Laser(60.0, light_to_world=down, radius=0.01, in_fog=False, beam=False, spot=False)
    scene = seen_through_a_lens(light, width=32, height=32, **lens)
    table = floor(4.0, 1.0)
    scene = replace(scene, meshes=(table,) if kind != "a lamp" else (floor(4.0),), materials=(Material(0.5),))

    def pictures(integrator: str, samples: int, seeds: int) -> np.ndarray:
        films = [render(scene, Settings(samples, seed=s, integrator=integrator)) for s in range(seeds)]
        return np.array([film.volume + film.laser for film in films], np.float64)

    truth = pictures("sobol", 256, 1)[0]
    wrong = [np.sqrt(np.square(pictures(how, 1, 4) - truth).mean()) for how in ("control_variates", "sobol")]
    assert wrong[0] < 0.7 * wrong[1]


def test_a_narrow_beam_in_focus_makes_no_specks():
    matrix = np.array([[0, 0, -1, -3], [1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 0, 1.0]])
    scene = seen_through_a_lens(SpotLight(900.0, light_to_world=matrix, angle=0.03), aperture=0.02)

    def wrong(integrator: str) -> float:
        films = [render(scene, Settings(1, seed=s, integrator=integrator)) for s in range(4)]
        return float(np.sqrt(np.square([film.volume - truth for film in films]).mean()))

    truth = render(scene, Settings(256, seed=9, integrator="sobol")).volume
    assert wrong("control_variates") < 0.5 * wrong("sobol")
