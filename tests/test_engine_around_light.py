# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels about lights and beams in the picture: which they are, and polar points that cover them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import place
from test_engine_fog_pictures import CAMERA, INSIDE, scene

from engine_core import PointLight, Settings, SpotLight
from engine_core.parts import parts_of
from engine_core.transport.around_light import lit_angles, peaks, polar, tamed, wedges
from engine_core.transport.camera_hits import Pixels
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.ray_rule import ScatteredAlongRay
from engine_core.transport.scattered_light import in_cone


@pytest.mark.parametrize("corner", [(0.2, 0.3), (-0.5, -0.5), (0, 0), (-1, 0), (3, -5), (1e-9, -0.5)])
def test_polar_points_cover_a_pixel_and_take_the_pole_away(corner):
    x, y = (np.array([c]) for c in corner)
    n = 400
    u = np.stack(np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)).reshape(2, 1, -1)
    place, weight = polar(x, y, u)
    at = place.astype(np.float64) + np.array(corner)[:, None, None]
    assert weight.mean() == pytest.approx(1, rel=2e-3)
    np.testing.assert_allclose((place * weight).mean(axis=(1, 2)), 0.5, rtol=5e-3)

    def edge(a, b):
        """The integral of 1 / r over the triangle of the origin and the edge from a to b."""
        along = (b - a) / np.linalg.norm(b - a)
        height = a[0] * along[1] - a[1] * along[0]
        return (
            0
            if height == 0
            else height * (np.arcsinh(b @ along / abs(height)) - np.arcsinh(a @ along / abs(height)))
        )

    corners = np.array(corner) + np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    exact = sum(edge(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True))
    assert (weight / np.hypot(*at)).mean() == pytest.approx(exact, rel=2e-3)


