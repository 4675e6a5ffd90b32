# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers: their four parts against quadrature and closed forms, energy, and what may go wrong."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
import scenes
from numpy.lib.stride_tricks import sliding_window_view
from scipy.integrate import dblquad, quad

from engine_core import Camera, Laser, Material, Mesh, Scene, Settings, Volume, World, parts, render
from engine_core.geometry.frame import frame_of
from engine_core.geometry.surfaces import Surfaces
from engine_core.geometry.triangles import gather_triangles
from engine_core.integration.integrand import values_at
from engine_core.integration.point_sets import SobolPoints
from engine_core.integration.rules import gauss
from engine_core.shading.closures import Add, Diffuse, Glossy, Transparent
from engine_core.transport import laser_on_surfaces
from engine_core.transport.around_light import AroundLight
from engine_core.transport.camera_hits import CameraStage, Pixels
from engine_core.transport.camera_rays import CameraRays
from engine_core.transport.laser_in_fog import LaserInFog, RaySegments
from engine_core.transport.laser_maps import (
    along_beam,
    along_ray,
    along_ray_as_in_thesis,
    foot_and_gap,
    passages,
)
from engine_core.transport.laser_on_surfaces import LaserOnSurfaces, Reflection
from engine_core.transport.laser_seen import LasersSeen
from engine_core.transport.lasers import MOST, Lasers, Stretch
from engine_core.transport.light_samples import SceneLights
from engine_core.transport.media import Media
from engine_core.transport.shadows import Shadows
from engine_core.transport.single_scattering import SingleScattering
from engine_core.transport.surface_shading import SurfaceShader

MAPS = {"point": along_ray, "thesis_2020": along_ray_as_in_thesis}


class Stage:
    """All that the parts of a scene's lasers share."""

    def __init__(self, scene: Scene, reflectance: float = 0.5) -> None:
        self.frame = frame_of(scene)
        triangles, _ = gather_triangles([mesh for mesh in scene.meshes if mesh.surface], self.frame)
        shader = SurfaceShader(scene.materials, triangles, self.frame)
        transmits = shader.transmits
        surfaces = Surfaces(triangles, transmits[triangles.material] if transmits.any() else None)
        self.media = Media.of(scene, self.frame)
        self.shadows = Shadows(surfaces, shader, 8)
        self.rays = CameraRays(scene.camera, self.frame)
        self.lasers = Lasers.of(scene, self.frame, self.media, self.shadows)
        lights = SceneLights([], shader, triangles)
        self.scattering = None
        if self.media is not None:
            self.scattering = SingleScattering(
                self.frame, self.media, lights, surfaces, shader, self.rays, Settings(threads=1)
            )
        self.hits = CameraStage(scene, self.frame, surfaces, shader, [], False, False, 8, self.media)
        self.reflection = Reflection(np.full((3, len(scene.materials)), reflectance), triangles.material)

    def in_fog(self, map: str = "point") -> LaserInFog:
        return LaserInFog(self.lasers, self.scattering, map, shifted=True)

    def on_surfaces(self) -> LaserOnSurfaces:
        return LaserOnSurfaces(
            self.lasers, self.hits, self.reflection, self.shadows, self.media, shifted=True
        )

    def seen(self) -> LasersSeen:
        return LasersSeen(self.lasers, self.rays, self.hits, self.reflection, self.shadows, self.scattering)


def pixels(width: int = 1, height: int = 1) -> Pixels:
    x, y = np.indices((width, height)).reshape(2, -1).astype(np.int32)
    return Pixels(x, y, np.zeros(len(x), np.int32))


def net(pixels_: Pixels, samples: int, seed: int = 0) -> np.ndarray:
    points = SobolPoints(range(2), seed, 3)
    points.prepare(samples)
    return points.points(pixels_.key(), 0, samples)


def tensor(order: int) -> tuple[np.ndarray, np.ndarray]:
    """Points (2, order^2) and weights of a Gauss-Legendre rule."""
    x, w = gauss(order)
    return np.stack([np.repeat(x, order), np.tile(x, order)]), np.outer(w, w).ravel()


