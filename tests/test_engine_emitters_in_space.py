# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights sampled from points in space: solid angles, densities, fluence."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scenes import box, floor, mixed_lights, place, whole_pieces
from scipy import integrate, stats
from test_engine_emitters import FRAME, _frame, _unit

from engine_core import AreaLight, Light, Material, Mesh, PointLight, SpotLight, SunLight, World
from engine_core.geometry.triangles import gather_triangles
from engine_core.shading.closures import Emission
from engine_core.shading.values import OfSurface
from engine_core.transport.emitters import Emitters, MeshEmitters, emitter_groups
from engine_core.transport.light_samples import SceneLights
from engine_core.transport.surface_shading import SurfaceShader

SAMPLES = 50_000
POSE = place((0.3, -0.2, 0.4), (0.5, -0.7, 0.3))
TRIANGLE = np.array([(-0.7, -0.5, 0), (1.1, -0.4, 0), (0.2, 0.9, 0)])

# Points in the pose's space; lights face -Z.
POINTS = {
    "before": (0.2, -0.1, -0.8),
    "aside": (1.6, 0.9, -0.4),
    "far": (3.0, -4.0, -60.0),
    "near": (0.13, 0.08, -0.02),
    "touching": (0.13, 0.08, -2e-4),
    "past the rim": (1.3, 0.1, -0.05),
    "edge-on": (1.9, 0.1, 0.0),
    "behind": (0.2, -0.1, 0.7),
}


def _group(*lights: Light, world: World | None = None) -> Emitters:
    nothing, _ = gather_triangles([], FRAME)
    groups, messages = emitter_groups(lights, world or World(), (Material(),), nothing, FRAME)
    assert len(groups) == 1 and not messages
    return groups[0]


def _mesh(*corners: np.ndarray) -> MeshEmitters:
    mesh = Mesh(np.concatenate(corners), np.arange(3 * len(corners)).reshape(-1, 3))
    triangles, _ = gather_triangles([mesh], FRAME)
    return MeshEmitters(np.ones((1, 3)), whole_pieces(triangles, np.arange(len(corners))))


def _scaled(scale: float, points: Any, pose: np.ndarray = POSE) -> np.ndarray:
    return scale * (np.asarray(points, float) @ pose[:3, :3].T + pose[:3, 3])


def _pose(scale: float) -> np.ndarray:
    matrix = POSE.copy()
    matrix[:3] *= scale
    return matrix


def _sample(
    group: Emitters, point: np.ndarray, count: int = SAMPLES, seed: int = 4
) -> tuple[np.ndarray, ...]:
    """Vectors (3, N), measures times the size (N,), and the u (3, N) that they are of."""
    u = (np.random.default_rng(seed).integers(0, 1 << 23, (3, count)) + 0.5) / (1 << 23)
    u = u.astype(np.float32)
    position = np.tile(np.asarray(point)[:, None], count)
    to_light, measure = group.sample(None, position, None, u[0], u[1:])
    assert to_light.dtype == measure.dtype == np.float32
    assert np.isfinite(to_light).all() and np.isfinite(measure).all() and (measure >= 0).all()
    return to_light, (group.size[0] or 1.0) * measure.astype(np.float64), u


def _flat(point: Any, rim: Callable[[float], np.ndarray], ends: Any) -> float:
    """Solid angle of a flat figure in z = 0 by an integral along its rim, counter-clockwise."""
    x, y, z = point

    def integrand(t: float) -> float:
        (a, b), (da, db) = rim(t) - (x, y), (rim(t + 1e-6) - rim(t - 1e-6)) / 2e-6
        r = np.sqrt(a * a + b * b + z * z)
        # (1 - h / r) of the azimuth's step, without cancellation.
        return (a * db - b * da) / (r * (r + abs(z)))

    parts = [
        integrate.quad(integrand, a, b, limit=400, epsabs=1e-8)[0]
        for a, b in zip(ends[:-1], ends[1:], strict=True)
    ]
    return abs(sum(parts))


