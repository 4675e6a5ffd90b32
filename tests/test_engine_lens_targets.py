# SPDX-License-Identifier: GPL-3.0-or-later
"""Small and bright things behind a lens: points through parts of it, which add up to points of all of it."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import floor

from engine_core import (
    Camera,
    Film,
    Laser,
    Material,
    PointLight,
    Scene,
    Settings,
    Volume,
    World,
    render,
)
from engine_core.geometry.frame import Frame
from engine_core.integration.mapping import in_order
from engine_core.seen_through_lens import _wanted, seen_through_lens
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.camera_rays import CameraRays
from engine_core.transport.lens_targets import LensTargets

LENSES = (
    {},
    {"blades": 5, "blade_rotation": 0.4},
    {"blades": 3},
    {"aperture_ratio": 2.0},
    {"aperture_ratio": 0.5, "blades": 6},
)
REGION = (3, 2, 27, 18)
FRAME = Frame(np.zeros(3), 1.0)


def camera(width: int = 30, height: int = 20, **lens: Any) -> Camera:
    """At the origin of y, that looks along it."""
    looking = Camera.look_at((0, 0, 1), (0, 4, 1), width, height)
    return replace(looking, **{"aperture": 0.2, "focus_distance": 3.0} | lens)


def orthographic(*size: int, **lens: Any) -> Camera:
    plane = {"projection": "orthographic", "viewplane": (-2, 2, -4 / 3, 4 / 3)}
    return replace(camera(*size), **plane | lens)


@pytest.mark.parametrize("lens", LENSES)
def test_places_on_a_lens_and_in_its_square_are_inverse(lens: dict[str, Any]) -> None:
    rays = CameraRays(camera(**lens), FRAME)
    random = np.random.default_rng(1)
    u = random.random((2, 20_000))
    on_lens = rays.on_lens(u)
    again, inside = rays.square_of_lens(on_lens)
    assert inside.mean() > 0.9999  # but for what lies on the rim
    np.testing.assert_allclose(again, u, atol=1e-5)
    anywhere = random.uniform(-1, 1, (2, 100_000))
    inside = rays.square_of_lens(anywhere)[1]
    part = rays.lens_area / 4
    assert inside.mean() == pytest.approx(part, abs=4 * np.sqrt(part * (1 - part) / inside.size))


def some_targets(rays: CameraRays, seed: int) -> LensTargets:
    """Balls and rods nearer than what is in focus, further, and across it."""
    random = np.random.default_rng(seed)
    centre = np.array([[0.0], [3.0], [1.0]]) + random.normal(size=(3, 6)) * [[1.0], [2.0], [0.7]]
    rods = []
    for _ in range(4):
        direction = random.normal(size=3)
        start = np.array([0, random.uniform(0.5, 8), 1]) + random.normal(size=3) * 0.5
        length = random.choice([0.5, 3.0, np.inf])
        rods.append((start, direction / np.linalg.norm(direction), length, random.uniform(0.001, 0.1), 1.0))
    return LensTargets.of(rays, (centre, random.uniform(0.005, 0.1, 6), 1.0), rods)


@pytest.mark.parametrize("made", (camera, orthographic))
@pytest.mark.parametrize("lens", LENSES)
def test_points_and_weights_are_those_of_the_whole_lens(made: Any, lens: dict[str, Any]) -> None:
    rays = CameraRays(made(**lens), FRAME)
    random, seen = np.random.default_rng(2), 0
    for seed in range(4):
        targets = some_targets(rays, seed)
        seers = targets.seers(REGION)
        seers = seers.take(np.flatnonzero(seers.count)[::2])
        if len(seers) == 0:
            continue
        seen += len(seers)
        column, row = np.divmod(seers.index, REGION[3] - REGION[1])
        pixels = Pixels(column + REGION[0], row + REGION[1], np.zeros(len(seers), np.int32))
        points, weight = targets.points(pixels, seers, random.random((4, len(seers), 1024)))
        assert (weight >= 0).all() and weight.max() <= 4.001
        lens_point = rays.on_lens(points[2:])
        whole = rays.on_lens(random.random((2, 1 << 18)))
        # Mean, and a first and a second moment.
        for tell in (lambda x, y: x * 0 + 1, lambda x, y: x + 0.5 * y, lambda x, y: x * y + y * y):
            values = tell(*lens_point) * weight
            error = values.std() / np.sqrt(values.size)
            assert abs(values.mean() - tell(*whole).mean()) < 4 * error + 2e-3
    assert seen > 50


@pytest.mark.parametrize("made", (camera, orthographic))
@pytest.mark.parametrize("lens", LENSES)
def test_no_pixel_that_sees_a_target_is_missed(made: Any, lens: dict[str, Any]) -> None:
    rays = CameraRays(made(**lens), FRAME)
    random = np.random.default_rng(3)
    height = REGION[3] - REGION[1]
    x, y = (a.ravel() for a in np.meshgrid(np.arange(3, 27), np.arange(2, 18), indexing="ij"))
    found = 0
    for seed in range(6):
        targets = some_targets(rays, 100 + seed)
        origins, directions = rays.rays(x, y, random.random((4, len(x), 64), np.float32))
        origins, directions = (
            np.broadcast_to(a, (len(x) * 64, 3)).T.astype(float) for a in (origins, directions)
        )
        directions = directions / np.linalg.norm(directions, axis=0)
        near = np.zeros(len(x), bool)
        for start, end, radius in zip(targets._start.T, targets._end.T, targets._radius, strict=True):
            near |= (gap_to_rod(origins, directions, start, end) < radius).reshape(len(x), -1).any(axis=1)
        seen = np.zeros(len(x), bool)
        seen[targets.seers(REGION).index] = True
        assert not (near & ~seen).any()
        found += near.sum()
        assert ((x - REGION[0]) * height + y - REGION[1] == np.arange(len(x))).all()
    assert found > 200


def test_no_column_next_to_a_near_balls_rim_is_missed() -> None:
    rays = CameraRays(camera(1920, 1280, aperture=0.1), FRAME)
    targets = LensTargets.of(rays, (np.array([[0.0], [0.3], [0.0]]), np.array([0.01]), 1.0))
    x = np.arange(1920)
    u = np.random.default_rng(5).random((4, len(x), 256), np.float32)
    # Their lowest and highest points of the lens, along the row.
    u[2:] = rays.square_of_lens(np.stack([np.sign(u[2] - 0.5), 0 * u[3]]) * 0.999999)[0]
    origins, directions = (a.T.astype(float) for a in rays.rays(x, np.full(1920, 640), u))
    directions /= np.linalg.norm(directions, axis=0)
    gap = gap_to_rod(origins, directions, *(a[:, 0] for a in (targets._start, targets._end)))
    near = (gap < 0.01).reshape(1920, -1).any(axis=1)
    seen = np.zeros(1920, bool)
    seen[targets.seers((0, 640, 1920, 641)).index] = True
    assert near.sum() > 200
    assert not (near & ~seen).any()


def gap_to_rod(origins: np.ndarray, directions: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """(N,) least distances of rays (3, N), of unit directions, from a rod's axis."""
    axis, away = end - start, origins - start[:, None]
    square = max(axis @ axis, 1e-30)
    cos, along, ahead = axis @ directions, axis @ away, (directions * away).sum(axis=0)
    ray = np.maximum((cos * along - ahead * square) / np.maximum(square - cos * cos, 1e-30), 0)
    rod = np.clip((cos * ray + along) / square, 0, 1)
    ray = np.maximum(cos * rod - ahead, 0)
    return np.linalg.norm(away + ray * directions - axis[:, None] * rod, axis=0)


