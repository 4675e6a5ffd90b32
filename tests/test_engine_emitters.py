# SPDX-License-Identifier: GPL-3.0-or-later
"""Every light's sampling routine against its density: chi-square, measure, and integrals over directions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from scenes import place, whole_pieces
from scipy import stats

from engine_core import AreaLight, Light, Material, Mesh, PointLight, SpotLight, SunLight, World
from engine_core.geometry.frame import Frame
from engine_core.geometry.triangles import gather_triangles
from engine_core.transport.emitters import Emitters, MeshEmitters, emitter_groups

SAMPLES = 200_000
ROWS, COLUMNS, FINE = 20, 40, 24
CONFIDENCE = 0.01

# The shaded point, and the normal of its surface.
POINT = np.array([0.2, -0.1, 0.3])
NORMAL = np.array([0.36, 0.48, 0.8])
FRAME = Frame(np.zeros(3), 1.0)

Density = Callable[[np.ndarray], np.ndarray]
Figure = Callable[[np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Case:
    """A light, the density that directions (3, N) to it should have, and a cone that holds them all."""

    name: str
    density: Density
    axis: np.ndarray
    cos: float
    lights: tuple[Light, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    world: World = field(default_factory=World)

    def group(self) -> Emitters:
        triangles, _ = gather_triangles(self.meshes, FRAME)
        if self.meshes:
            # As one light, however few its triangles.
            return MeshEmitters(np.ones((1, 3)), whole_pieces(triangles, np.arange(len(triangles))))
        groups, messages = emitter_groups(self.lights, self.world, (Material(),), triangles, FRAME)
        assert len(groups) == 1 and len(groups[0]) == 1 and not messages
        return groups[0]

    def grid(self, rows: int, columns: int) -> tuple[np.ndarray, float]:
        """(3, rows * columns) directions amid cells of equal solid angle, and that solid angle."""
        z = 1 - (1 - self.cos) * (np.arange(rows)[:, None] + 0.5) / rows
        phi = 2 * np.pi * (np.arange(columns) + 0.5) / columns - np.pi
        r = np.sqrt(1 - z * z)
        local = np.stack(np.broadcast_arrays(r * np.cos(phi), r * np.sin(phi), z)).reshape(3, -1)
        return _frame(self.axis) @ local, 2 * np.pi * (1 - self.cos) / (rows * columns)


def _unit(v: Any) -> np.ndarray:
    return np.asarray(v, float) / np.linalg.norm(v)


def _frame(axis: np.ndarray) -> np.ndarray:
    """(3, 3), its columns two perpendicular vectors and the axis."""
    side = _unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    return np.stack([side, np.cross(axis, side), axis], axis=1)


def _in_cone(axis: np.ndarray, cos: float) -> Density:
    return lambda d: (axis @ d >= cos) / (2 * np.pi * (1 - cos))


def _in_plane(matrix: np.ndarray, area: float, inside: Figure) -> Density:
    """Uniform over a figure in the matrix' XY plane, as a density of directions: d^2 / (A cos)."""
    x_axis, y_axis, normal, centre = matrix[:3].T
    normal = _unit(normal)

    def density(d: np.ndarray) -> np.ndarray:
        cos = normal @ d
        cos = np.where(np.abs(cos) > 1e-9, cos, 1e-9)
        t = (centre - POINT) @ normal / cos
        hit = POINT[:, None] + t * d - centre[:, None]
        x, y = x_axis @ hit / (x_axis @ x_axis), y_axis @ hit / (y_axis @ y_axis)
        return np.where((t > 0) & inside(x, y), t * t / (area * np.abs(cos)), 0)

    return density


def _sphere(name: str, centre: Any, radius: float, spot: bool = False) -> Case:
    axis = np.asarray(centre) - POINT
    cos = np.sqrt(1 - radius**2 / (axis @ axis))
    if spot:  # of 180 degrees, far inside of which the point lies: attenuation 1
        towards = np.eye(4)
        towards[:3, :3] = _frame(_unit(axis))
        towards[:3, 3] = centre
        light = SpotLight(1.0, light_to_world=towards, radius=radius, angle=np.pi, blend=0.1)
    else:
        light = PointLight(1.0, position=centre, radius=radius)
    return Case(name, _in_cone(_unit(axis), cos), _unit(axis), cos, (light,))


def _inside_sphere() -> Case:
    light = PointLight(1.0, position=POINT + (0.2, 0.1, -0.3), radius=0.8)
    return Case("inside a sphere", lambda d: np.maximum(NORMAL @ d, 0) / np.pi, NORMAL, 0.0, (light,))