def beam(start: Any, towards: Any, power: Any = 1.0, **fields: Any) -> Laser:
    back = np.subtract(start, towards, dtype=float)
    back /= np.linalg.norm(back)
    side = np.cross(back, np.eye(3)[np.abs(back).argmin()])
    side /= np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(back, side), back], axis=1)
    matrix[:3, 3] = start
    return Laser(power, light_to_world=matrix, **fields)


def pinhole(at: Any, towards: Any, **fields: Any) -> Camera:
    """A camera of one pixel that sees next to nothing but one ray."""
    camera = Camera.look_at(at, towards, 1, 1)
    return Camera(camera.camera_to_world, np.array(camera.viewplane) * 1e-6, 1, 1, **fields)


def everywhere(scattering: Any, absorption: Any = 0.0, g: float = 0.0) -> dict[str, Any]:
    """Fields of a scene that is full of fog."""
    return {"world": World(0, volume=0), "volumes": (Volume(scattering, absorption, g),)}


def henyey_greenstein(cos: float, g: float) -> float:
    return (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * cos) ** 1.5)


class Line:
    """The one camera ray of a `pinhole`, and the beam of a laser, in scene units and float64."""

    def __init__(self, stage: Stage, laser: Laser) -> None:
        origin, direction = stage.rays.rays(np.zeros(1, int), np.zeros(1, int), np.full((2, 1, 1), 0.5))
        self.origin = origin[0] / stage.frame.scale + stage.frame.origin
        self.clip = stage.rays.reach / stage.frame.scale * np.linalg.norm(direction[0].astype(float))
        self.direction = direction[0] / np.linalg.norm(direction[0].astype(float))
        self.start, self.axis = laser.light_to_world[:3, 3], -laser.light_to_world[:3, 2]

    def between(self, t: float, v: float) -> tuple[np.ndarray, float]:
        vector = self.origin + t * self.direction - self.start - v * self.axis
        r = np.linalg.norm(vector)
        return vector / r, r


MIDDLE = np.full((2, 1, 1), 0.5)

STRETCH = Stretch(
    np.zeros(3), 0.0, np.eye(3)[0], 1.0, 0.01, np.ones(3), np.zeros((1, 1)), np.zeros((1, 1)), [],
    np.uint64(0), 0, Laser(1.0),
)  # fmt: skip


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


def in_middles(integrand: LaserInFog | LaserOnSurfaces, where: Pixels, points: int = 1 << 12) -> np.ndarray:
    """(3, B) integrals in the pixels' middles."""
    net = SobolPoints(range(integrand.rest_dimensions), 0, 101)
    net.prepare(points)
    u = net.points(np.zeros(1, np.uint32), 0, points)[:, 0]
    middle = np.full((2, 1, 1), 0.5)
    stages = (integrand.first(where[n : n + 1], middle) for n in range(len(where)))
    each = [values_at(integrand, stage, 1, None, u)[:3].mean(axis=1) for stage in stages]
    return np.stack(each, axis=1)


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


