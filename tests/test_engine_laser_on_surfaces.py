# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that fog scatters out of beams onto surfaces: against quadrature, and how little of it is luck."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scenes
from laser_stage import (
    MIDDLE,
    Line,
    Stage,
    beam,
    everywhere,
    henyey_greenstein,
    pinhole,
    pixels,
)
from numpy.lib.stride_tricks import sliding_window_view
from scipy.integrate import quad

from engine_core import Camera, Material, Mesh, Scene, Settings, render
from engine_core.integration.point_sets import SobolPoints
from engine_core.integration.rules import gauss
from engine_core.shading.closures import Add, Diffuse, Glossy
from engine_core.transport import laser_on_surfaces
from engine_core.transport.around_light import AroundLight
from engine_core.transport.laser_on_surfaces import LaserOnSurfaces


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


def test_a_wall_that_a_laser_touches_is_calm_about_it():
    """And a laser that hangs before it has no samples of its own there."""
    wall = Mesh([[-9, 2, -9], [9, 2, -9], [9, 2, 9], [-9, 2, 9]], [[0, 1, 2], [0, 2, 3]])
    camera = Camera.look_at((0, -4, 1), (0, 2, 0.5), 32, 24, 0.7)

    def pictures(start: float, seeds: int) -> tuple[np.ndarray, str]:
        laser = beam((0.23, start, 0.41), (1.5, -9, 0.6), 3.0, in_fog=False, beam=False, spot=False)
        scene = Scene(camera, (wall,), lights=(laser,), **everywhere(0.2))
        films = [render(scene, Settings(samples=1, seed=seed, threads=1)) for seed in range(seeds)]
        told = films[0].statistics.get("surfaces where lasers end", "")
        return np.array([film.combined[..., 0] for film in films], np.float64), told

    touching, told = pictures(2.0, 8)
    assert told == "sampled around 1"
    brightest = np.unravel_index(touching.mean(axis=0).argmax(), touching.shape[1:])
    assert np.std(touching[:, *brightest]) < 0.04 * touching.mean(axis=0)[brightest]
    assert pictures(1.0, 1)[1] == ""


def test_rules_for_smooth_functions_know_nothing_of_shifts():
    """Three beams in one place are no more to integrate than one."""
    laser, camera = beam((-3, 0.4, 0.5), (3, 0.4, 1.0), 1.0), Camera.look_at((0, -5, 2), (0, 0, 0), 24, 16)

    def rays(lasers: int) -> int:
        lights = (dataclasses.replace(laser, in_fog=False, beam=False, spot=False),) * lasers
        scene = Scene(camera, (scenes.floor(9),), lights=lights, **everywhere(0.2))
        settings = Settings(samples=16, threads=1, integrator="quadrature")
        return render(scene, settings).statistics["shadow rays"]

    assert rays(3) < 4 * rays(1)


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
