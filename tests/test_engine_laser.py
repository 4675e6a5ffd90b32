# SPDX-License-Identifier: GPL-3.0-or-later
"""Lasers as a whole: where beams begin and end, how many points they have, and what may go wrong."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import scenes
from laser_stage import (
    MAPS,
    Stage,
    beam,
    everywhere,
    from_above,
    in_middles,
    net,
    pixels,
)

from engine_core import Camera, Laser, Material, Mesh, Scene, Settings, parts, render
from engine_core.shading.closures import Glossy, Transparent
from engine_core.transport.lasers import MOST, Stretch

STRETCH = Stretch(
    np.zeros(3), 0.0, np.eye(3)[0], 1.0, 0.01, np.ones(3), np.zeros((1, 1)), np.zeros((1, 1)), [],
    np.uint64(0), 0, Laser(1.0),
)  # fmt: skip


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