def test_points_of_a_pixel_are_not_told_by_itself() -> None:
    random = np.random.default_rng(4)
    deviation = np.zeros((12, 10))
    column, row = (a.ravel() for a in np.mgrid[:10, :8])
    deviation[1:-1, 1:-1] = random.random((10, 8)) ** 4
    have = np.full(80, 4)
    before = _wanted(deviation, column, row, have)
    assert before.sum() > 1.3 * have.sum()
    white = (column + row) % 2 == 0
    deviation[column[white] + 1, row[white] + 1] *= random.random(white.sum())
    after = _wanted(deviation, column, row, have)
    np.testing.assert_array_equal(before[white], after[white])
    assert (before[~white] != after[~white]).any()
    # By so much more where the neighbours have all of it.
    deviation[:] = 0
    deviation[5, 5] = 1
    wanted = _wanted(deviation, column, row, have)
    assert sorted(np.flatnonzero(wanted > 4)) == sorted([3 * 8 + 4, 5 * 8 + 4, 4 * 8 + 3, 4 * 8 + 5])


def laser(start: Any, aim: Any, **fields: Any) -> Laser:
    start, aim = np.array(start, float), np.array(aim, float)
    back = (start - aim) / np.linalg.norm(start - aim)
    side = np.cross(back, (0, 0, 1))
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
    matrix[:3, 3] = start
    return Laser(10.0, light_to_world=matrix, in_fog=False, on_surfaces=False, **fields)


