# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive meshes in pieces: nothing is lost or added, and samples go where something is to be seen."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scenes import box, sphere

from engine_core import Camera, Material, Mesh, Scene, Settings, Volume, World, render
from engine_core.geometry.closed_meshes import outer_sides
from engine_core.geometry.frame import Frame
from engine_core.geometry.triangles import Triangles, gather_triangles
from engine_core.shading import closures
from engine_core.shading.abilities import abilities
from engine_core.shading.values import Value
from engine_core.transport.emitters import MeshEmitters, emitter_groups, mesh_pieces
from engine_core.transport.emitters.mesh_pieces import (
    ALONE,
    CLUSTERS,
    MOST_CUT,
    MOST_PAIRS,
    emissive_pieces,
)

FRAME = Frame(np.array([0.0, 0.0, 8.0]), 1.0)
"""Its origin is the camera, into whose surroundings no body is taken to reach."""
GLOWING = Material(0.0, 1.0)
CUBE = box((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5))


def _triangles(*meshes: Mesh) -> Triangles:
    return gather_triangles(meshes, FRAME)[0]


def _tube(sides: int = 16, radius: float = 0.05, length: float = 4.0) -> Mesh:
    """Closed, of long triangles."""
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    ends = [np.insert(rim, 2, z, axis=1) for z in (-length / 2, length / 2)]
    i = np.arange(sides)
    j = (i + 1) % sides
    wall = [np.stack([i, j, j + sides], 1), np.stack([i, j + sides, i + sides], 1)]
    k = np.arange(1, sides - 1)
    caps = [np.stack([0 * k, k + 1, k], 1), np.stack([0 * k + sides, k + sides, k + 1 + sides], 1)]
    return Mesh(np.concatenate(ends), np.concatenate(wall + caps))


def _hills(cells: int = 40, size: float = 4.0) -> Mesh:
    """A sheet of many triangles, none of which is in the plane of another."""
    x = np.linspace(-size / 2, size / 2, cells + 1)
    x, y = (a.ravel() for a in np.meshgrid(x, x))
    z = 0.2 * np.sin(2.1 * x + 1) * np.sin(1.7 * y) + 0.05 * np.sin(5 * x - 3 * y)
    i = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    triangles = [np.stack([i, i + 1, i + cells + 2], 1), np.stack([i, i + cells + 2, i + cells + 1], 1)]
    return Mesh(np.stack([x, y, z], 1), np.concatenate(triangles))


def _group(*meshes: Mesh) -> MeshEmitters:
    (group,), _ = emitter_groups((), World(), (GLOWING,), _triangles(*meshes), FRAME)
    return group


def _area(corners: np.ndarray) -> np.ndarray:
    a, b, c = np.moveaxis(np.asarray(corners, float), 1, 0)
    return np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2


# -- pieces --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [1.0, 1e-6, 1e6])
def test_pieces_of_a_tube_are_all_of_it_and_none_is_long(size: float):
    tube = _tube()
    triangles = _triangles(Mesh(tube.vertices * size, tube.triangles))
    pieces = emissive_pieces((GLOWING,), triangles)
    whole = _area(triangles.vertices[triangles.indices])
    of_triangle = np.bincount(pieces.row, _area(pieces.corners), len(triangles))
    assert np.allclose(of_triangle, whole, rtol=1e-6)
    edges = np.linalg.norm(np.roll(pieces.corners, -1, axis=1) - pieces.corners, axis=2)
    assert edges.max() < 0.06 * 4.0 * size
    assert len(whole) + MOST_CUT / 2 < len(pieces.row) < len(whole) + 1.5 * MOST_CUT


def test_weights_of_pieces_say_where_they_are_on_their_triangles():
    triangles = _triangles(_tube())
    pieces = emissive_pieces((GLOWING,), triangles)
    a, b, c = np.moveaxis(triangles.vertices[triangles.indices[pieces.row]].astype(float), 1, 0)
    for k in range(3):
        u, v = pieces.weights[:, k].T[..., None]
        assert np.allclose(a + u * (b - a) + v * (c - a), pieces.corners[:, k], atol=1e-6)


def test_few_triangles_and_compact_ones_are_left_as_they_are():
    strip = Mesh([(0, 0, 0), (9, 0, 0), (9, 0.1, 0), (0, 0.1, 0)], [(0, 1, 2), (0, 2, 3)])
    for mesh, lights in ((strip, 2), (sphere(), None)):
        pieces = emissive_pieces((GLOWING,), _triangles(mesh))
        assert len(pieces.row) == len(mesh.triangles)
        if lights is None:
            assert (np.diff(pieces.first) <= ALONE).all()
        else:
            assert len(pieces.first) - 1 == lights