# -- on surfaces ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_light_on_surfaces_is_the_integral_along_the_beam(seed):
    random = np.random.default_rng(seed)
    scattering, absorption = random.uniform(0.01, 0.6, 3), random.uniform(0, 0.3, 3)
    g, channel = random.uniform(-0.8, 0.8), seed % 3
    material = Material(0.5) if seed % 2 else Material(surface=Diffuse((0.5, 0.5, 0.5)))
    start = np.append(random.normal(size=2) * 2, random.uniform(0.5, 2))
    laser = beam(start, random.normal(size=3) * (2, 2, 0.3), random.uniform(1, 5, 3), length=4.0)
    camera = pinhole((0, -3, 3), (*random.uniform(-1, 1, 2), 0))
    fog = everywhere(scattering[None], absorption, [g])
    stage = Stage(Scene(camera, (scenes.floor(20),), (material,), (laser,), **fog))
    integrand, line = stage.on_surfaces(), Line(stage, laser)
    hits = integrand.first(pixels(), MIDDLE)
    u, weights = gauss(64)
    value = integrand.rest(hits, None, u[None, None])[1] @ weights
    point = hits.points.position[:, 0] / stage.frame.scale + stage.frame.origin
    sigma = scattering[channel] + absorption[channel]
    end = min(laser.length, start[2] / -line.axis[2]) if line.axis[2] < 0 else laser.length

    def onto_floor(v: float) -> float:
        vector = line.start + v * line.axis - point
        r = np.linalg.norm(vector)
        return (
            henyey_greenstein(-vector @ line.axis / r, g)
            * np.exp(-sigma * (v + r))
            / r**3
            * max(vector[2], 0)
        )

    wanted = quad(onto_floor, 0, end, epsabs=1e-13, epsrel=1e-8, limit=300)[0] * 0.5 / np.pi
    wanted *= (
        np.exp(-sigma * np.linalg.norm(point - line.origin)) * laser.power[channel] * scattering[channel]
    )
    assert value[channel] == pytest.approx(wanted, rel=1e-4)


@pytest.mark.parametrize(
    "roughness, diffuse, most",
    [
        (0.03, 0.0, 0.13),
        (0.2, 0.0, 0.13),
        (0.2, 0.4, 0.09),
        # Of no use to have points there.
        (0.03, 0.4, 0.03),
        (0.7, 0.0, 0.0225),
        (0.7, 0.4, 0.02),
    ],
)
def test_what_metal_mirrors_of_a_beam_is_no_matter_of_luck(roughness, diffuse, most):
    """A beam over a floor that shows it more or less sharply, in 32 places, by nets of 16 points."""
    closure = Add(Glossy((0.9,) * 3, roughness), Diffuse((diffuse,) * 3))
    laser, fog = beam((-5, 0.3, 0.8), (5, -0.2, 0.9), 1.0, length=10.0), everywhere(0.1, 0.0, 0.5)
    integrands = []
    for x in np.linspace(-3, 3, 32):
        camera = pinhole((0.2 * x, -3, 2), (x, -0.5, 0))
        scene = Scene(camera, (scenes.floor(20),), (Material(surface=closure),), (laser,), **fog)
        integrands.append(Stage(scene).on_surfaces())

    def values(u: np.ndarray) -> np.ndarray:
        """(32, N) at u (N,) in every place."""
        hits = [integrand.first(pixels(), MIDDLE) for integrand in integrands]
        found = [i.rest(h, None, u[None, None])[1][0] for i, h in zip(integrands, hits, strict=True)]
        return np.array(found, np.float64)

    # Evenly by the angle alone, which is another map.
    many = (np.arange(1 << 14) + 0.5) / (1 << 14)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(laser_on_surfaces, "MIRRORED", 0.0)
        wanted = values(many).mean(axis=1)
    np.testing.assert_allclose(values(many).mean(axis=1), wanted, rtol=2e-3)
    rng = np.random.default_rng(3)
    found = np.array([values((np.arange(16) + rng.random(16)) / 16).mean(axis=1) for _ in range(8)])
    assert np.sqrt(np.square(found / wanted - 1).mean()) < most


def test_errors_of_beams_that_are_alike_even_out():
    """Of eight in one place, by the same points."""
    laser, camera = beam((-3, 0.4, 0.5), (3, 0.4, 1.0), 1.0), pinhole((0, -4, 2), (0.3, 0.2, 0.3))
    occluder = scenes.sphere((0.0, 0.1, 0.5), 0.25)

    def wrong(beams: int) -> tuple[float, float]:
        """Relative deviations over nets of 8 points, of light in fog and on surfaces."""
        meshes = (occluder, scenes.floor(9))
        stage, found = Stage(Scene(camera, meshes, lights=(laser,) * beams, **everywhere(0.2))), []
        for integrand in (stage.in_fog(), stage.on_surfaces()):
            seen, values = integrand.first(pixels(), MIDDLE), []
            for seed in range(64):
                points = SobolPoints(range(integrand.rest_dimensions), seed, 3)
                points.prepare(8)
                u = points.points(pixels().key(), 0, 8)
                values.append(integrand.rest(seen, None, u)[1][0].mean())
            found.append(np.std(values) / np.mean(values))
        return found

    for one, eight in zip(wrong(1), wrong(8), strict=True):
        # A third if they were independent.
        assert eight < 0.5 * one


