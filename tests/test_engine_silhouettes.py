# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels in which one thing ends before another: found, followed, and looked for where something is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import box, clouds, floor, sphere

from engine_core import Camera, Material, Mesh, PointLight, Scene, Volume, World
from engine_core.integration.mapping import in_order
from engine_core.transport import silhouettes as module
from engine_core.transport.camera_rays import CameraRays
from engine_core.transport.direct_light import DirectLight
from engine_core.transport.silhouettes import of_bodies, silhouettes

CAMERA = Camera.look_at((0.2, -6, 1.2), (0, 0, 0.7), 48, 32, 0.8, clip_start=0.1)
LIGHT = PointLight(1.0, position=(-2.0, 1.5, 4.5))
FOG = Volume(scattering=0.12, absorption=0.02, anisotropy=0.3)


def scene(*meshes: Mesh) -> Scene:
    """Black things in fog everywhere."""
    return Scene(CAMERA, meshes, [Material(0.0)] * len(meshes), (LIGHT,), World(volume=0), volumes=[FOG])


def test_silhouettes_are_where_depth_jumps():
    made = DirectLight(scene(floor(8), box((-0.5, -0.5, 0.1), (0.5, 0.5, 1.1))))
    rays, surfaces = made.stage.rays, made.surfaces
    found, bodies = silhouettes(rays, surfaces, CAMERA.region, in_order, made.media)
    assert bodies is None  # it is everywhere
    x, y = (a.ravel() for a in np.indices((48, 32)))
    u = np.stack(np.meshgrid((np.arange(8) + 0.5) / 8, (np.arange(8) + 0.5) / 8)).reshape(2, 1, -1)
    u = np.repeat(u, len(x), axis=1).astype(np.float32)
    depth = surfaces.distance(*rays.rays(x, y, u), rays.reach).reshape(48, 32, -1)
    inverse = 1 / depth
    jump = (inverse.max(axis=2) - inverse.min(axis=2)) / inverse.max(axis=2) > 0.2
    grazing = np.indices((48, 32))[1] > 20  # the floor's horizon
    assert found[jump & ~grazing].mean() > 0.9
    assert found[~jump].mean() < 0.05


@pytest.mark.parametrize("seed", range(3))
def test_silhouettes_are_followed_between_the_corners_of_pixels(seed):
    """To the tips of needles, which are thinner than a pixel at their ends."""
    random = np.random.default_rng(seed)
    low = np.stack([np.linspace(-2, 2, 12), np.full(12, -2.0), np.full(12, 0.1)], axis=1)
    tips = low + random.uniform((-0.5, -0.5, 0.8), (0.5, 0.5, 2.0), (12, 3))
    corners = np.stack([low - (0.1, 0, 0), low + (0.1, 0, 0), tips], axis=1).reshape(-1, 3)
    needles = Mesh(corners, np.arange(36).reshape(-1, 3))
    made = DirectLight(scene(needles))
    rays, surfaces = made.stage.rays, made.surfaces
    found, _ = silhouettes(rays, surfaces, CAMERA.region, in_order)
    x, y = (a.ravel() for a in np.indices((48, 32)))
    # Of pixels that a needle covers a sixteenth of, all but the odd one.
    u = (np.stack(np.meshgrid(np.arange(16), np.arange(16))).reshape(2, 1, -1) + 0.5) / 16
    u = np.repeat(u, len(x), axis=1).astype(np.float32)
    hit = surfaces.distance(*rays.rays(x, y, u), rays.reach).reshape(48, 32, -1) < 100
    partly = (hit.mean(axis=2) > 1 / 16) & ~hit.all(axis=2)
    assert partly.sum() > 100 and found[partly].mean() > 0.98
    assert found[~hit.any(axis=2)].mean() < 0.1


def test_where_the_far_plane_cuts_a_surface_there_is_an_outline():
    """The world's fog goes on behind it."""
    camera = Camera.look_at((0, -10, 20), (0, 30, 0), 96, 64, 0.5, clip_end=60.0)
    made = DirectLight(replace(scene(floor(2000)), camera=camera))
    found = silhouettes(made.stage.rays, made.surfaces, camera.region, in_order)[0]
    x, y = (a.ravel() for a in np.indices((96, 64)))
    seen = np.isfinite(made.depth(x, y)).reshape(96, 64)
    last = seen.sum(axis=1).max()
    assert 8 < last < 60 and found[:, last - 2 : last + 2].any(axis=1).all()
    assert found.mean() < 0.05


@pytest.mark.parametrize("orthographic", [False, True])
def test_outlines_are_looked_for_where_something_is(orthographic, monkeypatch):
    """In front of the camera, beside it, about it and behind it."""
    random = np.random.default_rng(11)
    traced, rays_of = [0, 0], CameraRays.rays
    for _ in range(12):
        at, to = random.normal(size=(2, 3)) * (2, 2, 1)
        camera = Camera.look_at(at, to, 48, 32, 3.0 if orthographic else 0.8, clip_start=0.1)
        if orthographic:
            camera = replace(camera, projection="orthographic")
        ball = sphere(random.normal(size=3) * 2, random.uniform(0.2, 1.0))
        made = DirectLight(replace(scene(ball), camera=camera))
        found = []
        for everywhere in (False, True):

            def counted(rays, x, y, u, everywhere=everywhere):
                traced[everywhere] += u[0].size
                return rays_of(rays, x, y, u)

            with monkeypatch.context() as patch:
                patch.setattr(CameraRays, "rays", counted)
                if everywhere:
                    patch.setattr(module, "_about_all", lambda rays, vertices, low, high: (low, high))
                found.append(silhouettes(made.stage.rays, made.surfaces, camera.region, in_order)[0])
        np.testing.assert_array_equal(*found)
    assert traced[False] < 0.7 * traced[True]


def test_outlines_of_fog_are_where_bodies_differ():
    made = DirectLight(clouds(CAMERA, 0.4, LIGHT))
    rays, surfaces = made.stage.rays, made.surfaces
    surface, bodies = silhouettes(rays, surfaces, CAMERA.region, in_order, made.media)
    found = of_bodies(bodies)
    x, y = (a.ravel() for a in np.indices((48, 32)))
    u = (np.stack(np.meshgrid(np.arange(8), np.arange(8))).reshape(2, 1, -1) + 0.5) / 8
    u = np.repeat(u, len(x), axis=1).astype(np.float32)
    origins, directions = rays.rays(x, y, u)
    met = made.media.met(origins, directions, surfaces.distance(origins, directions, rays.reach))
    met = met.reshape(48, 32, -1)
    differ = (met != met[..., :1]).any(axis=2)
    assert found.sum() > 100 and bodies.any() and (bodies == 0).any()
    # But for what is between the corners, or just at one.
    assert found[differ].mean() > 0.85
    assert found[~differ].mean() < 0.04


@pytest.mark.parametrize("width, whole", [(9.0, True), (1.2, False)])
def test_fog_that_fills_the_picture_has_no_outline(width, whole):
    fog = box((-width, 1, -6), (width, 4, 6), volume=0, surface=False)
    made = DirectLight(Scene(CAMERA, (box(), fog), [Material(0.0)] * 2, (LIGHT,), volumes=[FOG]))
    bodies = silhouettes(made.stage.rays, made.surfaces, CAMERA.region, in_order, made.media)[1]
    assert (bodies is None) == whole
    assert whole or of_bodies(bodies).any()