def test_no_needle_makes_pieces_without_end():
    random = np.random.default_rng(3)
    corner = random.normal(size=(50, 3, 3))
    corner[:, 2] = corner[:, 0] + 1e-7 * random.normal(size=(50, 3))
    pieces = emissive_pieces(
        (GLOWING,), _triangles(Mesh(corner.reshape(-1, 3), np.arange(150).reshape(-1, 3)))
    )
    assert len(pieces.row) < 50 + 1.5 * MOST_CUT


def test_no_light_is_of_what_is_far_apart():
    """Two balls of unlike size: half of a light's pieces were of one, and half of the other."""
    meshes = sphere((0, 0, 0), 0.5, segments=44), sphere((90, 0, 0), 0.2, segments=52)
    pieces = emissive_pieces((GLOWING,), _triangles(*meshes))
    assert len(pieces.first) - 1 > CLUSTERS / 2
    right = pieces.corners[:, :, 0].min(axis=1) > 50
    of_light = np.add.reduceat(right, pieces.first[:-1], dtype=int)
    assert ((of_light == 0) | (of_light == np.diff(pieces.first))).all()


# -- which side is seen --------------------------------------------------------------------------------


def _sides(mesh: Mesh, number: Any = 0) -> np.ndarray:
    return outer_sides(
        np.asarray(mesh.vertices), np.asarray(mesh.triangles), np.full(len(mesh.triangles), number)
    )


def test_outside_of_closed_meshes():
    turned = Mesh(CUBE.vertices, np.asarray(CUBE.triangles)[:, ::-1])
    mirrored = Mesh(np.asarray(CUBE.vertices) * (-1, 1, 1), CUBE.triangles)
    away = Mesh(np.asarray(CUBE.vertices) + 1e5, CUBE.triangles)
    of_cube = _sides(CUBE)
    assert abs(of_cube.sum()) == len(of_cube)
    assert (_sides(away) == of_cube).all()
    assert (_sides(turned) == -of_cube).all() and (_sides(mirrored) == -of_cube).all()


def test_what_is_open_or_flat_or_inconsistent_has_no_outside():
    triangles = np.asarray(CUBE.triangles)
    one_turned = triangles.copy()
    one_turned[0] = one_turned[0, ::-1]
    flat = Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2), (2, 1, 0)])
    for mesh in (Mesh(CUBE.vertices, triangles[1:]), Mesh(CUBE.vertices, one_turned), flat):
        assert not _sides(mesh).any()