def test_polar_points_about_a_beams_end_are_unbiased_and_calm():
    camera = Camera.look_at((0, -6, 3), (0, 0, 0), 32, 32)
    laser = beam((-2, 0.4, 2), (0.21, -0.13, 0), 3.0)
    stage = Stage(Scene(camera, (scenes.floor(6),), lights=(laser,), **everywhere(0.1, 0.02, 0.3)))
    integrand = stage.on_surfaces()
    centre, _ = stage.rays.image_of(integrand.ends.centre)
    where = pixels(32, 32)
    where = where[(where.x == int(centre[0, 0])) & (where.y == int(centre[1, 0]))]

    def means(of: AroundLight | LaserOnSurfaces, samples: int) -> np.ndarray:
        values = []
        for seed in range(32):
            points = SobolPoints(range(3), seed, 3)
            points.prepare(samples)
            u = points.points(where.key(), 0, samples)
            values.append(of.rest(of.first(where, u[:2]), None, u[2:].reshape(1, samples, 1))[1][0].mean())
        return np.array(values)

    plain, polar = means(integrand, 1 << 13), means(AroundLight(integrand, centre[:, 0]), 1 << 9)
    error = np.hypot(np.std(plain, ddof=1), np.std(polar, ddof=1)) / np.sqrt(32)
    assert abs(plain.mean() - polar.mean()) < 4 * error
    assert np.std(polar) < 0.5 * np.std(means(integrand, 1 << 9))


# -- seen ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(12))
def test_the_beam_is_the_integral_along_its_chord(seed):
    random = np.random.default_rng(seed)
    scattering, absorption = random.uniform(0.1, 2, 3), random.uniform(0, 1, 3)
    g, channel = random.uniform(-0.8, 0.8), seed % 3
    laser = beam(
        random.normal(size=3), random.normal(size=3), random.uniform(1, 5, 3), length=3.0, radius=0.4
    )
    axis, start = -laser.light_to_world[:3, 2], laser.light_to_world[:3, 3]
    target = start + random.uniform(0, 3) * axis + 0.2 * random.normal(size=3)
    # Across, towards the laser, along its light, and from within it.
    away = [random.normal(size=3), 2 * axis + 0.1, -2 * axis + 0.1, 0.5 * axis][seed % 4]
    fog = everywhere(scattering[None], absorption, [g])
    stage = Stage(Scene(pinhole(target + 2 * away, target), lights=(laser,), **fog))
    line, sigma = Line(stage, laser), scattering[channel] + absorption[channel]

    def within(t: float) -> float:
        offset = line.origin + t * line.direction - line.start
        v = offset @ line.axis
        inside = 0 <= v <= laser.length and np.sum((offset - v * line.axis) ** 2) <= laser.radius**2
        return np.exp(-sigma * (t + v)) if inside else 0.0

    at = np.linspace(0, 12, 8001)
    wanted = np.mean([within(t) for t in at]) * 12 * laser.power[channel] * scattering[channel]
    wanted *= henyey_greenstein(-line.axis @ line.direction, g) / (np.pi * laser.radius**2)
    value = stage.seen().first(pixels(), MIDDLE).values[channel, 0]
    assert value == pytest.approx(wanted, rel=1e-2, abs=1e-9)


def from_above(width: int, size: float, **fields: Any) -> Camera:
    half = size / 2
    return Camera(
        scenes.place((0, 0, 4)), (-half, half, -half, half), width, width, projection="orthographic"
    )