def _polygon(point: Any, corners: np.ndarray) -> float:
    """Solid angle, by triangles (van Oosterom and Strackee, 1983)."""
    a, *others = np.asarray(corners) - point
    total = 0.0
    for b, c in zip(others[:-1], others[1:], strict=True):
        r, s, t = (np.linalg.norm(v) for v in (a, b, c))
        below = r * s * t + (a @ b) * t + (b @ c) * r + (c @ a) * s
        total += 2 * np.arctan2(a @ np.cross(b, c), below)
    return abs(total)


def _ellipse(point: Any) -> float:
    return _flat(point, lambda t: np.array((np.cos(t), 0.5 * np.sin(t))), np.linspace(0, 2 * np.pi, 9))


RECTANGLE = np.array([(-1, -0.5, 0), (1, -0.5, 0), (1, 0.5, 0), (-1, 0.5, 0)])
FLAT = {
    "rectangle": (
        lambda s: _group(AreaLight(1.0, light_to_world=_pose(s), size=(2, 1))),
        lambda p: _polygon(p, RECTANGLE) * (p[2] < 0),
    ),
    "ellipse": (
        lambda s: _group(AreaLight(1.0, light_to_world=_pose(s), size=(2, 1), ellipse=True)),
        lambda p: _ellipse(p) * (p[2] < 0),
    ),
    "triangle": (lambda s: _mesh(_scaled(s, TRIANGLE)), lambda p: _polygon(p, TRIANGLE) * (p[2] != 0)),
}


@pytest.mark.parametrize("scale", [1.0, 1e-5, 1e5])
@pytest.mark.parametrize("where", POINTS)
@pytest.mark.parametrize("figure", FLAT)
def test_fluence_of_flat_lights_is_their_solid_angle(figure: str, where: str, scale: float):
    light, solid_angle = FLAT[figure]
    _, measure, _ = _sample(light(scale), _scaled(scale, POINTS[where]))
    error = measure.std() / SAMPLES**0.5
    assert measure.mean() == pytest.approx(solid_angle(POINTS[where]), abs=4 * error + 1e-6, rel=1e-3)
    if where in ("before", "near", "touching"):
        # Uniform in solid angle, or nearly.
        assert measure.std() < 0.06 * measure.mean()


@pytest.mark.parametrize("radius", [1e-4, 0.3, 1.99, 2.01, 50.0])
@pytest.mark.parametrize("sphere", [True, False])
def test_fluence_of_round_lights(radius: float, sphere: bool):
    centre = np.array((0.5, -0.7, 1.9))
    point = centre + 2 * _unit((0.3, -0.4, 0.6))
    group = _group(PointLight(1.0, position=centre, radius=radius, sphere=sphere))
    if not sphere:
        truth = 2 * np.pi * (1 - 2 / np.hypot(2, radius))
    else:
        truth = 2 * np.pi * (1 - np.sqrt(1 - radius**2 / 4)) if radius < 2 else 4 * np.pi
    _, measure, _ = _sample(group, point)
    # All of the same measure.
    assert measure == pytest.approx(truth, rel=2e-3)


def test_in_the_centre_of_a_round_light():
    for sphere, truth in ((True, 4 * np.pi), (False, 2 * np.pi)):
        _, measure, _ = _sample(_group(PointLight(1.0, radius=0.5, sphere=sphere)), np.zeros(3))
        assert measure == pytest.approx(truth, rel=1e-5)


@pytest.mark.parametrize("spread", [0.3, 1.5])
@pytest.mark.parametrize("ellipse", [False, True])
@pytest.mark.parametrize("where", ["before", "aside", "near", "behind"])
def test_fluence_of_a_soft_box(spread: float, ellipse: bool, where: str):
    x, y, z = POINTS[where]
    tan_half = np.tan(spread / 2)

    def integrand(b: float, a: float) -> float:
        tan = np.hypot(a - x, b - y) / abs(z)
        return max(tan_half - tan, 0) / (tan_half - spread / 2) * abs(z) / np.hypot(z, z * tan) ** 3

    def end(a: float) -> float:
        return 0.5 * np.sqrt(1 - a * a) if ellipse else 0.5

    reach = abs(z) * tan_half
    low, high = np.clip((x - reach, x + reach), -1, 1)
    truth = 0.0
    if z < 0 and low < high:
        options = {"epsabs": 1e-6, "epsrel": 1e-4, "limit": 60}

        def column(a: float) -> float:
            first, last = max(-end(a), y - reach), min(end(a), y + reach)
            return integrate.quad(integrand, first, last, args=(a,), **options)[0] if first < last else 0.0

        truth, _ = integrate.quad(column, low, high, **options)
    light = AreaLight(1.0, light_to_world=POSE, size=(2, 1), ellipse=ellipse, spread=spread)
    _, measure, _ = _sample(_group(light), _scaled(1, POINTS[where]))
    assert measure.mean() == pytest.approx(truth, abs=4 * measure.std() / SAMPLES**0.5, rel=2e-3)