def test_faces_that_share_places_but_no_vertices_are_closed():
    corners = np.asarray(CUBE.vertices)[np.asarray(CUBE.triangles)]
    apart = Mesh(corners.reshape(-1, 3), np.arange(corners.size // 3).reshape(-1, 3))
    assert (_sides(apart) == _sides(CUBE)).all()


def test_meshes_are_closed_each_by_itself():
    # All in the same place.
    indices = [np.asarray(CUBE.triangles)[int(k == 1) :] + 8 * k for k in range(3)]
    vertices = np.tile(np.asarray(CUBE.vertices), (3, 1))
    sides = outer_sides(vertices, np.concatenate(indices), np.repeat([0, 1, 2], [12, 11, 12]))
    assert (sides[:12] != 0).all() and not sides[12:23].any() and (sides[23:] != 0).all()


def test_what_lets_light_through_is_seen_from_both_sides():
    mesh = Mesh(CUBE.vertices, CUBE.triangles, materials=np.arange(12) % 2)
    materials = GLOWING, Material()
    assert emissive_pieces(materials, _triangles(mesh)).side.all()
    assert not emissive_pieces(materials, _triangles(mesh), np.array([False, True])).side.any()
    for how in ({"casts_shadow": False}, {"visible_to_camera": False}):
        assert not emissive_pieces(
            (GLOWING,), _triangles(Mesh(CUBE.vertices, CUBE.triangles, **how))
        ).side.any()


def test_what_may_be_looked_at_from_within_is_seen_from_both_sides():
    room = Mesh(CUBE.vertices, CUBE.triangles, materials=np.arange(12) // 10)
    dome, about_camera = sphere(radius=3.0), sphere((0, 0, 8), 3.0)
    materials = Material(), GLOWING
    assert not emissive_pieces(materials, _triangles(room)).side.any()
    assert emissive_pieces((GLOWING,), _triangles(dome)).side.all()
    assert not emissive_pieces((GLOWING,), _triangles(about_camera)).side.any()
    furnished = emissive_pieces(materials, _triangles(Mesh(dome.vertices, dome.triangles, materials=1), CUBE))
    assert not furnished.side.any()
    beside = box((4, 0, 0), (5, 1, 1))
    assert emissive_pieces(
        materials, _triangles(Mesh(dome.vertices, dome.triangles, materials=1), beside)
    ).side.all()


@pytest.mark.parametrize("most", [MOST_PAIRS, 50])
def test_of_many_bodies_those_that_hold_others_are_found(most: int, monkeypatch):
    """By brute force; where they are too many to look at, all that do are found, and others may be."""
    monkeypatch.setattr(mesh_pieces, "MOST_PAIRS", most)
    random = np.random.default_rng(8)
    low = random.uniform(-20, 20, (150, 3)) + (0, 0, 60)
    high = low + random.exponential(6.0, (150, 3))
    triangles = _triangles(*(box(*ends) for ends in zip(low, high, strict=True)))
    within = (low[:, None] >= low) & (high[:, None] <= high)
    holds = (within.all(axis=2) & ~np.eye(150, dtype=bool)).any(axis=0)
    found = mesh_pieces._enclosing(np.arange(150), triangles)
    assert holds.sum() > 3 and found[holds].all()
    assert (found == holds).all() if most == MOST_PAIRS else (found > holds).any() and not found.all()


# -- samples -------------------------------------------------------------------------------------------

PLACES = {
    "beside": (0.4, 0.1, 0.3),
    "beyond": (0.02, 0.03, 2.4),
    "far": (30.0, 9.0, 4.0),
    "within": (0.0, 0.01, 1.0),
}


def _samples(group: MeshEmitters, place: Any, count: int, seed: int = 1) -> tuple[np.ndarray, ...]:
    """Lights, alike likely, vectors, values and u."""
    random = np.random.default_rng(seed)
    light = np.sort(random.integers(0, len(group), count))
    u = random.random((3, count), np.float32)
    position = np.tile((np.array(place, float) - FRAME.origin)[:, None], count)
    to_light, measure = group.sample(light, position, None, u[2], u[:2])
    return light, position, to_light, measure * group.size[light] * len(group), u


@pytest.mark.parametrize("place", PLACES)
def test_solid_angles_of_all_pieces_add_up(place: str):
    """Both sides count here, as nothing is in the way: from within it is the whole sphere, from outside twice
    what is seen."""
    group = _group(_tube())
    *_, values, _ = _samples(group, PLACES[place], 200_000)
    corners = group.corners.astype(float) + FRAME.origin - PLACES[place]
    a, b, c = np.moveaxis(corners / np.linalg.norm(corners, axis=2, keepdims=True), 1, 0)
    over = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
    under = 1 + (a * b).sum(1) + (b * c).sum(1) + (c * a).sum(1)
    truth = 2 * np.arctan2(over, under).sum()
    if place == "within":
        assert truth == pytest.approx(4 * np.pi, rel=1e-3)
    error = values.std() / len(values) ** 0.5
    assert abs(values.mean(dtype=float) - truth) < 4 * error
    assert error < 0.02 * truth


@pytest.mark.parametrize("place", ["beside", "far"])
def test_few_samples_look_at_the_back_of_a_closed_body(place: str):
    tube, random, count = _tube(), np.random.default_rng(2), 50_000
    back = {}
    for name, triangles in (("closed", tube.triangles), ("open", tube.triangles[:-1])):
        group = _group(Mesh(tube.vertices, triangles))
        point = (np.array(PLACES[place]) - FRAME.origin)[:, None]
        expected = group.size * group.facing(np.arange(len(group)), point - group.centre)
        expected /= ((point - group.centre) ** 2).sum(axis=0)
        light = random.choice(len(group), count, p=expected / expected.sum())
        u, position = random.random((3, count), np.float32), np.tile(point, count)
        to_light, _ = group.sample(light, position, None, u[2], u[:2])
        a, b, c = np.moveaxis(group.corners[group.piece(light, position, u[2])].astype(float), 1, 0)
        back[name] = np.mean((np.cross(b - a, c - a) * to_light.T).sum(axis=1) > 0)
    assert back["closed"] < 0.15 < 0.3 < back["open"]


def test_what_is_seen_of_one_light_differs_little():
    """By area alone, more than half of the samples would see nothing: a deviation above 1."""
    group = _group(_tube())
    count, place = 40_000, (np.array([0.3, 0.2, 0.1]) - FRAME.origin)[:, None]
    light = np.full(count, np.argmin(np.abs(group.centre - place).sum(axis=0)))
    u, position = np.random.default_rng(5).random((3, count), np.float32), np.tile(place, count)
    to_light, measure = group.sample(light, position, None, u[2], u[:2])
    a, b, c = np.moveaxis(group.corners[group.piece(light, position, u[2])].astype(float), 1, 0)
    values = measure * ((np.cross(b - a, c - a) * to_light.T).sum(axis=1) < 0)
    assert values.std() < 0.6 * values.mean()


@pytest.mark.parametrize(("height", "most"), [(0.02, 12.0), (0.1, 6.0), (0.3, 3.5), (1.0, 2.0), (10.0, 1.1)])
def test_points_next_to_a_mesh_see_what_is_next_to_them(height: float, most: float):
    """In edges above a sheet of 3,200 triangles. Of patches of two, that were chosen among by area, a sample
    had up to 15, 11, 5, 2.4 and 1.1 times the square of the mean."""
    group, random = _group(_hills()), np.random.default_rng(6)
    edge = np.median(np.linalg.norm(group.corners[:, 1] - group.corners[:, 0], axis=1))
    count, moments = 30_000, []
    for piece in random.integers(0, len(group.row), 12):
        a, b, c = group.corners[piece].astype(float)
        normal = np.cross(b - a, c - a)
        place = (a + b + c) / 3 + height * edge * normal / np.linalg.norm(normal)
        light = np.full(count, group.light_of[piece])
        u, position = random.random((3, count), np.float32), np.tile(place[:, None], count)
        to_light, measure = group.sample(light, position, None, u[2], u[:2])
        values = measure * group.size[light[0]]
        own = group.corners[group.light_of == light[0]].astype(float) - place
        a, b, c = np.moveaxis(own / np.linalg.norm(own, axis=2, keepdims=True), 1, 0)
        over = np.abs(np.einsum("ij,ij->i", a, np.cross(b, c)))
        truth = 2 * np.arctan2(over, 1 + (a * b).sum(1) + (b * c).sum(1) + (c * a).sum(1)).sum()
        assert abs(values.mean(dtype=float) - truth) < 4.5 * values.std() / count**0.5 + 1e-4 * truth
        chosen = group.piece(light, position, u[2])
        pdf = group.pdf_of_piece(chosen, position, None, to_light)
        assert np.allclose(pdf * values, 1, rtol=2e-3)
        moments.append((values.astype(float) ** 2).mean() / truth**2)
    assert max(moments) < most


# -- what emits the same everywhere --------------------------------------------------------------------


def test_only_what_may_vary_is_looked_up():
    value = Value()
    steady = [
        closures.Emission((1, 2, 3), 4.0),
        closures.Principled(0.8, emission_color=(1, 0, 0), emission_strength=2.0, roughness=value),
        closures.Mix(0.3, closures.Diffuse(value), closures.Emission(1.0, 2.0)),
        closures.Add(closures.Diffuse(0.5), closures.Emission(1.0, 2.0)),
        closures.Diffuse(value),
        closures.Emission(value, 0.0),
    ]
    varying = [
        closures.Emission(value, 4.0),
        closures.Emission(1.0, value),
        closures.Principled(0.8, emission_strength=value),
        closures.Principled(0.8, emission_strength=2.0, alpha=value),
        closures.Principled(0.8, emission_strength=2.0, coat_weight=0.5),
        closures.Mix(value, closures.Diffuse(0.5), closures.Emission(1.0, 2.0)),
        closures.Add(closures.Diffuse(0.5), closures.Mix(0.5, None, closures.Emission(value, 2.0))),
    ]
    assert not any(abilities(c).varies for c in steady)
    assert all(abilities(c).varies for c in varying)


# -- what a body hides of itself -----------------------------------------------------------------------


def test_what_is_behind_a_thin_body_does_not_shine_through_it_into_fog():
    """Of a sheet of 2 mm at 30 m, seen from below, all that is lit is lit by its bottom."""
    air, glowing = (Volume(scattering=0.01),), (Material(0.0), Material(0.0, (3.0, 2.0, 1.0)))
    low, high = np.array([-2.0, 30.0, -3.0]), np.array([2.0, 30.002, 1.0])
    corners = np.array([[x, low[1], z] for x, z in ((-2, -3), (2, -3), (2, 1), (-2, 1))])
    sheet = Mesh(corners, [[0, 1, 2], [0, 2, 3]], materials=1)
    corners = [(x, y, -10.0) for x, y in ((-9, -9), (9, -9), (9, 9), (-9, 9))]
    wall = Mesh(corners, [(0, 1, 2), (0, 2, 3)], casts_shadow=False)
    mean = {}
    for name, mesh in (("body", box(low, high, materials=1)), ("sheet", sheet)):
        view = Camera.look_at((0, 0, 0), (0, -1, -4), 16, 16, 0.6, up=(0, 1, 0))
        scene = Scene(view, (mesh, wall), glowing, (), World(volume=0), volumes=air)
        films = [render(scene, Settings(samples=64, seed=seed, threads=1)) for seed in range(2)]
        mean[name] = np.mean([film.combined[..., 0].mean(dtype=float) for film in films])
    assert mean["body"] == pytest.approx(mean["sheet"], rel=5e-3)