@pytest.mark.parametrize("radius", [1e-4, 1e-2, 0.1, 0.5])
@pytest.mark.parametrize("g", [0.0, 0.7])
def test_light_that_leaves_a_short_beam_is_what_it_loses(radius, g):
    # In thin fog: power (1 - exp(-sigma l)) p, over the picture, whatever the radius.
    laser = beam((-1, -0.6, 0.1), (1.2, 0.7, -0.3), 5.0, radius=radius, length=2.5)
    sigma = 1e-3
    stage = Stage(Scene(from_above(16, 8.0), lights=(laser,), **everywhere(sigma, 0.0, g)))
    where = pixels(16, 16)
    mean, error = stage.seen().means(where, net(where, 64).astype(np.float64))
    cos = -laser.light_to_world[2, 2]
    wanted = 5.0 * -np.expm1(-sigma * 2.5) * henyey_greenstein(cos, g) * np.exp(-sigma * 4)
    assert mean[0].mean() * 64 == pytest.approx(wanted, rel=5e-3)
    assert error[0].max() < 0.1 * mean[0].max()


def test_pixels_see_the_same_beam_as_their_points_do():
    where = pixels(12, 12)
    laser = beam((-3, 1.5, 1.5), (3, 1.2, 1.2), (1, 2, 3), length=8, radius=0.15)
    scene = Scene(
        Camera.look_at((0, -6, 3), (0, 0, 0.7), 12, 12), lights=(laser,), **everywhere(0.1, 0.02, 0.3)
    )
    seen = Stage(scene).seen()
    mean, _ = seen.means(where, net(where, 256).astype(np.float64))
    plain = seen.first(where, net(where, 2048)).values.reshape(3, len(where), -1).mean(axis=2)
    np.testing.assert_allclose(mean, plain, rtol=0.05, atol=0.02 * plain.max())
    assert mean.mean() == pytest.approx(plain.mean(), rel=2e-3)


@pytest.mark.parametrize("radius", [1e-3, 0.02, 0.3])
@pytest.mark.parametrize("closure", [False, True])
def test_the_spot_reflects_the_whole_beam(radius, closure):
    material = Material(surface=Diffuse((0.5, 0.5, 0.5))) if closure else Material(0.5)
    laser = beam((-1.5, 0.2, 2), (0.31, 0.13, 0), (1, 2, 3), radius=radius)
    stage = Stage(Scene(from_above(16, 8.0), (scenes.floor(5),), (material,), (laser,)))
    where = pixels(16, 16)
    mean, _ = stage.seen().means(where, net(where, 256).astype(np.float64))
    np.testing.assert_allclose(mean.mean(axis=1) * 64 * np.pi / 0.5, (1, 2, 3), rtol=0.02)


def test_what_passes_an_edge_lights_what_is_behind():
    # Half of the beam falls on a table, the rest on the floor: from above all is seen.
    table = Mesh([[-5, -5, 1], [0.1, -5, 1], [0.1, 5, 1], [-5, 5, 1]], [[0, 1, 2], [0, 2, 3]])
    laser = beam((0.1, 0.3, 3), (0.1, 0.3, 0), 1.0, radius=0.3)
    stage = Stage(Scene(from_above(16, 8.0), (scenes.floor(5), table), (Material(0.5),), (laser,)))
    where = pixels(16, 16)
    mean, _ = stage.seen().means(where, net(where, 256).astype(np.float64))
    assert mean[0].mean() * 64 * np.pi / 0.5 == pytest.approx(1, rel=0.02)


# -- beams ---------------------------------------------------------------------------------------------


def test_beams_end_at_what_blocks_them():
    laser = beam((0.1, 0.2, 3), (0.1, 0.2, 0), 1.0)
    fog = everywhere(0.1)
    stage = Stage(Scene(from_above(4, 2.0), (scenes.floor(5),), lights=(laser,), **fog))
    (stretch,) = stage.lasers.stretches
    assert stretch.length / stage.frame.scale == pytest.approx(3, rel=1e-5)
    through = beam((0.1, 0.2, 3), (0.1, 0.2, 0), 1.0, casts_shadow=False, length=7.0)
    stage = Stage(Scene(from_above(4, 2.0), (scenes.floor(5),), lights=(through,), **fog))
    assert stage.lasers.stretches[0].length / stage.frame.scale == pytest.approx(7)