@pytest.mark.parametrize("corner", [(0.2, 0.3), (-0.5, -0.5), (-1, 0), (3, -5)])
@pytest.mark.parametrize("lit", [(0.3, -0.2, 0.4), (-2.9, -1.2, 1.5), (np.pi, -0.01, 0.01)])
def test_polar_points_of_a_beam_cover_what_of_a_pixel_is_in_it(corner, lit):
    x, y = (np.array([c]) for c in corner)
    u = np.stack(np.meshgrid((np.arange(400) + 0.5) / 400, (np.arange(400) + 0.5) / 400)).reshape(2, 1, -1)
    place, weight = polar(x, y, u, lit)

    def inside(place, slack):
        angle = np.arctan2(place[1] + corner[1], place[0] + corner[0])
        turned = np.remainder(angle - lit[0] + np.pi, 2 * np.pi) - np.pi
        return (turned > lit[1] - slack) & (turned < lit[2] + slack)

    assert inside(place, 1e-3)[weight > 0].all()
    middle = (np.indices((1000, 1000)).reshape(2, 1, -1) + 0.5) / 1000
    assert weight.mean() == pytest.approx(inside(middle, 0).mean(), rel=5e-3, abs=2e-4)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_directions_in_which_a_beam_is_lit(projection, seed):
    """In none beside them, and in those within a step of all."""
    random = np.random.default_rng(seed)
    turn = random.uniform(-np.pi, np.pi, 3)
    beam = SpotLight(9.0, light_to_world=place(INSIDE, turn), angle=random.uniform(0.1, 0.8))
    camera = replace(CAMERA, projection=projection, viewplane=(-0.6, 0.6, -0.4, 0.4))
    if projection == "orthographic":
        camera = replace(camera, viewplane=(-3, 3, -2, 2))
    made = replace(scene(beam), camera=camera)
    around = parts_of(made, DirectLight(made), Settings(), lambda: None)[0].by
    scattering = around.own[0]._integrand._scattering
    step, cones = 2 * np.pi / 256, scattering.cones
    angle = (np.arange(256) + 0.5) * step
    at = around.blocks[0].centre[:, None] + 6 * np.stack([np.cos(angle), np.sin(angle)])
    origin, direction = scattering.rays.exactly(*at)
    direction = direction / np.linalg.norm(direction, axis=0)
    cone = (np.repeat(x[..., :1].astype(float), 256, axis=-1) for x in (cones.apex, cones.axis, cones.cos))
    first, last = in_cone(*cone, origin, direction)
    seen = last > np.maximum(first, 0)
    lit = lit_angles(scattering.rays, scattering.lights, scattering.cones, 0)
    turned = np.remainder(angle - lit[0] + np.pi, 2 * np.pi) - np.pi
    assert not seen[(turned < lit[1]) | (turned > lit[2])].any()
    assert seen[(turned > lit[1] + step) & (turned < lit[2] - step)].all()


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_lights_that_are_larger_in_the_picture_than_a_block_have_none(projection):
    """A block within an area light's image was seen as a noisy square."""
    camera = replace(CAMERA, projection=projection)
    if projection == "orthographic":
        camera = replace(camera, viewplane=(-3, 3, -2, 2))

    def lit_blocks(radius: float) -> list[int]:
        lights = [PointLight(60.0, position=INSIDE), PointLight(60.0, position=(1, 1, 1), radius=radius)]
        made = replace(scene(*lights), camera=camera)
        around = parts_of(made, DirectLight(made), Settings(), lambda: None)[0].by
        return sorted(block.light for block in around.blocks)

    assert lit_blocks(0.02) == [0, 1]
    assert len(lit_blocks(1.5)) == 1


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_all_pixels_where_a_light_is_tamed_are_about_it(projection, seed):
    """A point and a beam in wide pictures: what no block has is as bright with tamed lights as without."""
    random = np.random.default_rng(seed)
    lights = (
        PointLight(60.0, position=(random.uniform(-2, 2), 1.0, random.uniform(0.2, 2.5))),
        SpotLight(9.0, light_to_world=place(INSIDE, random.uniform(-np.pi, np.pi, 3)), angle=0.4),
    )
    half = (3, 2) if projection == "orthographic" else (1.5, 1.0)
    plane = (-half[0], half[0], -half[1], half[1])
    made = replace(scene(*lights), camera=replace(CAMERA, projection=projection, viewplane=plane))
    around = parts_of(made, DirectLight(made), Settings(), lambda: None)[0].by
    scattering = around.own[0]._integrand._scattering
    beams = wedges(scattering.rays, scattering.lights, scattering.cones, np.arange(2))
    found, calm = peaks(scattering.rays, scattering.lights, beams, np.arange(2), CAMERA.region)
    x, y = (a.ravel().astype(np.int32) for a in np.indices((48, 32)))
    about = np.zeros((2, 48, 32), bool)
    for block in found:
        about[block.light, block.x, block.y] = True
    u = random.random((2, len(x), 4)).astype(np.float32)
    rays = around.own[0]._integrand.first(Pixels(x, y, np.zeros_like(x)), u)
    assert rays.lane is None
    for k, at in enumerate(about):
        alone = (ScatteredAlongRay(scattering, np.array([k]), tamed=t) for t in (None, calm))
        whole, tamed = (one.along(rays, None)[0].sum(axis=0).reshape(48, 32, 4) for one in alone)
        differs = np.abs(whole - tamed).max(axis=2) > 1e-6 * whole.mean()
        assert differs[at].any() and not differs[~at].any()


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_all_pixels_where_a_narrow_beam_is_tamed_are_known(projection, seed):
    """Of a spot that is in the picture or not, in any direction."""
    random = np.random.default_rng(seed)
    turn, at = random.uniform(-np.pi, np.pi, 3), random.uniform((-5, -1, -1), (5, 2, 4))
    beam = SpotLight(9.0, light_to_world=place(at, turn), angle=random.choice([0.003, 0.03, 0.2]))
    half = (3, 2) if projection == "orthographic" else (0.6, 0.4)
    plane = (-half[0], half[0], -half[1], half[1])
    made = replace(scene(beam), camera=replace(CAMERA, projection=projection, viewplane=plane))
    scattering = parts_of(made, DirectLight(made), Settings(), lambda: None)[-1].by.whole._scattering
    beams = wedges(scattering.rays, scattering.lights, scattering.cones, np.arange(1))
    calm = tamed(scattering.rays, scattering.lights, beams, [], CAMERA.region)
    x, y = (a.ravel().astype(np.int32) for a in np.indices((48, 32)))
    u = random.random((2, len(x), 16)).astype(np.float32)
    alone = [ScatteredAlongRay(scattering, tamed=t) for t in (None, calm)]
    rays = alone[0].first(Pixels(x, y, np.zeros_like(x)), u)
    whole, less = (one.along(rays, None)[0].sum(axis=0).reshape(48, 32, 16) for one in alone)
    differs = np.abs(whole - less).max(axis=2) > 1e-6 * max(whole.mean(), 1e-30)
    assert not differs[~calm.beams].any()
    if calm.whole.any() and whole[calm.beams].any():
        assert differs.any() and calm.beams.sum() < 0.7 * calm.beams.size
