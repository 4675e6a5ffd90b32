# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog along rays: what is inside what, and how much light is left."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scenes import box, place, sphere

from engine_core import Camera, Mesh, Scene, Volume, World
from engine_core.geometry import boundaries
from engine_core.geometry.boundaries import Boundaries
from engine_core.geometry.frame import Frame, frame_of
from engine_core.transport.media import DIRECT, Media

FRAME = Frame(np.zeros(3), 1.0)
CAMERA = Camera.look_at((0, -6, 0), (0, 0, 0), 4, 4)


def media_of(*meshes: Mesh, volumes: Any, world: int = -1, scale: float = 1.0) -> Media:
    scene = Scene(CAMERA, meshes, world=World(volume=world), volumes=volumes)
    return Media.of(scene, Frame(np.zeros(3), scale))


def rays(count: int, seed: int, spread: float = 3.0) -> tuple[np.ndarray, np.ndarray]:
    """Random origins and directions, of all lengths."""
    rng = np.random.default_rng(seed)
    origins = rng.uniform(-spread, spread, (count, 3))
    towards = rng.uniform(-1, 1, (count, 3))
    return origins.astype(np.float32), ((towards - origins) * rng.uniform(0.2, 3, (count, 1))).astype(np.float32)


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
def test_depth_through_a_box_is_its_chord(traced: bool, reach: float, monkeypatch: pytest.MonkeyPatch) -> None:
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
        replace(box((0.2, 0, 0), (2.0, 0.9, 0.8), volume=1), triangles=box().triangles[:, ::-1]),  # inside out
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