@pytest.mark.parametrize("off, reach", [(0.0, 4.0), (-1e-6, 4.0), (1e-6, 4.0), (-0.01, 0.01)])
def test_a_laser_that_touches_a_wall_shines_off_it(off, reach):
    """And does not pass it from behind."""
    walls = tuple(Mesh([[x, -9, -9], [x, 9, -9], [x, 0, 9]], [[0, 1, 2]]) for x in (-2, 2))
    laser = beam((-2 + off, 3.3, 1.7), (3, 3.3, 1.7), 1.0, radius=0.01)
    camera = Camera.look_at((0, -4, 2), (0, 3, 1.5), 16, 9)
    lasers = Stage(Scene(camera, walls, lights=(laser,), **everywhere(0.2))).lasers
    (stretch,) = lasers.stretches
    scale = stretch.radius / laser.radius
    assert stretch.length == pytest.approx(reach * scale, rel=1e-3)
    # Where its light ends, a whole disk does.
    assert max(points.shape[1] for points in lasers.beams[0].ends) == 41


def test_far_away_a_laser_that_touches_a_wall_shines_off_it():
    """Where single precision resolves less."""
    for x in (-1300.0, -1700.0):
        wall = Mesh([[x, -9, -9], [x, 9, -9], [x, 0, 9]], [[0, 1, 2]])
        laser = beam((x, 0.3, 0.7), (0, 0.3, 0.7), 1.0)
        camera = Camera.look_at((0, 0, 0), (0, 3, 0), 16, 9)
        fields = everywhere(1e-4)
        stage = Stage(Scene(camera, (scenes.sphere((0.0, 3.0, 0.0), 1.0), wall), lights=(laser,), **fields))
        assert stage.lasers.stretches[0].length > 100 * stage.frame.scale


@pytest.mark.parametrize("behind", [0.0, 3e-5, 7e-5])
def test_a_beam_off_a_wall_and_its_spot_are_both_there(behind):
    walls = tuple(Mesh([[x, -9, -9], [x, 9, -9], [x, 0, 9]], [[0, 1, 2]]) for x in (-2, -1.8))
    laser = beam((-2 - behind, 3.3, 1.7), (3, 3.3, 1.7), 1.0, in_fog=False, on_surfaces=False)
    camera = Camera.look_at((-1.9, -4, 1.7), (-1.85, 3.3, 1.7), 32, 32)
    scene = Scene(camera, walls, lights=(laser,), **everywhere(0.2))
    stage = Stage(scene)
    assert stage.lasers.stretches[0].length == pytest.approx(0.2 * stage.frame.scale, rel=1e-2)
    with_spot = render(scene, Settings(samples=1, threads=1)).laser
    beam_alone = render(
        dataclasses.replace(scene, lights=(dataclasses.replace(laser, spot=False),)),
        Settings(samples=1, threads=1),
    ).laser
    assert beam_alone.max() > 0 and with_spot.sum() > 1.05 * beam_alone.sum()


def test_rules_for_smooth_functions_know_nothing_of_shifts():
    """Three beams in one place are no more to integrate than one."""
    laser, camera = beam((-3, 0.4, 0.5), (3, 0.4, 1.0), 1.0), Camera.look_at((0, -5, 2), (0, 0, 0), 24, 16)

    def rays(lasers: int) -> int:
        lights = (dataclasses.replace(laser, in_fog=False, beam=False, spot=False),) * lasers
        scene = Scene(camera, (scenes.floor(9),), lights=lights, **everywhere(0.2))
        settings = Settings(samples=16, threads=1, integrator="quadrature")
        return render(scene, settings).statistics["shadow rays"]

    assert rays(3) < 4 * rays(1)


