# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of beams and to the camera: maps, against quadrature and point lights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scenes
from laser_stage import (
    MAPS,
    MIDDLE,
    Line,
    Stage,
    beam,
    everywhere,
    henyey_greenstein,
    in_middles,
    net,
    pinhole,
    pixels,
    tensor,
)
from scipy.integrate import dblquad

from engine_core import Camera, Laser, Material, Mesh, Scene, Volume
from engine_core.integration.rules import gauss
from engine_core.shading.closures import Transparent
from engine_core.transport.laser_in_fog import RaySegments
from engine_core.transport.laser_maps import (
    along_beam,
    foot_and_gap,
    passages,
)

# -- maps ----------------------------------------------------------------------------------------------


def some_lines(count: int = 400, seed: int = 3) -> tuple[np.ndarray, ...]:
    random = np.random.default_rng(seed)
    between, ray, axis = random.normal(size=(3, 3, count))
    ray /= np.sqrt((ray * ray).sum(axis=0))
    axis /= np.sqrt((axis * axis).sum(axis=0))
    length, start = random.uniform(0.1, 5, count), random.uniform(0, 1, count)
    return between, ray, axis, length, start, start + random.uniform(0.1, 5, count)


@pytest.mark.parametrize("name", MAPS)
def test_maps_integrate_the_inverse_square_to_what_it_is(name):
    between, ray, axis, length, start, end = lines = some_lines()
    p = passages(*lines)
    x, w = gauss(24)
    total, whole = np.zeros((2, len(length)))
    for i in range(24):
        v, dv = along_beam(p, x[i])
        whole += w[i] * dv
        for j in range(24):
            _, _, weight = MAPS[name](p, v, x[j])
            total += w[i] * w[j] * dv * weight
    np.testing.assert_allclose(whole, length, rtol=1e-10)
    for k in range(3):

        def inverse_square(t: float, v: float, k: int = k) -> float:
            vector = between[:, k] + v * axis[:, k] - t * ray[:, k]
            return 1 / (vector @ vector)

        wanted = dblquad(inverse_square, 0, length[k], start[k], end[k], epsrel=1e-8)[0]
        assert total[k] == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("name", MAPS)
def test_points_are_where_their_distances_say(name):
    between, ray, axis, length, start, end = lines = some_lines()
    p = passages(*lines)
    u = np.random.default_rng(4).random((2, len(length)))
    v, _ = along_beam(p, u[0])
    x, r, _ = MAPS[name](p, v, u[1])
    t = foot_and_gap(p, v)[0] + x
    vector = between + v * axis - t * ray
    np.testing.assert_allclose(np.sqrt((vector * vector).sum(axis=0)), r, rtol=1e-9)
    assert ((v >= 0) & (v <= length) & (t >= start - 1e-9) & (t <= end + 1e-9)).all()


@pytest.mark.parametrize("angle", [1, 1e-3, 1e-6, 1e-9, 1e-12, 1e-16, 1e-20, 1e-200, 0, np.pi])
@pytest.mark.parametrize("distance", [1, 1e-3, 1e-9, 1e-15, 1e-300, 0])
@pytest.mark.parametrize("name", MAPS)
def test_parallel_and_crossing_lines_are_finite(angle, distance, name):
    u = np.array([0, 2.0**-24, 0.3, 0.7, 1 - 2.0**-24, 1])
    ones = np.ones(len(u))
    axis = np.array([[np.sin(angle)], [0], [np.cos(angle)]]) * ones
    between = np.array([[-0.3], [distance], [0.5]]) * ones
    ray = np.array([[0.0], [0], [1]]) * ones
    p = passages(between, ray, axis, 2 * ones, 0 * ones, 3 * ones)
    v, dv = along_beam(p, u)
    x, r, weight = MAPS[name](p, v, u)
    t = foot_and_gap(p, v)[0] + x
    assert np.isfinite([v, dv, x, r, weight]).all()
    assert v.min() > -1e-9 and v.max() < 2 + 1e-6 and t.min() > -1e-6 and t.max() < 3 + 1e-6
    # The middle of a stretch that the ray does not come near.
    if distance == 1 and np.sin(angle) < 1e-6:
        np.testing.assert_allclose(v, 2 * u, atol=1e-5)


# -- in fog --------------------------------------------------------------------------------------------


def random_line(random: np.random.Generator) -> tuple[Camera, float, Laser, tuple]:
    """A camera, how far it sees, a laser and fog."""
    camera, end = pinhole(random.normal(size=3) * 2, random.normal(size=3)), random.uniform(2, 20)
    laser = beam(
        random.normal(size=3) * 3,
        random.normal(size=3),
        random.uniform(1, 5, 3),
        length=random.uniform(0.5, 8),
    )
    fog = random.uniform(0.01, 0.6, 3), random.uniform(0, 0.3, 3), random.uniform(-0.8, 0.8)
    return camera, end, laser, fog