def laser_scene(made: Any, lens: dict[str, Any], **fields: Any) -> Scene:
    beam = laser((-1.5, 9, 2), (0.6, 6, 0), radius=0.01, **fields)
    return Scene(
        made(48, 32, **lens),
        (floor(8),),
        materials=(Material(0.5),),
        lights=(beam,),
        volumes=(Volume(0.05),),
        world=World(volume=0),
    )


def of_laser(film: Film) -> np.ndarray:
    return sum(layer.radiance[..., :3].astype(float) for layer in film.layers if layer.shows == "laser")


def compared(scene: Scene, of: Any, samples: int = 128) -> tuple[float, float, float]:
    """By how many standard errors the mean is off that of plain samples; relative errors of both."""
    ours, plain = (
        np.array(
            [of(render(scene, Settings(samples=n, seed=s, threads=2, integrator=name))) for s in range(8)]
        )
        for n, name in ((1, "control_variates"), (samples, "sobol"))
    )
    means = [a.mean(axis=(1, 2, 3)) for a in (ours, plain)]
    error = np.hypot(*(m.std(ddof=1) for m in means)) / np.sqrt(8)
    rms = [np.sqrt(a.var(axis=0, ddof=1).mean()) / plain.mean() for a in (ours, plain)]
    return (means[0].mean() - means[1].mean()) / error, *rms


@pytest.mark.parametrize(
    ("made", "lens"),
    [(camera, lens) for lens in LENSES] + [(orthographic, {}), (camera, {"focus_distance": 12.0})],
)
def test_a_beam_through_a_lens_is_that_of_plain_samples(made: Any, lens: dict[str, Any]) -> None:
    off, ours, plain = compared(laser_scene(made, lens, spot=False), of_laser)
    assert abs(off) < 4
    assert ours < plain / 2


def test_where_a_beam_ends_through_a_lens() -> None:
    off, ours, plain = compared(laser_scene(camera, {}, beam=False), of_laser, 512)
    assert abs(off) < 4
    assert ours < plain / 2


@pytest.mark.parametrize("fog", (False, True))
def test_lamps_out_of_focus(fog: bool) -> None:
    """Before a sky and a glowing floor: one behind another, one in focus, one at the picture's edge."""
    lamps = [
        PointLight(power, position=place, radius=0.03, visible_to_camera=True)
        for power, place in ((5, (0, 9, 1)), (8, (0.1, 12, 1)), (3, (0.4, 3, 1.2)), (9, (-3.4, 9, 1)))
    ]
    scene = Scene(
        camera(48, 32),
        (floor(8),),
        materials=(Material(0.5, emission=(0.1, 0.2, 0.3)),),
        lights=tuple(lamps),
        volumes=(Volume(0.02),) if fog else (),
        world=World(0.0 if fog else 0.2, volume=0 if fog else -1),
    )
    off, ours, plain = compared(scene, lambda film: film.layers[0].radiance[..., :3].astype(float), 64)
    assert abs(off) < 4
    assert ours < plain / 4


