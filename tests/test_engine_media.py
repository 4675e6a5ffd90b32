# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog along rays: what is inside what, and how much light is left."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import box, sphere

from engine_core import (
    Camera,
    Mesh,
    RenderError,
    Scene,
    Volume,
    World,
)
from engine_core.geometry import boundaries
from engine_core.geometry.frame import Frame
from engine_core.geometry.near_balls import NearBalls
from engine_core.transport.media import DIRECT, Media

CAMERA = Camera.look_at((0, -6, 0), (0, 0, 0), 4, 4)


def media_of(*meshes: Mesh, volumes: Any, world: int = -1, scale: float = 1.0) -> Media:
    scene = Scene(CAMERA, meshes, world=World(volume=world), volumes=volumes)
    return Media.of(scene, Frame(np.zeros(3), scale))


def rays(count: int, seed: int, spread: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Random origins and directions, of all lengths."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-spread, spread, (count, 3))
    towards = rng.uniform(-1, 1, (count, 3))
    return origins.astype(np.float32), ((towards - origins) * rng.uniform(0.2, 3, (count, 1))).astype(
        np.float32
    )


def torus(major: float = 1.0, minor: float = 0.4, segments: int = 10, **fields: Any) -> Mesh:
    """A closed ring about the Z axis, which is not convex."""
    u, v = np.meshgrid(*2 * [2 * np.pi * np.arange(segments) / segments], indexing="ij")
    radius = major + minor * np.cos(v)
    vertices = np.stack([radius * np.cos(u), radius * np.sin(u), minor * np.sin(v)], -1).reshape(-1, 3)
    i, j = np.indices((segments, segments))
    a = i * segments + j
    b = (i + 1) % segments * segments + j
    c = (i + 1) % segments * segments + (j + 1) % segments
    d = i * segments + (j + 1) % segments
    triangles = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return Mesh(vertices, triangles, name="Torus", **fields)


def winding(points: np.ndarray, mesh: Mesh) -> np.ndarray:
    """(N,) times that a closed mesh encloses points (N, 3), by solid angles (van Oosterom and Strackee)."""
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(float) - points[:, None] for k in range(3))
    x, y, z = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    up = (a * np.cross(b, c)).sum(-1)
    down = x * y * z + (a * b).sum(-1) * z + (b * c).sum(-1) * x + (c * a).sum(-1) * y
    return np.round(np.arctan2(up, down).sum(axis=1) / (2 * np.pi))


def chord(low: Any, high: Any, origins: np.ndarray, directions: np.ndarray, end: Any = np.inf) -> np.ndarray:
    """Lengths of rays within a box."""
    o, d = origins.astype(float), directions.astype(float)
    a, b = (np.asarray(low) - o) / d, (np.asarray(high) - o) / d
    start, stop = np.maximum(np.minimum(a, b).max(axis=1), 0), np.minimum(np.maximum(a, b).min(axis=1), end)
    return np.maximum(stop - start, 0) * np.linalg.norm(d, axis=1)