def wall_before(camera: Camera, end: float) -> Mesh:
    """What a `pinhole` sees at last."""
    corners = [(x, y, -end) for x, y in ((-0.01, -0.01), (0.01, -0.01), (0.01, 0.01), (-0.01, 0.01))]
    corners = corners @ camera.camera_to_world[:3, :3].T + camera.camera_to_world[:3, 3]
    return Mesh(corners, [(0, 1, 2), (0, 2, 3)], casts_shadow=False)


@pytest.mark.parametrize("seed", range(20))
def test_light_in_fog_is_the_double_integral(seed):
    camera, end, laser, (scattering, absorption, g) = random_line(np.random.default_rng(seed))
    meshes = (wall_before(camera, end),)
    stage = Stage(Scene(camera, meshes, lights=(laser,), **everywhere(scattering[None], absorption, [g])))
    integrand, line = stage.in_fog(), Line(stage, laser)
    rays = integrand.first(pixels(), MIDDLE)
    u, weights = tensor(24)
    value = integrand.rest(rays, None, u[:, None])[1] @ weights
    channel = seed % 3
    sigma = scattering[channel] + absorption[channel]

    def twice_scattered(t: float, v: float) -> float:
        towards, r = line.between(t, v)
        phases = henyey_greenstein(towards @ line.axis, g) * henyey_greenstein(-towards @ line.direction, g)
        return phases * np.exp(-sigma * (t + v + r)) / r**2

    wanted = dblquad(twice_scattered, 0, laser.length, 0, end, epsabs=1e-9, epsrel=1e-5)[0]
    wanted *= laser.power[channel] * scattering[channel] ** 2
    assert value[channel] == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize("g", [0.0, 0.6])
def test_a_beam_is_a_chain_of_weak_point_lights(g):
    laser = beam((-1, 0.4, 0.5), (1, 0.7, -0.2), 3.0, length=4.0)
    sigma = 0.3
    stage = Stage(Scene(pinhole((0, -3, 0.5), (0.3, 0, 0)), lights=(laser,), **everywhere(sigma, 0.0, g)))
    integrand, line = stage.in_fog(), Line(stage, laser)
    u, weights = tensor(24)
    value = integrand.rest(integrand.first(pixels(), MIDDLE), None, u[:, None])[1] @ weights
    count = 2000
    v = (np.arange(count)[:, None] + 0.5) / count * laser.length
    light = line.start + v * line.axis - line.origin
    power = 3.0 * sigma * np.exp(-sigma * v) * laser.length / count
    # The light of each that fog scatters along the ray, by its angle.
    foot = light @ line.direction[:, None]
    gap = np.linalg.norm(light - foot * line.direction, axis=1)[:, None]
    low, high = np.arctan2(-foot, gap), np.arctan2(line.clip - foot, gap)
    x, w = gauss(48)
    angle = low + x * (high - low)
    t, r = foot + gap * np.tan(angle), gap / np.cos(angle)
    towards = (t[..., None] * line.direction - light[:, None]) / r[..., None]
    radiance = henyey_greenstein(towards @ line.axis, g) * henyey_greenstein(-towards @ line.direction, g)
    radiance = radiance * power * sigma * np.exp(-sigma * (r + t)) * (high - low) / gap
    assert value[0] == pytest.approx((radiance @ w).sum(), rel=1e-4)


def test_fog_in_a_box_scatters_only_there():
    laser = beam((-4, 0.1, 0.2), (0, 0.15, 0.1), 2.0)
    fog = scenes.box((-1, -1, -1), (1, 1, 1), volume=0, surface=False)
    camera = pinhole((0.3, -5, 0.4), (0.1, 0, -0.2))
    stage = Stage(Scene(camera, (fog,), lights=(laser,), volumes=(Volume(0.5, 0.2, 0.3),)))
    integrand, line = stage.in_fog(), Line(stage, laser)
    u, weights = tensor(24)
    value = integrand.rest(integrand.first(pixels(), MIDDLE), None, u[:, None])[1] @ weights

    def within(origin: np.ndarray, direction: np.ndarray) -> tuple[float, float]:
        a, b = (-1 - origin) / direction, (1 - origin) / direction
        return np.minimum(a, b).max(), np.maximum(a, b).min()

    (t0, t1), (v0, v1) = within(line.origin, line.direction), within(line.start, line.axis)

    def twice_scattered(t: float, v: float) -> float:
        towards, r = line.between(t, v)
        phases = henyey_greenstein(towards @ line.axis, 0.3) * henyey_greenstein(
            -towards @ line.direction, 0.3
        )
        return phases * np.exp(-0.7 * (t - t0 + v - v0 + r)) / r**2

    wanted = 2 * 0.25 * dblquad(twice_scattered, v0, v1, t0, t1, epsrel=1e-6)[0]
    assert value[0] == pytest.approx(wanted, rel=1e-5)