UNUSUAL = {
    "in the beam": ((-3, 0, 1), (3, 0, 1), 0.2, {"clip_start": 0.0}),
    "the beam's axis is behind the camera": ((-3, -0.05, 1), (3, -0.05, 1), 0.2, {"clip_start": 0.0}),
    "its axis is nearer than what is clipped": ((-3, 0.08, 1), (3, 0.08, 1), 0.05, {"clip_start": 0.1}),
    "focus far away": ((-1.5, 9, 2), (0.6, 6, 0), 0.01, {"focus_distance": 1e9}),
    "across the view": ((-3, 4, 1), (3, 4, 1.1), 0.02, {}),
    "away from the camera": ((0.1, 0.5, 0.9), (0.5, 9, 1.4), 0.02, {}),
}


@pytest.mark.parametrize("name", UNUSUAL)
def test_beams_at_unusual_places(name: str) -> None:
    start, aim, radius, lens = UNUSUAL[name]
    beam = laser(start, aim, radius=radius, spot=False)
    scene = laser_scene(camera, lens, spot=False)
    scene = replace(scene, lights=(beam,), meshes=(), world=World(volume=0))
    off, _, _ = compared(scene, of_laser)
    assert abs(off) < 4.5


@pytest.mark.parametrize(
    ("clip_start", "density", "depth"), [(-20.0, 0.05, -3.0), (0.1, 1e-4, 6.0)], ids=("behind", "without end")
)
def test_beams_before_an_orthographic_lens(clip_start: float, density: float, depth: float) -> None:
    beam = laser((-1.5, depth, 0.2), (1.5, depth, 1.2), radius=0.02, spot=False)
    scene = laser_scene(orthographic, {"clip_start": clip_start}, spot=False)
    scene = replace(scene, lights=(beam,), meshes=(), volumes=(Volume(density),))
    off, _, _ = compared(scene, of_laser)
    assert abs(off) < 4.5


@pytest.mark.parametrize(
    "lens",
    [
        {"focus_distance": 1e-6},
        {"focus_distance": 1e300},
        {"aperture": 1e6},
        {"aperture": 1e-300},
        {"aperture_ratio": 1e-3},
        {"aperture_ratio": 1e30},
        {"blades": 3, "blade_rotation": 1e9},
        {"clip_start": 1e6, "clip_end": 1e9},
    ],
)
@pytest.mark.parametrize("made", (camera, orthographic))
def test_no_lens_is_too_extreme(made: Any, lens: dict[str, Any]) -> None:
    scene = laser_scene(made, lens)
    lamps = [PointLight(5, position=(0, y, 1), radius=0.03, visible_to_camera=True) for y in (3, 9)]
    film = render(replace(scene, lights=(*scene.lights, *lamps)), Settings(2, standard_error=True))
    for values in (film.combined, film.volume, film.laser, film.standard_error):
        assert np.isfinite(values).all()


@pytest.mark.parametrize("limit", ({"time_limit": 1.0}, {"noise_threshold": 0.01}))
def test_where_samples_may_end_early_lamps_do_not_take_those_of_all(limit: dict[str, float]) -> None:
    rays = CameraRays(camera(48, 32), FRAME)
    targets = LensTargets.of(rays, (np.array([[-1.0, 0, 1], [9.0] * 3, [0.0] * 3]), np.full(3, 0.03), 4.0))

    def points(settings: Settings) -> int:
        spent = 0

        def first(pixels: Pixels, u: np.ndarray) -> SimpleNamespace:
            nonlocal spent
            spent += u[0].size
            return SimpleNamespace(values=np.ones((3, u[0].size)))

        region = 0, 0, 48, 32
        seen_through_lens(first, targets, region, settings, 1, in_order, lambda: True, lambda: None)
        return spent

    assert points(Settings(1 << 12, **limit)) == points(Settings(16)) < points(Settings(1 << 12)) / 8