@pytest.mark.parametrize("traced", (False, True))
@pytest.mark.parametrize("reach", (0.7, np.inf))
def test_depth_through_a_box_is_its_chord(
    traced: bool, reach: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    if traced:
        monkeypatch.setattr(boundaries, "FEW_PLANES", 0)
    low, high = (-1, -0.5, -0.25), (0.75, 1.0, 0.5)
    media = media_of(box(low, high, volume=0), volumes=(Volume((0.3, 0.6, 0.9), 0.1),))
    origins, directions = rays(4000, 1)
    depth = media.optical_depth(origins, directions, reach)
    length = chord(low, high, origins, directions, reach)
    assert depth.shape == (3, 4000) and (length > 0).mean() > 0.4
    np.testing.assert_allclose(depth, np.array([[0.4], [0.7], [1.0]]) * length, atol=3e-6)
    along = media.along(origins, directions, reach)
    np.testing.assert_allclose(along.total, depth, atol=1e-6)


@pytest.mark.parametrize("traced", (False, True))
def test_depth_through_nested_and_overlapping_bodies_is_that_of_brute_force(
    traced: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if traced:
        monkeypatch.setattr(boundaries, "FEW_PLANES", 0)
    meshes = [
        sphere((0, 0, 0), 1.5, segments=8, volume=0),
        box((-0.6, -0.6, -0.6), (0.5, 0.4, 0.7), volume=1),
        torus(volume=2),
        replace(
            box((0.2, 0, 0), (2.0, 0.9, 0.8), volume=1), triangles=box().triangles[:, ::-1]
        ),  # inside out
    ]
    volumes = (Volume(0.5, anisotropy=0.3), Volume((0.1, 0.2, 0.4)), Volume(0, (0.3, 0, 0.1)))
    media = media_of(*meshes, volumes=volumes)
    origins, directions = rays(32, 2)
    along = media.along(origins, directions, 1.5)
    length = np.linalg.norm(directions.astype(float), axis=1)
    # Between crossings nothing changes: what is inside at each segment's middle, and what is not in between.
    middle = (along.start + along.end) / 2 / length[along.ray]
    points = origins[along.ray] + directions[along.ray] * middle[:, None].astype(np.float32)
    signs = np.array([1, 1, 1, -1])
    within = np.stack([winding(points, mesh) * sign for mesh, sign in zip(meshes, signs, strict=True)]) > 0
    bits = (within * (1 << np.arange(4))[:, None]).sum(axis=0)
    np.testing.assert_array_equal(bits, along.inside)
    assert len(np.unique(bits)) > 5
    extinction = np.array([volumes[mesh.volume].extinction for mesh in meshes])
    np.testing.assert_allclose(media.extinction[:, along.mixture], (within.T @ extinction).T, rtol=1e-6)
    # Depth by a fine sum of points.
    t = (np.arange(150) + 0.5) / 150 * 1.5
    points = (origins[:, None] + directions[:, None] * t[:, None]).reshape(-1, 3)
    inside = np.stack([winding(points, mesh) * sign > 0 for mesh, sign in zip(meshes, signs, strict=True)])
    depth = (inside.T @ extinction).reshape(32, 150, 3).sum(axis=1).T * (1.5 / 150 * length)
    for found in (along.total, media.optical_depth(origins, directions, 1.5)):
        assert np.abs(found - depth).max() < 0.03 * depth.max()
        assert abs(found.mean() / depth.mean() - 1) < 4e-3
    at_end = origins + directions * np.float32(1.5)
    ends = np.stack([winding(at_end, mesh) * sign > 0 for mesh, sign in zip(meshes, signs, strict=True)])
    np.testing.assert_array_equal((ends * (1 << np.arange(4))[:, None]).sum(axis=0), along.state)


def edge_rays(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Rays through edges and corners of the box from -1 to 1, along its sides, and just beside them."""
    rng = np.random.default_rng(seed)
    at = rng.choice([-1.0, 1.0], (count, 3))
    at[: count // 2, 0] = rng.uniform(-1, 1, count // 2)
    away = rng.uniform(-1, 1, (count, 3))
    away[rng.random((count, 3)) < 0.4] = 0
    away[~away.any(axis=1)] = (0, 0, 1)
    at += rng.choice([0, 1e-7, -1e-7, 1e-5], (count, 1)) * rng.uniform(-1, 1, (count, 3))
    return (at - 2 * away).astype(np.float32), away.astype(np.float32)


@pytest.mark.parametrize("traced", (False, True))
def test_rays_along_edges_stay_in_a_body_no_longer_than_it_is(
    traced: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if traced:
        monkeypatch.setattr(boundaries, "FEW_PLANES", 0)
    media = media_of(box(volume=0), volumes=(Volume(1.0),))
    origins, directions = edge_rays(4000, 3)
    with np.errstate(divide="ignore", invalid="ignore"):
        inner = np.nan_to_num(chord((-0.9999,) * 3, (0.9999,) * 3, origins, directions))
        outer = np.nan_to_num(chord((-1.0001,) * 3, (1.0001,) * 3, origins, directions))
    depth = media.optical_depth(origins, directions, np.inf)[0]
    assert (depth >= inner - 1e-4).all()
    assert (depth <= outer + 1e-4).all()
    assert (media.along(origins, directions, np.inf).state == 0).all()


def test_faces_that_coincide_leave_no_slivers() -> None:
    # Two boxes face to face, one around both, and one twice.
    left, right = box((-1, -1, -1), (0.1, 1, 1), volume=0), box((0.1, -1, -1), (1, 1, 1), volume=1)
    media = media_of(
        left, right, box(volume=2), box(volume=2), volumes=(Volume(1.0), Volume(2.0), Volume(0.25))
    )
    origins, directions = rays(2000, 4, 0.99)
    origins[:, 0] = -2
    directions = (np.array([[2, 0, 0]]) + 0.2 * directions).astype(np.float32)
    along = media.along(origins, directions, 4.0)
    assert set(along.inside) <= {0b1101, 0b1110}
    assert np.bincount(along.ray).max() <= 2
    a = chord((-1, -1, -1), (0.1, 1, 1), origins, directions)
    b = chord((0.1, -1, -1), (1, 1, 1), origins, directions)
    np.testing.assert_allclose(along.total[0], 1.5 * a + 2.5 * b, atol=1e-5)
    np.testing.assert_allclose(
        along.depth[0][along.inside == 0b1110], 1.5 * a[along.ray[along.inside == 0b1110]], atol=1e-5
    )


def test_rays_begin_inside_or_outside() -> None:
    media = media_of(
        sphere((0, 0, 0), 1.0, segments=64, volume=0),
        box((-2, -2, -2), (2, 2, 2), volume=0),
        volumes=(Volume(0.5),),
    )
    x = np.array([-3, -1.5, 0, 1.5, 3], np.float32)
    origins = np.stack([x, 0.01 + 0 * x, 0.02 + 0 * x], axis=1)
    along = media.along(origins, np.array([[2, 0, 0]], np.float32), np.inf)
    assert media.grey and along.total.shape == (1, 5)
    np.testing.assert_allclose(along.total[0], 0.5 * np.array([6, 5.5, 3, 0.5, 0]), atol=0.01)
    np.testing.assert_array_equal(along.ray, [0, 0, 0, 1, 1, 1, 2, 2, 3])
    np.testing.assert_allclose(along.start, [1, 2, 4, 0, 0.5, 2.5, 0, 1, 0], atol=0.01)
    np.testing.assert_array_equal(along.inside, [2, 3, 2, 2, 3, 2, 3, 2, 2])
    near = media.along(origins, np.array([[2, 0, 0]], np.float32), 1.0)  # two units on
    np.testing.assert_array_equal(near.state, [2, 3, 2, 0, 0])


@pytest.mark.parametrize("length", (1e-12, 1.0, 1e19, 1e30))
def test_rays_of_any_length_come_to_an_end(length: float) -> None:
    """Squares of float32 overflow from 2e19 on."""
    media = media_of(sphere((0, 0, 0), 1.0, segments=16, volume=0), volumes=(Volume(0.5),))
    origins = np.array([[0.01, 0.02, -3], [0.01, 0.02, 0], [0.01, 0.02, 3]], np.float32)
    directions = np.array([[0, 0, length]], np.float32).repeat(3, axis=0)
    depth = media.optical_depth(origins, directions, np.inf)
    np.testing.assert_allclose(depth[0], [1, 0.5, 0], atol=0.02)


def test_an_open_mesh_is_entered_for_good() -> None:
    open_box = box(volume=0)
    open_box = replace(open_box, triangles=open_box.triangles[2:])  # without the side at x = -1
    media = media_of(open_box, volumes=(Volume(1.0),))
    origins = np.array([[0, 0.1, 0.2], [0, 0.1, 3], [3, 0.1, 0.2], [0, 0.1, 0.2]], np.float32)
    directions = np.array([[1, 0, 0], [0, 0, -1], [-1, 0, 0], [-1, 0, 0]], np.float32)
    depth = media.optical_depth(origins, directions, 5.0, np.ones(4, np.uint64))
    np.testing.assert_allclose(depth[0], [1, 2, 3, 5], rtol=1e-5)
    np.testing.assert_allclose(media.optical_depth(origins, directions, 5.0)[0], [1, 2, 3, 0], rtol=1e-5)


def test_triangles_without_finite_corners_bound_nothing() -> None:
    mesh = box(volume=0)
    vertices = np.concatenate([mesh.vertices, [[np.nan, 0, 0], [np.inf, 0, 0]]])
    mesh = replace(mesh, vertices=vertices, triangles=np.concatenate([mesh.triangles, [[0, 8, 9]]]))
    media = media_of(mesh, volumes=(Volume(1.0),))
    ray = np.array([[0, 0, -3]], np.float32), np.array([[0, 0, 1]], np.float32)
    assert media.optical_depth(*ray, np.inf) == pytest.approx(2)
    nothing = replace(mesh, triangles=[[0, 8, 9]])
    assert media_of(nothing, volumes=(Volume(1.0),)).optical_depth(*ray, np.inf) == 0


def test_the_worlds_medium_is_everywhere_and_lets_nothing_through_from_infinity() -> None:
    media = media_of(box(volume=0), volumes=(Volume((1, 2, 3)), Volume(0.1)), world=1)
    origins, directions = rays(500, 5)
    length = np.linalg.norm(directions.astype(float), axis=1)
    inside = chord((-1,) * 3, (1,) * 3, origins, directions, 2.0)
    expected = np.array([[1], [2], [3]]) * inside + 0.1 * 2 * length
    np.testing.assert_allclose(media.optical_depth(origins, directions, 2.0), expected, rtol=1e-4, atol=1e-5)
    along = media.along(origins, directions, 2.0)
    np.testing.assert_allclose(along.total, expected, rtol=1e-4, atol=1e-5)
    # Segments join without a gap, and their depths add up.
    same = along.ray[1:] == along.ray[:-1]
    np.testing.assert_array_equal(along.start[1:][same], along.end[:-1][same])
    own = media.extinction[:, along.mixture] * (along.end - along.start)
    np.testing.assert_allclose(along.depth[:, 1:][:, same], (along.depth + own)[:, :-1][:, same], rtol=1e-5)
    endless = media.along(origins, directions, np.inf)
    assert np.isinf(endless.total).all() and np.isinf(endless.end).sum() == 500
    assert np.isinf(media.optical_depth(origins, directions, np.inf)).all()
    assert (media.seen(origins, directions, np.inf)[0] == 0).all()


def test_emission_is_that_of_a_sum_over_the_ray() -> None:
    volumes = (
        Volume((0.5, 0, 0.2), emission=(1, 2, 0)),
        Volume(0.3, 0.4),
        Volume(0, emission=(0, 0.5, 0.25)),
    )
    low, high = (-0.5, -0.4, -0.3), (0.6, 0.7, 0.8)
    media = media_of(box(volume=0), box(low, high, volume=1), box(low, high, volume=2), volumes=volumes)
    origins, directions = rays(200, 6)
    length = np.linalg.norm(directions.astype(float), axis=1)
    t = (np.arange(4000) + 0.5) / 4000 * 2
    points = origins[:, None].astype(float) + directions[:, None] * t[:, None]
    inside = np.stack(
        [
            ((points > a) & (points < b)).all(axis=2)
            for a, b in (((-1,) * 3, (1,) * 3), (low, high), (low, high))
        ]
    )
    step = 2 / 4000 * length[:, None]
    sigma, glow = (
        np.einsum("bc,bnt->cnt", np.array([getattr(v, name) for v in volumes]), inside) * step
        for name in ("extinction", "emission")
    )
    depth = np.cumsum(sigma, axis=2) - sigma / 2
    expected = (glow * np.exp(-depth)).sum(axis=2)
    passed, found = media.seen(origins, directions, 2.0)
    np.testing.assert_allclose(found, expected, atol=2e-3 * expected.max())
    np.testing.assert_allclose(passed, np.exp(-sigma.sum(axis=2)), atol=2e-3)


@pytest.mark.parametrize("sigma", (0.0, 1e-30, 1e-12, 1e-3, 1.0, 1e4, 1e30))
def test_emission_of_thin_and_thick_air_is_finite(sigma: float) -> None:
    media = media_of(box(volume=0), volumes=(Volume(sigma, emission=2.0),))
    origin, direction = np.array([[0, 0, -3]], np.float32), np.array([[0, 0, 1]], np.float32)
    passed, glow = media.seen(origin, direction, np.inf)
    np.testing.assert_allclose(glow, 2 * (-np.expm1(-2 * sigma) / sigma if sigma else 2), rtol=1e-5)
    np.testing.assert_allclose(passed, np.exp(-2 * sigma), rtol=1e-5)


def test_scale_changes_nothing() -> None:
    origins, directions = rays(300, 7)
    volumes = (Volume((0.1, 0.2, 0.4), emission=1.0), Volume(0.5))
    meshes = sphere(volume=0), box((0, 0, 0), (2, 2, 2), volume=1)
    depth = media_of(*meshes, volumes=volumes, world=0).along(origins, directions, 1.5)
    scaled = media_of(*meshes, volumes=volumes, world=0, scale=2.0**-13).along(
        origins * 2.0**-13, directions * 2.0**-13, 1.5
    )
    np.testing.assert_allclose(scaled.total, depth.total, rtol=1e-6)
    np.testing.assert_allclose(scaled.emission, depth.emission, rtol=1e-6)


def test_mixtures_add_up_their_phase_functions() -> None:
    two = Volume([[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], anisotropy=[0.5, -0.2])
    media = media_of(box(volume=0), box(volume=1), volumes=(two, Volume(1.0, anisotropy=0.5)))
    both = media.components(3)
    assert [g for _, g in both] == [-0.2, 0.5]
    np.testing.assert_allclose([s for s, _ in both], [[0.4, 0.5, 0.6], [1.1, 1.2, 1.3]])
    assert media.components(0) == []
    np.testing.assert_allclose(media.extinction[:, 3], [1.5, 1.7, 1.9])


def test_many_bodies() -> None:
    """More than the tables of all sets hold, and more than there may be."""
    count = DIRECT + 8
    density = 0.01 * np.arange(1, count + 1)
    boxes = [
        box((-1, -1, 2 * i), (1, 1, 2 * i + 3), volume=i) for i in range(count)
    ]  # each overlaps the next
    media = media_of(*boxes, volumes=[Volume(float(one)) for one in density])
    assert media.bodies == count
    ray = np.array([[0.1, 0.2, -1]], np.float32), np.array([[0, 0, 1]], np.float32)
    along = media.along(*ray, np.inf)
    assert along.total == pytest.approx(3 * density.sum())
    expected = np.stack([density, density + np.append(density[1:], 0)]).T.ravel()[:-1]
    np.testing.assert_allclose(media.extinction[0, along.mixture], expected)
    with pytest.raises(RenderError, match="64 meshes enclose volumes, of which 64 are"):
        media_of(*64 * [boxes[0]], volumes=[Volume(0.01)] * count)


@pytest.mark.parametrize("leaky", (False, True))
def test_bodies_of_one_fog_that_keep_clear_are_joined(leaky: bool) -> None:
    """Of 90, inside out or not, round, ringed, boxes or open, some in others: each dims as it does alone."""
    rng = np.random.default_rng(21)
    volumes = Volume(0.3), Volume(0.7), Volume(0.3, name="another of the same")
    meshes = []
    for i in range(90):
        shape = torus(0.3, 0.1) if i % 3 == 0 else sphere((0, 0, 0), 0.3) if i % 3 == 1 else box()
        vertices = shape.vertices * rng.uniform(0.3, 1, 3) + rng.uniform(-2, 2, 3)
        triangles = shape.triangles[:, ::-1] if i % 5 == 0 else shape.triangles
        meshes.append(Mesh(vertices, triangles[2:] if leaky and i % 30 == 29 else triangles, volume=i % 3))
    together, alone = media_of(*meshes, volumes=volumes), [media_of(mesh, volumes=volumes) for mesh in meshes]
    assert 4 < together.bodies < 40
    origins, directions = rays(3000, 22, 4.0)
    depth = sum(media.optical_depth(origins, directions, 1.5) for media in alone)
    assert (depth > 0).sum() > 1000
    np.testing.assert_allclose(together.optical_depth(origins, directions, 1.5), depth, atol=2e-5)
    along = together.along(origins, directions, 1.5)
    np.testing.assert_allclose(along.total, depth, atol=2e-5)
    if not leaky:
        # Rays go on in what they ended in.
        ends = (origins + 1.5 * directions).astype(np.float32)
        depth = sum(media.optical_depth(ends, directions, 0.5) for media in alone)
        np.testing.assert_allclose(
            together.optical_depth(ends, directions, 0.5, along.state), depth, atol=2e-5
        )


@pytest.mark.parametrize("far", (0.0, 1.0, 300.0))
@pytest.mark.parametrize("reach", (0.4, np.inf))
def test_rays_that_may_meet_a_ball_are_all_found(far: float, reach: float) -> None:
    """And of others few, though balls are small and ``far`` from the frame's centre."""
    rng = np.random.default_rng(11)
    balls = [(centre, 0.1) for centre in rng.uniform(-1, 1, (20, 3)) + far]
    origins, directions = rays(3000, 12)
    origins += np.float32(far)
    directions[:5] = 0
    lengths = np.linalg.norm(directions.astype(float), axis=1)
    nearest, slack = [], []
    for centre, _ in balls:
        to_centre = centre - origins.astype(float)
        foot = (to_centre * directions).sum(axis=1) / np.maximum(lengths, 1e-30) ** 2
        there = np.clip(foot, 0, reach)[:, None] * directions
        nearest.append(np.linalg.norm(to_centre - there, axis=1))
        slack.append((origins.astype(float) ** 2).sum(axis=1) + (centre**2).sum())
    ball, ray = NearBalls(balls).pairs(origins, directions, np.full(3000, reach))
    found = np.zeros((20, 3000), bool)
    found[ball, ray] = True
    assert (np.diff(ball * 3000 + ray) > 0).all()
    met = np.array(nearest) <= 0.1
    assert met.sum() > 100 and found[met].all()
    assert not found[np.array(nearest) > np.sqrt(0.1**2 + 2.0**-16 * np.array(slack))].any()


def test_what_a_ray_meets_does_not_depend_on_how_many_bodies_there_are() -> None:
    """Clipped, traced or open, one body alone is found as among others."""
    open_box = box((-2, -1, 0), (-1, 0, 1), volume=0)
    meshes = [
        box(volume=0),
        sphere((1.5, 0, 0), 0.7, segments=32, volume=0),
        box((0, 0, 0), (2, 2, 2), volume=0),
        torus(volume=0),
        replace(open_box, triangles=open_box.triangles[2:]),
        sphere((-1.5, 1, 0), 0.5, segments=32, volume=0),
    ]
    origins, directions = rays(2000, 13)
    inside = np.zeros(2000, np.uint64)
    together = media_of(*meshes, volumes=(Volume(1.0),))
    depth, met = np.zeros((1, 2000)), np.zeros(2000, np.uint64)
    for i, mesh in enumerate(meshes):
        alone = media_of(mesh, volumes=(Volume(1.0),))
        depth += alone.optical_depth(origins, directions, 1.5)
        met |= alone.met(origins, directions, 1.5) << np.uint64(i)
    np.testing.assert_allclose(together.optical_depth(origins, directions, 1.5), depth, atol=1e-5)
    np.testing.assert_array_equal(together.met(origins, directions, 1.5), met)
    assert len(np.unique(met)) > 20
    np.testing.assert_allclose(together.along(origins, directions, 1.5).total, depth, atol=1e-5)
    first = together.optical_depth(origins, directions, 1.5, inside | np.uint64(1 << 4))
    alone = media_of(meshes[4], volumes=(Volume(1.0),))
    began = alone.optical_depth(origins, directions, 1.5, inside + np.uint64(1))
    other = alone.optical_depth(origins, directions, 1.5)
    np.testing.assert_allclose(first - depth, began - other, atol=1e-5)


def test_there_are_no_media_where_nothing_attenuates_or_glows() -> None:
    assert media_of(box(volume=0), box(), volumes=(Volume(),), world=0) is None


@pytest.mark.parametrize(
    "meshes", ((), (box(volume=0),), (box(volume=0), sphere(volume=0, segments=32))), ids=len
)
@pytest.mark.parametrize("world", (-1, 0))
def test_no_rays_at_all(meshes: tuple[Mesh, ...], world: int) -> None:
    media = media_of(*meshes, box(volume=0), volumes=(Volume(1.0, emission=1.0),), world=world)
    none = np.zeros((0, 3), np.float32)
    assert media.optical_depth(none, none, 1.0).shape == (1, 0)
    along = media.along(none, none, np.inf)
    assert along.total.shape == (1, 0) and along.emission.shape == (3, 0) and len(along.ray) == 0