@pytest.mark.parametrize("sphere", [True, False])
@pytest.mark.parametrize("point", [(0.4, 0.3, -1.5), (1.2, 0.3, -1.5), (0.1, 0.1, -0.3), (3.0, 0.0, 0.1)])
def test_fluence_of_a_sized_spot_is_what_directions_meet(sphere: bool, point: tuple[float, ...]):
    spot = SpotLight(1.0, light_to_world=POSE, radius=0.4, sphere=sphere, angle=1.0, blend=0.6)
    group = _group(spot)
    point = _scaled(1, point)
    _, measure, _ = _sample(group, point)
    direction, solid_angle = _directions(group, point, 500)
    position = np.tile(point.astype(np.float32)[:, None], direction.shape[1])
    truth = sum(hits.gain.sum() for hits in group.hits(position, direction)) * solid_angle
    assert measure.mean() == pytest.approx(truth, abs=4 * measure.std() / SAMPLES**0.5, rel=3e-3)


def test_a_light_without_size_keeps_its_digits_next_to_it():
    centre = np.array((0.7, 0.3, -0.9)).astype(np.float32).astype(np.float64)
    group = _group(PointLight(1.0, position=centre))
    for distance in (1e-8, 1e-4, 1.0, 1e6):
        to_light, measure, _ = _sample(group, centre + (distance, 0, 0), 1)
        assert measure[0] == pytest.approx(distance**-2, rel=1e-5)
        assert to_light[0, 0] == pytest.approx(-distance, rel=1e-5)


# -- densities -------------------------------------------------------------------------------------


def _directions(group: Emitters, point: np.ndarray, count: int) -> tuple[np.ndarray, float]:
    """(3, count^2) float32 amid cells of equal solid angle of a cone that holds the light, and that angle."""
    axis, cos = _cone(group, point)
    z = 1 - (1 - cos) * (np.arange(count)[:, None] + 0.5) / count
    phi = 2 * np.pi * (np.arange(count) + 0.5) / count - np.pi
    r = np.sqrt(1 - z * z)
    local = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z)).reshape(3, -1)
    return (_frame(axis) @ local).astype(np.float32), 2 * np.pi * (1 - cos) / count**2


def _cone(group: Emitters, point: np.ndarray) -> tuple[np.ndarray, float]:
    if group.at_infinity:
        return np.array((0.0, 0.0, 1.0)), -1.0
    axis = group.centre[:, 0] - point
    sin = group.reach[0] / np.linalg.norm(axis)
    return _unit(axis), np.sqrt(1 - sin * sin) - 1e-4 if sin < 1 else -1.0


def _image() -> World:
    image = np.random.default_rng(5).random((6, 12, 3)) ** 4
    image[3, 4] = 20.0
    return World(image=image, rotation=_frame(_unit((1, 2, 3))))