def test_more_lasers_have_fewer_points_each():
    def points(powers: list[float], samples: int = 1, fewest: int = 16) -> int:
        lasers = [Laser(power) for power in powers]
        stretches = [dataclasses.replace(STRETCH, laser=laser) for laser in lasers]
        return parts._points_of(stretches, 32, samples, fewest)

    assert points([1.0]) == points([1.0, 1e-6]) == points([1.0, 0.1]) == 32
    assert points([0.7] * 4) == points([0.1] * 64) == 16
    assert points([0.1] * 12, fewest=8) == points([0.7] * 12, fewest=8) == 8
    assert points([0.1] * 11, fewest=8) == 16
    # As the power of 2/3 of the samples.
    assert [points([1.0], samples) for samples in (1, 8, 64)] == [32, 128, 512]


def test_beams_pass_what_is_transparent_in_part():
    pane = scenes.floor(5, z=1.5, materials=1)
    materials = (Material(0.5), Material(surface=Transparent((0.25, 0.5, 1.0))))
    laser = beam((0.1, 0.2, 3), (0.1, 0.2, 0), 1.0)
    stage = Stage(Scene(from_above(4, 2.0), (scenes.floor(5), pane), materials, (laser,), **everywhere(0.1)))
    first, second = stage.lasers.stretches
    np.testing.assert_allclose(second.power / first.power, (0.25, 0.5, 1), rtol=1e-5)
    assert (first.length + second.length) / stage.frame.scale == pytest.approx(3, rel=1e-5)
    assert second.depth[0, 0] == pytest.approx(0.15, rel=1e-4)


def test_lasers_without_light_or_axis_are_left_out():
    camera = from_above(4, 2.0)
    assert Stage(Scene(camera, lights=(beam((0, 0, 1), (0, 0, 0), 0.0),))).lasers is None
    flat = Laser(1.0, light_to_world=np.diag([1.0, 1.0, 0.0, 1.0]), name="Flat")
    many = [beam((0, 0, 1), (0, 0, 0), 1.0 + i) for i in range(MOST + 1)]
    lasers = Stage(Scene(camera, lights=(flat, *many[:3]))).lasers
    assert len(lasers.beams) == 3 and "Flat" in lasers.messages[0]
    lasers = Stage(Scene(camera, lights=tuple(many))).lasers
    assert len(lasers.beams) == MOST and lasers.messages
    assert min(b.power[0] for b in lasers.beams) > 0


@pytest.mark.parametrize(
    "start, towards",
    [
        ((0, -6, 3), (0, 0, 0.7)),  # from the camera, along its view
        ((0, 0, 0.7), (0, -6, 3)),  # into it
        ((0, -5, 3), (0, 1, 0.7)),  # parallel
        ((0, -9, 4), (0, -12, 5)),  # behind
        ((0, -6, 3), (1, -6, 3)),  # across it
        ((-3, 0, 0.7), (3, 0, 0.7)),  # through the ray
        ((1, 1, 0), (3, 1, 0)),  # within the floor
    ],
)
@pytest.mark.parametrize("length", [1e-30, 2.0, np.inf])
def test_beams_in_odd_places_are_finite(start, towards, length):
    laser = beam(start, towards, 1.0, length=length, radius=0.0)
    camera = Camera.look_at((0, -6, 3), (0, 0, 0.7), 4, 4)
    stage = Stage(Scene(camera, (scenes.floor(5),), lights=(laser,), **everywhere(0.2, 0.1, 0.9999)))
    where = pixels(4, 4)
    u = np.array([[0.0, 0.5, 1.0, 0.3], [0.5, 0.5, 0.0, 1.0]])[:, None] * np.ones((2, len(where), 1))
    for map_ in MAPS:
        integrand = stage.in_fog(map_)
        rays = integrand.first(where, u)
        lanes = np.zeros(len(u[0].ravel()), int) if rays.lane is None else rays.lane
        value = integrand.rest(rays, None, np.resize(u, (2, len(lanes), 1)))[1]
        assert np.isfinite(value).all() and (value >= 0).all()
    assert np.isfinite(in_middles(integrand, where, 64)).all()
    integrand = stage.on_surfaces()
    hits = integrand.first(where, np.full((2, len(where), 1), 0.5))
    value = integrand.rest(hits, None, np.full((1, len(hits.points), 1), 0.5))[1]
    assert np.isfinite(value).all() and (value >= 0).all()
    seen = stage.seen()
    assert np.isfinite(seen.first(where, u).values).all()
    assert np.isfinite(seen.means(where, u)).all()
    for part in (integrand, seen):
        assert not part.counts["non-finite samples"]