def _disk(name: str, centre: Any, radius: float) -> Case:
    """A disk that faces the point, from which it is a cone."""
    axis = np.asarray(centre) - POINT
    cos = 1 / np.sqrt(1 + radius**2 / (axis @ axis))
    light = PointLight(1.0, position=centre, radius=radius, sphere=False)
    return Case(name, _in_cone(_unit(axis), cos), _unit(axis), cos, (light,))


def _area(name: str, matrix: np.ndarray, size: tuple[float, float], ellipse: bool, **fields: Any) -> Case:
    """The density is the light's own `pdf`, whose integral is tested, within the figure."""
    w, h = np.array(size) / 2
    if ellipse:
        figure = _in_plane(matrix, 1.0, lambda x, y: (x / w) ** 2 + (y / h) ** 2 <= 1)
    else:
        figure = _in_plane(matrix, 1.0, lambda x, y: (np.abs(x) <= w) & (np.abs(y) <= h))
    corners = [(matrix @ (a * w, b * h, 0, 1))[:3] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    axis = _unit(matrix[:3, 3] - POINT)
    cos = min(_unit(corner - POINT) @ axis for corner in corners)
    light = AreaLight(1.0, light_to_world=matrix, size=size, ellipse=ellipse, **fields)
    normal = _unit(matrix[:3, 2])
    (group,) = emitter_groups((light,), World(), (Material(),), gather_triangles((), FRAME)[0], FRAME)[0]

    def density(d: np.ndarray) -> np.ndarray:
        to_light = d * ((matrix[:3, 3] - POINT) @ normal / (normal @ d))
        where = (np.tile(v.astype(np.float32)[:, None], d.shape[1]) for v in (POINT, NORMAL))
        pdf = group.pdf(None, *where, to_light.astype(np.float32)).astype(float)
        return np.where(figure(d) > 0, pdf, 0)

    return Case(name, density, axis, cos, (light,))


def _half_disk(name: str, count: int, centre: Any = (0.5, -0.4, 2.0)) -> Case:
    """Emissive triangles of unlike size, a fan that fills half a polygon; the density is their own."""
    angle = np.concatenate([[0], np.cumsum(np.arange(1, count + 1))]) * np.pi / np.arange(1, count + 1).sum()
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    matrix = place(centre, (0.4, 0.3, 0.2))
    local = np.zeros((count + 2, 3))
    local[1:, :2] = rim
    index = np.arange(1, count + 1)
    mesh = Mesh(
        local @ matrix[:3, :3].T + matrix[:3, 3], np.stack([np.zeros_like(index), index, index + 1], axis=1)
    )

    def inside(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        beyond = [
            (b[0] - a[0]) * (y - a[1]) < (b[1] - a[1]) * (x - a[0])
            for a, b in zip(rim[:-1], rim[1:], strict=True)
        ]
        return (y >= 0) & ~np.any(beyond, axis=0)

    figure = _in_plane(matrix, 1.0, inside)
    triangles, _ = gather_triangles((mesh,), FRAME)
    group = MeshEmitters(np.ones((1, 3)), whole_pieces(triangles, np.arange(count)))

    def density(d: np.ndarray) -> np.ndarray:
        to_light = d * ((matrix[:3, 3] - POINT) @ matrix[:3, 2] / (matrix[:3, 2] @ d))
        x, y, _ = matrix[:3, :3].T @ (to_light + POINT[:, None] - matrix[:3, 3:])
        wedge = np.clip(np.searchsorted(angle, np.arctan2(y, x)) - 1, 0, count - 1)
        where = (np.tile(v.astype(np.float32)[:, None], d.shape[1]) for v in (POINT, NORMAL))
        pdf = group.pdf_of_piece(wedge, *where, to_light.astype(np.float32)).astype(float)
        return np.where(figure(d) > 0, pdf, 0)

    axis = _unit(mesh.vertices.mean(axis=0) - POINT)
    cos = min(_unit(v - POINT) @ axis for v in mesh.vertices.astype(float))
    return Case(name, density, axis, cos - 1e-3, meshes=(mesh,))


def _sun(name: str, angle: float) -> Case:
    axis = _unit((0.3, 0.5, 0.9))
    cos = np.cos(angle / 2)
    return Case(name, _in_cone(axis, cos), axis, cos, (SunLight(1.0, direction=-axis, angle=angle),))


TILTED = place((0.9, -0.6, 1.4), (0.5, -0.7, 0.3))
NEAR = place(POINT + (0.0, 0.1, 0.3), (0.1, 0.1, 0.0))
LOW = place(POINT + (0.9, -0.3, -0.2), (np.pi / 2, 0.3, 1.3))
WALL = place(POINT + (0.5, 0.3, 1.0), (0.0, 0.6, 0.0))

CASES = [
    _sphere("sphere", (0.9, 0.5, 1.5), 0.5),
    _sphere("large sphere", (0.9, 0.5, 1.5), 1.45),
    _sphere("small sphere", (0.9, 0.5, 1.5), 1e-3),
    _sphere("spot sphere", (0.9, 0.5, 1.5), 0.4, spot=True),
    _inside_sphere(),
    _disk("facing disk", (0.9, 0.5, 1.5), 0.5),
    _disk("large facing disk", (0.9, 0.5, 1.5), 3.0),
    _area("small rectangle", TILTED, (0.5, 0.8), ellipse=False),
    _area("rectangle", TILTED, (1.0, 1.0), ellipse=False),
    _area("near rectangle", NEAR, (2.0, 0.5), ellipse=False),
    _area("wall", WALL, (40.0, 3.0), ellipse=False),
    _area("near ellipse", NEAR, (1.0, 0.5), ellipse=True),
    _area("scaled ellipse", TILTED @ np.diag([1.5, 0.5, 1, 1]), (0.8, 1.2), ellipse=True),
    _area("slanted ellipse", WALL, (6.0, 2.0), ellipse=True),
    _area("rectangle across the horizon", LOW, (1.5, 2.5), ellipse=False),
    _half_disk("mesh", 7),
    _half_disk("near mesh", 5, POINT + (-0.1, -0.2, 0.4)),
    _sun("sun", 0.1),
    _sun("tiny sun", 1e-3),
    _sun("huge sun", 3.0),
    Case("world", lambda d: np.maximum(NORMAL @ d, 0) / np.pi, NORMAL, 0.0, world=World(1.0)),
]


def _sampled(group: Emitters, count: int = SAMPLES, seed: int = 11) -> tuple[np.ndarray, np.ndarray]:
    """Unit directions (3, N) float64 and measures (N,) of pseudo-random samples."""
    u = (np.random.default_rng(seed).integers(0, 1 << 23, (3, count)) + 0.5) / (1 << 23)
    u = u.astype(np.float32)
    position, normal = (np.tile(v.astype(np.float32)[:, None], count) for v in (POINT, NORMAL))
    to_light, measure = group.sample(None, position, normal, u[0], u[1:])
    to_light = np.asarray(to_light, np.float64)
    # A light without size has a strength instead of a radiance.
    size = group.size[0] or 1.0
    return to_light / np.linalg.norm(to_light, axis=0), size * np.broadcast_to(measure, count)


@pytest.fixture(params=CASES, ids=lambda case: case.name)
def case(request: pytest.FixtureRequest) -> Case:
    return request.param


def test_sampled_directions_have_the_density(case: Case):
    direction, _ = _sampled(case.group())
    x, y, z = _frame(case.axis).T @ direction
    # 1 - z from the sine keeps its digits in a narrow cone.
    below = (x * x + y * y) / (1 + z)
    row = np.clip((below / (1 - case.cos) * ROWS).astype(int), 0, ROWS - 1)
    column = np.clip(((np.arctan2(y, x) / (2 * np.pi) + 0.5) * COLUMNS).astype(int), 0, COLUMNS - 1)
    counts = np.bincount(row * COLUMNS + column, minlength=ROWS * COLUMNS)

    grid, solid_angle = case.grid(ROWS * FINE, COLUMNS * FINE)
    expected = case.density(grid).reshape(ROWS, FINE, COLUMNS, FINE).sum(axis=(1, 3)).ravel() * solid_angle
    assert expected.sum() == pytest.approx(1, abs=5e-3)
    expected *= SAMPLES / expected.sum()

    order = np.argsort(expected)
    pool = np.searchsorted(np.cumsum(expected[order]), 5.0) + 1
    counts, expected = counts[order], expected[order]
    if expected[:pool].sum() > 0:
        counts = np.append(counts[:pool].sum(), counts[pool:])
        expected = np.append(expected[:pool].sum(), expected[pool:])
    p = stats.chisquare(counts, expected).pvalue
    assert p > 1 - (1 - CONFIDENCE) ** (1 / len(CASES))


def test_measure_is_one_over_the_density(case: Case):
    direction, measure = _sampled(case.group(), 20_000)
    product = measure * case.density(direction)
    # Rounding puts a few samples on the outer side of the light's edge, where the density is 0.
    inside = product > 0
    assert inside.mean() > 0.995
    assert np.quantile(np.abs(product[inside] - 1), 0.999) < 2e-3


def test_the_ends_of_the_unit_interval_are_samples_like_those_beside_them(case: Case):
    """Nodes of polynomials lie there."""

    def sampled(low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
        u = np.array(np.meshgrid([low, 0.3, high], [low, 0.7, high], [low, 0.4, high]), np.float32)
        u = u.reshape(3, -1)
        at = (np.tile(v.astype(np.float32)[:, None], u.shape[1]) for v in (POINT, NORMAL))
        to_light, measure = case.group().sample(None, *at, u[0], u[1:])
        # Of light from the horizon there is much for a point, but not for a surface.
        cosine = NORMAL @ to_light / np.sqrt((to_light * to_light).sum(axis=0))
        return to_light, measure * cosine

    at_ends, beside = sampled(0, 1), sampled(2.0**-20, 1 - 2.0**-20)
    # Cosines end as a root of u, of which float32 has few digits: directions differ by the root of 2^-20.
    for ends, near, apart in zip(at_ends, beside, (1e-2, 1e-1), strict=True):
        assert np.isfinite(ends).all()
        assert np.abs(ends - near).max() < apart * np.abs(near).max()


def test_mean_of_measure_times_function_is_its_integral(case: Case):
    direction, measure = _sampled(case.group())
    grid, solid_angle = case.grid(1000, 1000)
    lit = case.density(grid) > 0
    for function in (
        lambda d: np.ones(d.shape[1]),
        lambda d: np.maximum(NORMAL @ d, 0),
        lambda d: np.exp(2 * (d[0] - d[1]) * d[2]),
    ):
        truth = function(grid)[lit].sum() * solid_angle
        values = measure * function(direction)
        if case.name in ("world", "inside a sphere"):
            # pi / cos alone has no variance to be measured by: take what a surface sees of it.
            truth = (function(grid) * np.maximum(NORMAL @ grid, 0))[lit].sum() * solid_angle
            values = values * np.maximum(NORMAL @ direction, 0)
        error = values.std(ddof=1) / np.sqrt(SAMPLES)
        assert abs(values.mean() - truth) < 4 * error + 2e-3 * truth


def test_all_clusters_of_a_mesh_together_are_the_mesh():
    case = _half_disk("mesh", 50)
    triangles, _ = gather_triangles(case.meshes, FRAME)
    (group,), _ = emitter_groups((), World(), (Material(0.0, 1.0),), triangles, FRAME)
    assert len(group) > 3
    count = 50_000
    u = np.random.default_rng(5).random((3, count), np.float32)
    position, normal = (np.tile(v.astype(np.float32)[:, None], count) for v in (POINT, NORMAL))
    total = variance = 0.0
    for light in range(len(group)):
        _, measure = group.sample(np.full(count, light), position, normal, u[0], u[1:])
        measure = measure * group.size[light]
        total += measure.mean(dtype=np.float64)
        variance += measure.var(dtype=np.float64) / count
    grid, solid_angle = case.grid(1500, 1500)
    truth = (case.density(grid) > 0).sum() * solid_angle
    assert total == pytest.approx(truth, abs=4 * variance**0.5, rel=1e-3)


SPOTS = {
    "spot": ((0.3, 0, 0), 1.0, {"angle": 1.0, "radius": 0.3}),
    "spot scaled along its axis": ((0, 0, 0), (1, 1, 10), {"angle": 0.8, "radius": 0.2}),
    "spot of half the width": ((0, 0, 0), (0.3, 1, 1), {"angle": 0.8, "radius": 0.2, "blend": 0.0}),
    "spot of a large disk": ((0, 0, 0), 1.0, {"angle": 0.8, "radius": 1.0, "sphere": False, "blend": 0.0}),
    "wide spot": ((0, 0, 0), 1.0, {"angle": 2.3, "radius": 1.0, "blend": 0.0}),
}


@pytest.mark.parametrize("spread", [np.pi, 2.0, 1.0])
@pytest.mark.parametrize("position", [(0, 0, 0.0), (-0.5, 0.2, 0.3), (-1, 0, -4)])
def test_what_does_not_shine_straight_ahead_is_the_integral_over_its_area(
    spread: float, position: tuple[float, ...]
):
    """Of cos / d^2, the cosine to its Z, near and far (by solid angle all shine straight ahead)."""
    to_world = place((0, 0, 1), (0.3, 0.2, 0))
    to_world[:3, 2] += 0.7 * to_world[:3, 0]
    triangles, _ = gather_triangles([], FRAME)
    light = AreaLight(1.0, light_to_world=to_world, size=(2, 0.5), spread=spread)
    (group,), _ = emitter_groups([light], World(), [Material()], triangles, FRAME)
    random, count = np.random.default_rng(3), 40_000
    u = random.random((3, count), np.float32)
    here = np.repeat(np.float32(position)[:, None], count, axis=1)
    _, measure = group.sample(None, here, None, u[0], u[1:])

    x, y = (a.ravel() for a in np.meshgrid(*2 * [(np.arange(1000) + 0.5) / 1000 - 0.5]))
    across, up = 2 * to_world[:3, :1] * x, 0.5 * to_world[:3, 1:2] * y
    vector = to_world[:3, 3:] + across + up - np.reshape(position, (3, 1))
    square = (vector * vector).sum(axis=0)
    cosine = np.maximum(to_world[:3, 2] @ vector / np.linalg.norm(to_world[:3, 2]) / np.sqrt(square), 1e-9)
    truth = np.where(cosine > 1e-9, cosine, 0) / square
    if spread < np.pi:
        tan_half = np.tan(spread / 2)
        tan = np.sqrt(1 - np.minimum(cosine, 1) ** 2) / cosine
        truth *= np.maximum(tan_half - tan, 0) / (tan_half - spread / 2)
    deviation = float(measure.std()) / count**0.5
    assert float(measure.mean()) == pytest.approx(float(truth.mean()), abs=5 * deviation, rel=1e-4)


AREAS = {
    "area": ((2, 0.5), {}),
    "grid": ((2, 0.5), {"spread": 0.6}),
    "wide grid": ((2, 0.5), {"spread": 2.2}),
    "round grid": ((2, 1.5), {"spread": 1.0, "ellipse": True}),
    "large narrow grid": ((6, 4), {"spread": 0.1}),
    "oblique grid": ((2, 0.5), {"spread": 1.0}),
    "small grid": ((0.02, 0.02), {"spread": 1.0}),
}


@pytest.mark.parametrize("kind", ["point", "sphere", "disk", *SPOTS, *AREAS, "sun", "mesh", "world"])
def test_estimate_for_choosing_is_positive_wherever_the_light_may_reach(kind: str):
    lights = {
        "point": PointLight(1.0, position=(0, 0, 1)),
        "sphere": PointLight(1.0, position=(0, 0, 1), radius=0.7),
        "disk": PointLight(1.0, position=(0, 0, 1), radius=0.7, sphere=False),
        "sun": SunLight(1.0, direction=(0.2, 0.1, -1), angle=1.0),
    }
    for name, (turn, scale, fields) in SPOTS.items():
        lights[name] = SpotLight(1.0, light_to_world=place((0, 0, 1), turn, scale), **fields)
    for name, (size, fields) in AREAS.items():
        to_world = place((0, 0, 1), (0.3, 0.2, 0))
        if "oblique" in name:
            to_world[:3, 2] += 0.7 * to_world[:3, 0]
        lights[name] = AreaLight(1.0, light_to_world=to_world, size=size, **fields)
    meshes = [Mesh(np.eye(3) + (0, 0, 1), [[0, 1, 2]])] if kind == "mesh" else []
    triangles, _ = gather_triangles(meshes, FRAME)
    (group,), _ = emitter_groups(
        [lights[kind]] if kind in lights else [],
        World(1.0 if kind == "world" else 0.0),
        [Material(0.0, 1.0)],
        triangles,
        FRAME,
    )
    random = np.random.default_rng(9)
    count = 20_000
    position = random.uniform(-3, 3, (3, count)).astype(np.float32)
    normal = random.normal(size=(3, count))
    normal = (normal / np.linalg.norm(normal, axis=0)).astype(np.float32)
    reached = np.zeros(count, bool)
    for _ in range(8):
        u = random.random((3, count), np.float32)
        to_light, measure = group.sample(None, position, normal, u[0], u[1:])
        reached |= (measure > 0) & ((normal * to_light).sum(axis=0) > 0)
    assert reached.any()
    estimate = group.irradiance(position, normal)[0]
    assert (estimate[reached] > 0).all()
    if "grid" in kind and kind != "oblique grid":
        # A grid leaves most places in the dark, and the estimate says so.
        assert (estimate > 0).mean() < 2.5 * reached.mean()
