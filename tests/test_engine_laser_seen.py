# SPDX-License-Identifier: GPL-3.0-or-later
"""Beams and their spots as the camera sees them: against quadrature, energy, and edges."""

from __future__ import annotations

import numpy as np
import pytest
import scenes
from laser_stage import (
    MIDDLE,
    Line,
    Stage,
    beam,
    everywhere,
    from_above,
    henyey_greenstein,
    net,
    pinhole,
    pixels,
)

from engine_core import Camera, Material, Mesh, Scene
from engine_core.shading.closures import Diffuse


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