PAIR = [TRIANGLE, TRIANGLE[::-1] * (1, -0.4, 1) - (0, 1.2, 0)]
CASES = {
    "rectangle": (lambda: FLAT["rectangle"][0](1.0), (0.2, -0.1, -0.8)),
    "rectangle aside": (lambda: FLAT["rectangle"][0](1.0), (1.6, 0.9, -0.4)),
    "far rectangle": (lambda: FLAT["rectangle"][0](1.0), (1.0, 2.0, -5.0)),
    "near rectangle": (lambda: FLAT["rectangle"][0](1.0), (0.13, 0.08, -0.02)),
    "ellipse": (lambda: FLAT["ellipse"][0](1.0), (0.2, -0.1, -0.4)),
    "triangle": (lambda: FLAT["triangle"][0](1.0), (0.2, -0.1, -0.4)),
    "near triangle": (lambda: FLAT["triangle"][0](1.0), (0.13, 0.08, -0.02)),
    "two triangles": (lambda: _mesh(*(_scaled(1, t) for t in PAIR)), (0.2, -0.3, 0.4)),
    "sphere": (lambda: _group(PointLight(1.0, position=POSE[:3, 3], radius=0.8)), (0.9, 0.4, -1.0)),
    "inside a sphere": (lambda: _group(PointLight(1.0, position=POSE[:3, 3], radius=0.8)), (0.3, 0.2, -0.5)),
    "disk": (
        lambda: _group(PointLight(1.0, position=POSE[:3, 3], radius=0.8, sphere=False)),
        (0.3, 0.2, -0.5),
    ),
    "world": (lambda: _group(world=World(1.0)), (0, 0, 0)),
    "image": (lambda: _group(world=_image()), (0, 0, 0)),
    "huge sun": (lambda: _group(SunLight(1.0, direction=(0.2, 0.3, 0.9), angle=2.5)), (0, 0, 0)),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest) -> tuple[Emitters, np.ndarray]:
    group, point = CASES[request.param]
    return group(), _scaled(1, point)


def _pdf(group: Emitters, point: np.ndarray, to_light: np.ndarray, triangle: np.ndarray | None) -> np.ndarray:
    position = np.tile(point[:, None], to_light.shape[1])
    if group.is_mesh:
        return group.pdf_of_piece(triangle, position, None, to_light)
    return group.pdf(None, position, None, to_light)


def _met(group: Emitters, point: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, ...]:
    """Directions (K,), and vectors (3, K) and triangles (K,) that they meet."""
    if not group.is_mesh:
        position = np.tile(point.astype(np.float32)[:, None], direction.shape[1])
        parts = list(group.hits(position, direction))
        lane = np.concatenate([p.lane for p in parts])
        return lane, direction[:, lane] * np.concatenate([p.distance for p in parts]), None
    lanes, vectors, numbers = [], [], []
    for number, (a, b, c) in enumerate(zip(group._corner.T, group._a.T, group._b.T, strict=True)):
        inverse = np.linalg.inv(np.stack([b, c, point - a], axis=1))
        s, t, _ = -inverse @ (point - a)[:, None] + 0 * direction
        u, v, w = inverse @ direction
        # point + distance direction = a + s b + t c, by Cramer's rule in these coordinates.
        distance = -1 / np.where(w == 0, np.inf, w)
        s, t = distance * u, distance * v
        lane = np.flatnonzero((distance > 0) & (s >= 0) & (t >= 0) & (s + t <= 1))
        lanes.append(lane)
        vectors.append((direction[:, lane] * distance[lane]).astype(np.float32))
        numbers.append(np.full(len(lane), group.row[number]))
    return np.concatenate(lanes), np.concatenate(vectors, axis=1), np.concatenate(numbers)


def test_sampled_directions_have_the_density(case):
    rows, fine = 24, 24
    group, point = case
    to_light, _, _ = _sample(group, point)
    axis, cos = _cone(group, point)
    x, y, z = _frame(axis).T @ (to_light / np.linalg.norm(to_light, axis=0))
    row = np.clip(((1 - z) / (1 - cos) * rows).astype(int), 0, rows - 1)
    column = np.clip(((np.arctan2(y, x) / (2 * np.pi) + 0.5) * rows).astype(int), 0, rows - 1)
    counts = np.bincount(row * rows + column, minlength=rows * rows)

    directions, solid_angle = _directions(group, point, rows * fine)
    lane, vector, triangle = _met(group, point, directions)
    density = np.bincount(lane, _pdf(group, point, vector, triangle), minlength=directions.shape[1])
    expected = density.reshape(rows, fine, rows, fine).sum(axis=(1, 3)).ravel() * solid_angle
    assert expected.sum() == pytest.approx(1, abs=5e-3)
    expected *= SAMPLES / expected.sum()
    order = np.argsort(expected)
    pool = np.searchsorted(np.cumsum(expected[order]), 10.0) + 1
    counts, expected = counts[order], expected[order]
    counts = np.append(counts[:pool].sum(), counts[pool:])
    expected = np.append(expected[:pool].sum(), expected[pool:])
    assert stats.chisquare(counts, expected).pvalue > 0.01 / len(CASES)