def test_expected_light_that_single_precision_does_not_hold_makes_no_holes():
    camera = Camera.look_at((0, -6, 1), (0, 0, 0), 37, 29, 0.8)
    laser = beam((-3, 0, 0.3), (3, 0.2, 0.3), 3e39, in_fog=False, beam=False, spot=False)
    glossy = Material(surface=Glossy((0.9, 0.9, 0.9), 0.3))
    scene = Scene(camera, (scenes.floor(3, -1),), (glossy,), (laser,), **everywhere(0.1))
    assert np.isfinite(render(scene, Settings(samples=1, threads=1)).combined).all()


def test_what_a_bright_ball_is_wrong_by_is_not_seen_beside_it():
    """On a wall behind it, which gets a three-hundredth of its light."""
    wall = Mesh([[-9, 5, -9], [9, 5, -9], [9, 5, 9], [-9, 5, 9]], [[0, 1, 2], [0, 2, 3]])
    ball = scenes.sphere((0.0, 0.0, 0.0), 0.15)
    laser = beam((-4, 0.0, 0.19), (4, 0.0, 0.19), 3.0, in_fog=False, beam=False, spot=False)
    camera = Camera.look_at((0, -4, 0), (0, 0, 0), 64, 64, 0.5)
    scene = Scene(camera, (wall, ball), lights=(laser,), **everywhere(0.2))

    def picture(samples: int, seed: int) -> np.ndarray:
        return render(scene, Settings(samples=samples, seed=seed, threads=1)).combined[..., 0].astype(float)

    truth = picture(256, 0)
    wrong = np.array([picture(1, seed) for seed in range(4)]) - truth
    bright = truth > 2 * np.median(truth)
    reach = [sliding_window_view(np.pad(bright, n), (2 * n + 1,) * 2).any(axis=(2, 3)) for n in (2, 12)]
    beside = reach[1] & ~reach[0]
    assert np.sqrt(np.square(wrong[:, beside]).mean()) < 0.1 * np.median(truth)
    assert np.abs(wrong[:, beside]).max() < 0.4 * np.median(truth)


def test_scale_changes_nothing():
    def picture(scale: float) -> list[np.ndarray]:
        camera = Camera.look_at(np.array((0, -6, 3)) * scale, np.array((0, 0, 0.7)) * scale, 6, 6)
        camera = Camera(
            camera.camera_to_world, camera.viewplane, 6, 6, clip_start=0.1 * scale, clip_end=50 * scale
        )
        meshes = (scenes.floor(6 * scale), scenes.sphere((-0.8 * scale, 0, 0.8 * scale), 0.8 * scale))
        laser = beam(
            np.array((-3, 1.5, 1.5)) * scale,
            np.array((3, 1.2, 1.2)) * scale,
            2 * scale**2,
            radius=0.1 * scale,
        )
        stage = Stage(Scene(camera, meshes, lights=(laser,), **everywhere(0.1 / scale, 0.02 / scale, 0.3)))
        where = pixels(6, 6)
        hits = stage.on_surfaces().first(where, np.full((2, 36, 1), 0.5))
        return [
            in_middles(stage.in_fog(), where, 256),
            stage.on_surfaces().rest(hits, None, np.full((1, len(hits.points), 1), 0.4))[1],
            stage.seen().means(where, net(where, 16).astype(np.float64))[0],
        ]

    for ours, theirs in zip(picture(1.0), picture(4096.0), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-4, atol=1e-5 * np.abs(ours).max())