def behind_a_ball(**fields: Any) -> Stage:
    camera = Camera.look_at((0, -6, 3), (0, 0, 0.7), 12, 12)
    meshes = (
        scenes.floor(6),
        scenes.sphere((-0.8, 0, 0.8), 0.8),
        scenes.box((0.5, -0.5, 0), (1.5, 0.5, 1.2)),
    )
    laser = beam((-3, 1.5, 1.5), (3, 1.2, 1.2), (1, 2, 3), length=8)
    return Stage(Scene(camera, meshes, lights=(laser,), **everywhere(0.1, 0.02, 0.3)))


@pytest.mark.parametrize("name", MAPS)
def test_samples_behind_an_occluder_are_unbiased(name):
    stage, where = behind_a_ball(), pixels(12, 12)
    reference = in_middles(stage.in_fog(), where)[0]
    integrand, means = stage.in_fog(name), []
    for seed in range(24):
        rays = integrand.first(where, np.full((2, len(where), 1), 0.5))
        u = net(where, 16, seed)
        value = integrand.rest(rays, None, u if rays.lane is None else u[:, rays.lane])[1]
        means.append(value[0].mean() * len(rays.origin[0]) / len(where))
    error = np.std(means, ddof=1) / np.sqrt(len(means))
    assert abs(np.mean(means) - reference.mean()) < 4 * error + 5e-4 * reference.mean()


@pytest.mark.parametrize("dimensions", [1, 2])
def test_points_of_a_ray_are_the_same_together_and_alone(dimensions):
    stage, where = behind_a_ball(), pixels(12, 12)
    integrand = stage.in_fog() if dimensions == 2 else stage.on_surfaces()
    rays = integrand.first(where, np.full((2, len(where), 1), 0.5))
    count = len(where) if rays.lane is None else len(rays.lane)
    u = np.random.default_rng(5).random((dimensions, count, 4))
    together = integrand.rest(rays, None, u)[1].reshape(3, count, 4)
    lane = np.tile(np.arange(count), 4)
    alone = integrand.rest(rays, lane, u.transpose(0, 2, 1).reshape(dimensions, -1))[1].reshape(3, 4, count)
    np.testing.assert_allclose(together, alone.transpose(0, 2, 1), rtol=1e-5, atol=1e-9)
    assert together.any()


def test_one_fog_needs_no_thought(monkeypatch):
    stage, where = behind_a_ball(), pixels(12, 12)
    ours = in_middles(stage.in_fog(), where, 16)
    monkeypatch.setattr(RaySegments, "meets", lambda *_: False)
    np.testing.assert_allclose(ours, in_middles(stage.in_fog(), where, 16), rtol=1e-5, atol=1e-9)


def test_another_fog_between_is_not_overlooked():
    big = scenes.box((-9, -9, -9), (9, 9, 9), volume=0, surface=False)
    small = scenes.box((-0.5, -2, -3), (0.5, 2, 3), volume=1, surface=False)
    laser, camera = beam((2, -3, 0.3), (2, 3, 0.2), length=5.0), pinhole((-2, -4, 0), (-2, 0, 0.1))
    volumes = Volume(0.1), Volume(0.0, 5.0)
    scene = Scene(camera, (big, small), lights=(laser,), volumes=volumes)
    without = Scene(camera, (big,), lights=(laser,), volumes=volumes)
    dim, bright = (in_middles(Stage(s).in_fog(), pixels(), 256) for s in (scene, without))
    assert (dim < 0.9 * bright).all() and (dim > 0).all()


def test_fog_behind_glass_is_as_dark_as_the_glass():
    def value(*tints: float) -> np.ndarray:
        glass = [scenes.box((-9, -3.1 - i, -9), (9, -3 - i, 9), materials=i) for i in range(len(tints))]
        # No shadows, or the glass would colour what crosses it on the way, too.
        laser = beam((-1, 0.4, 0.5), (1, 0.7, -0.2), 3.0, length=2.0, radius=0.3, casts_shadow=False)
        fog = scenes.box((-4, -2, -4), (4, 4, 4), volume=0, surface=False)
        materials = [Material(surface=Transparent((t, t, t))) for t in tints]
        camera = pinhole((0, -6, 0.5), (0, 0.55, 0.15))
        scene = Scene(camera, (*glass, fog), materials, (laser,), volumes=(Volume(0.4),))
        stage = Stage(scene)
        return np.array(
            [in_middles(stage.in_fog(), pixels(), 64), stage.seen().first(pixels(), MIDDLE).values]
        )

    clear, dark = value(1.0), value(0.5)
    assert (clear > 0).all()
    # In at one side, and out at the other.
    np.testing.assert_allclose(dark, 0.25 * clear, rtol=1e-4)