def test_measure_is_one_over_the_density(case):
    group, point = case
    to_light, measure, u = _sample(group, point, 20_000)
    triangle = None
    if group.is_mesh:
        position = np.tile(point[:, None], to_light.shape[1])
        triangle = group.piece(None, position, u[0])
    product = _pdf(group, point, to_light, triangle) * measure
    assert np.quantile(np.abs(product - 1), 0.999) < 2e-3


def test_image_of_the_world_brings_its_mean_from_everywhere():
    group = _group(world=_image())
    to_light, measure, _ = _sample(group, np.zeros(3), 200_000)
    value = group.tint(None, to_light) * measure
    error = value.std(axis=1) / value.shape[1] ** 0.5
    directions, solid_angle = _directions(group, np.zeros(3), 600)
    truth = group.tint(None, directions).sum(axis=1, dtype=np.float64) * solid_angle
    assert (np.abs(value.mean(axis=1) - truth) < 4 * error + 1e-3 * truth).all()
    # By luminance: a grey picture has no variance but next to the poles.
    luminance = np.array((0.2126, 0.7152, 0.0722)) @ value
    assert luminance.std() < 0.1 * luminance.mean()


# -- all lights of a scene -------------------------------------------------------------------------


def _scene_lights() -> SceneLights:
    matrix = (
        Material(),
        Material(surface=Emission(1.0, OfSurface(lambda points: points.position[0] ** 2))),
        Material(0.0, (3.0, 2.0, 1.0)),
    )
    meshes = (floor(), box((2, 2, 2), (3, 3, 3), materials=1), box((-3, 2, 2), (-2, 3, 3), materials=2))
    triangles, _ = gather_triangles(meshes, FRAME)
    world = World(0.3, image=_image().image)
    groups, _ = emitter_groups(mixed_lights(20), world, matrix, triangles, FRAME)
    return SceneLights(groups, SurfaceShader(matrix, triangles, FRAME), triangles)


def test_all_lights_are_sampled_as_each_group_says():
    lights = _scene_lights()
    random = np.random.default_rng(2)
    count = 400 * len(lights)
    light = np.sort(random.integers(0, len(lights), count))
    position = random.uniform(-2, 2, (3, count)).astype(np.float32)
    u = random.random((3, count), np.float32)
    to_light, weight, at_infinity = lights.sample_in_space(light, position, u[:2], u[2])
    strength = lights.strength_in_space(light, position, to_light, u[2])
    density = lights.density_in_space(light, position, to_light, u[2])
    assert np.isfinite(strength).all() and (strength >= 0).all() and not np.isnan(density).any()
    assert np.array_equal(at_infinity, np.isinf(lights.reach)[light])
    beyond = np.linalg.norm(position + to_light - lights.centre[:, light], axis=0) - lights.reach[light]
    assert (beyond < 1e-5).all()
    # As surfaces have it, who need a normal for the same.
    points = SimpleNamespace(position=position)
    rows = np.arange(count)
    samples = SimpleNamespace(light=light, to_light=to_light, at=rows, w=u[2], take=lambda rows: samples)
    assert np.array_equal(strength, lights.strength(points, samples, rows))


def test_the_only_light_needs_no_number():
    nothing, _ = gather_triangles([], FRAME)
    groups, _ = emitter_groups([PointLight(1.0, radius=0.2)], World(), [Material()], nothing, FRAME)
    lights = SceneLights(groups, SurfaceShader([Material()], nothing, FRAME), nothing)
    position, u = np.ones((3, 5)), np.full((3, 5), 0.4, np.float32)
    alone = lights.sample_in_space(None, position, u[:2], u[2])
    numbered = lights.sample_in_space(np.zeros(5, int), position, u[:2], u[2])
    assert all(np.array_equal(a, b) for a, b in zip(alone, numbered, strict=True))
    assert lights.strength_in_space(None, position, alone[0], u[2]).shape == (3, 1)
    assert lights.density_in_space(None, position, alone[0], u[2]).shape == (5,)
