# SPDX-License-Identifier: GPL-3.0-or-later
"""What MIS asks of every light: the pdf of its map, and which lights a direction meets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import floor, place
from test_engine_emitters import CASES, FRAME, NORMAL, POINT, Case, _frame

from engine_core import (
    AreaLight,
    Camera,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    World,
    render,
)
from engine_core.errors import SceneError
from engine_core.geometry.triangles import gather_triangles
from engine_core.shading.closures import Diffuse
from engine_core.shading.coordinates import NORMAL as SURFACE_NORMAL
from engine_core.transport.emitters import Emitters, emitter_groups
from engine_core.transport.emitters.bounds import Bounds
from engine_core.transport.emitters.environment_map import LUMINANCE

SIZED = [case for case in CASES if not case.meshes]


def _at(count: int, point: np.ndarray = POINT, normal: np.ndarray = NORMAL) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.tile(v.astype(np.float32)[:, None], count) for v in (point, normal))


def _met(group: Emitters, direction: np.ndarray, point: np.ndarray = POINT) -> tuple[np.ndarray, ...]:
    """(lane, light, distance, gain) of all rays (3, N) from ``point``."""
    position, _ = _at(direction.shape[1], point)
    parts = list(group.hits(position, direction.astype(np.float32)))
    gain = [np.ones(len(p.lane)) if p.gain is None else p.gain for p in parts]
    return (*(np.concatenate([p[k] for p in parts]) for k in range(3)), np.concatenate(gain))


@pytest.mark.parametrize("case", SIZED, ids=lambda case: case.name)
def test_pdf_is_one_over_the_measure(case: Case):
    group = case.group()
    count = 20_000
    u = np.random.default_rng(3).random((3, count), np.float32)
    where = _at(count)
    to_light, measure = group.sample(None, *where, u[0], u[1:])
    pdf = group.pdf(None, *where, to_light)
    product = pdf * measure * np.float32(group.size[0])
    lit = measure > 0
    assert np.quantile(np.abs(product[lit] - 1), 0.999) < 1e-3
    assert np.isfinite(pdf).all() and (pdf >= 0).all()


@pytest.mark.parametrize("case", SIZED, ids=lambda case: case.name)
def test_pdf_over_what_directions_meet_is_a_density(case: Case):
    group = case.group()
    grid, solid_angle = case.grid(800, 800)
    lane, light, distance, gain = _met(group, grid)
    assert (light == 0).all() and np.isfinite(distance).all() and (distance > 0).all()
    assert gain == pytest.approx(1, abs=1e-5)
    to_light = (grid[:, lane] * distance).astype(np.float32)
    pdf = np.broadcast_to(group.pdf(None, *_at(len(lane)), to_light), len(lane))
    assert pdf.sum(dtype=np.float64) * solid_angle == pytest.approx(1, abs=6e-3)
    truth = case.density(grid[:, lane])
    inside = truth > 0
    assert inside.mean() > 0.99
    assert np.quantile(np.abs(pdf[inside] / truth[inside] - 1), 0.99) < 2e-3


@pytest.mark.parametrize("case", SIZED, ids=lambda case: case.name)
def test_sampled_directions_meet_their_light_where_they_were_sampled(case: Case):
    group = case.group()
    count = 5_000
    u = np.random.default_rng(4).random((3, count), np.float32)
    to_light, _ = group.sample(None, *_at(count), u[0], u[1:])
    length = np.linalg.norm(to_light.astype(float), axis=0)
    lane, _, distance, _ = _met(group, to_light / length)
    # Rounding turns a few at the rim away.
    assert len(np.unique(lane)) == len(lane) > 0.995 * count
    if not group.at_infinity:
        assert np.quantile(np.abs(distance / length[lane] - 1), 0.99) < 1e-4


def _mesh(random: np.random.Generator, count: int) -> tuple[Emitters, np.ndarray]:
    corner = random.uniform(-1, 1, (count, 3)) + (0, 0, 2)
    vertices = (corner[:, None] + random.normal(size=(count, 3, 3)) * 0.3).reshape(-1, 3)
    dark = Mesh(np.eye(3), [[0, 1, 2]], materials=np.array([1]))
    mesh = Mesh(vertices, np.arange(3 * count).reshape(-1, 3), materials=np.zeros(count, int))
    triangles, _ = gather_triangles([dark, mesh], FRAME)
    (group,), _ = emitter_groups((), World(), (Material(0.0, 1.0), Material()), triangles, FRAME)
    return group, triangles.vertices[triangles.indices]


def test_mesh_tells_where_it_was_sampled_and_with_which_density():
    group, corners = _mesh(np.random.default_rng(8), 40)
    assert (group.row > 0).all()
    count = 20_000
    random = np.random.default_rng(6)
    which = random.integers(0, len(group), count)
    u = random.random((3, count), np.float32)
    where = _at(count)
    to_light, measure = group.sample(which, *where, u[0], u[1:])
    piece = group.piece(which, where[0], u[0])
    assert (group.light_of[piece] == which).all()
    triangle, b1, b2 = group.place_of(piece, where[0], to_light)
    a, b, c = corners[triangle].transpose(1, 2, 0)
    point = a + b1 * (b - a) + b2 * (c - a)
    assert np.quantile(np.abs(point - where[0] - to_light), 0.99) < 1e-5
    pdf = group.pdf_of_piece(piece, *where, to_light)
    assert np.allclose(pdf * measure * group.size[which], 1, rtol=1e-3)


MANY = {
    "spheres": lambda p, i: PointLight(1.0, position=p, radius=0.1 + 0.2 * (i % 3), visible_to_camera=True),
    "disks": lambda p, i: PointLight(
        1.0, position=p, radius=0.1 * (i % 3), sphere=False, visible_to_camera=True
    ),
    "areas": lambda p, i: AreaLight(
        1.0, light_to_world=_placed(p), size=(1, 0.5), ellipse=i % 2 == 0, visible_to_camera=True
    ),
    "suns": lambda p, i: SunLight(1.0, direction=-p, angle=0.2 * (i % 4), visible_to_camera=True),
}


def _placed(p: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = _frame(p / np.linalg.norm(p))
    matrix[:3, 3] = p
    return matrix


@pytest.mark.parametrize("kind", MANY)
def test_many_lights_are_met_one_by_one_as_together(kind: str):
    random = np.random.default_rng(12)
    lamps = [MANY[kind](p, i) for i, p in enumerate(random.normal(size=(80, 3)) * 2)]
    nothing, _ = gather_triangles([], FRAME)

    def group_of(lights):
        (group,) = (
            g for g in emitter_groups(lights, World(), [Material()], nothing, FRAME)[0] if not g.is_point
        )
        return group

    sized = [lamp for lamp in lamps if getattr(lamp, "radius", 1) > 0]
    direction = random.normal(size=(3, 3000))
    direction /= np.linalg.norm(direction, axis=0)
    together = group_of(sized)
    lane, light, distance, _ = _met(together, direction, np.zeros(3))
    assert len(lane) > 200
    order = np.lexsort((lane, light))
    number = [i for i, lamp in enumerate(sized) if getattr(lamp, "angle", 1) > 0]
    alone = [_met(group_of([sized[i]]), direction, np.zeros(3)) for i in number]
    assert np.array_equal(lane[order], np.concatenate([a[0] for a in alone]))
    assert np.array_equal(light[order], np.repeat(number, [len(a[0]) for a in alone]))
    assert np.allclose(distance[order], np.concatenate([a[2] for a in alone]), rtol=1e-5)
    origins = np.zeros((3000, 3), np.float32)
    seen = together.seen(origins, 2 * direction.T.astype(np.float32), np.full(3000, np.inf, np.float32))
    expected = np.bincount(lane, together.radiance[0, light], minlength=3000)
    assert np.allclose(seen[0], expected, rtol=1e-5)


@pytest.mark.parametrize("sphere", [True, False])
def test_gain_is_the_cone_and_the_grid_that_sampling_has(sphere: bool):
    towards = np.eye(4)
    towards[:3, :3] = _frame(np.array([0.6, 0, 0.8]))
    towards[:3, 3] = POINT + (0.3, 0.4, 1.5)
    lights = (
        SpotLight(1.0, light_to_world=towards, radius=0.7, sphere=sphere, angle=0.9, blend=0.6),
        AreaLight(1.0, light_to_world=towards, size=(1.5, 1), spread=1.2),
    )
    nothing, _ = gather_triangles([], FRAME)
    groups, _ = emitter_groups(lights, World(), [Material()], nothing, FRAME)
    count = 20_000
    u = np.random.default_rng(7).random((3, count), np.float32)
    for group in groups:
        to_light, measure = group.sample(None, *_at(count), u[0], u[1:])
        lane, _, distance, gain = _met(group, to_light / np.linalg.norm(to_light, axis=0))
        pdf = np.broadcast_to(group.pdf(None, *_at(count), to_light), count)
        weight = measure * pdf * np.float32(group.size[0])
        assert gain.max() > 0 and gain.min() < 0.9 * gain.max()
        assert np.abs(weight[lane] - gain).max() < 2e-3 * gain.max()


def test_lights_without_size_are_never_met():
    lights = (PointLight(1.0, position=(0, 0, 1)), SunLight(1.0), SpotLight(1.0))
    nothing, _ = gather_triangles([], FRAME)
    groups, _ = emitter_groups(lights, World(), [Material()], nothing, FRAME)
    for group in groups:
        assert not list(group.hits(*_at(10)))
        assert not np.any(group.pdf(np.zeros(10, int), *_at(10), _at(10)[1]))


# Centre from the shaded point, rotation, size: near and far, edge-on, behind the horizon, long.
PLACES = {
    "far": ((30, 20, 50), (0.4, -0.5, 0.3), (1.0, 2.0)),
    "of 1e-6 sr": ((600, 400, 1000), (0.4, -0.5, 0.3), (1.0, 2.0)),
    "of 1e-12 sr": ((6e5, 4e5, 1e6), (0.4, -0.5, 0.3), (1.0, 2.0)),
    "near": ((0.3, 0.2, 0.1), (0.2, -0.1, 0.3), (1.0, 2.0)),
    "very near": ((0.3, 0.2, 0.06), (0, 0, 0), (3.0, 2.0)),
    "edge-on": ((2, 0.3, 0.02), (0, 0, 0), (1.0, 1.5)),
    "behind the horizon": ((0.6, 0.3, -1.0), (2.5, 0.4, 0), (1.0, 1.0)),
    "across the horizon": ((1, 0.2, -0.2), (0, 1.4, 0.2), (3.0, 2.0)),
    "long": ((2, 0.1, 0.5), (0.3, 0, 0), (8.0, 0.05)),
    "long from its end": ((4.2, 0.01, 0.3), (0, 0.1, 0), (8.0, 0.2)),
}


def _points_on(matrix: np.ndarray, size: tuple[float, float], ellipse: bool, n: int) -> np.ndarray:
    """(3, n * n) points on an area light, their middle uniform in area."""
    x, y = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(n) + 0.5) / n)
    if ellipse:
        x, y = (0.5 * np.sqrt(x) * f(2 * np.pi * y) for f in (np.cos, np.sin))
    else:
        x, y = x - 0.5, y - 0.5
    local = np.stack([x.ravel() * size[0], y.ravel() * size[1], np.zeros(n * n)])
    return matrix[:3, :3] @ local + matrix[:3, 3:]


@pytest.mark.parametrize("spread", [np.pi, 0.7])
@pytest.mark.parametrize("ellipse", [False, True], ids=["rectangle", "ellipse"])
@pytest.mark.parametrize("scale", [2.0**-20, 1.0, 2.0**20])
@pytest.mark.parametrize("where", PLACES)
def test_maps_hold_from_everywhere(where: str, scale: float, ellipse: bool, spread: float):
    centre, rotation, size = PLACES[where]
    matrix = place(centre, rotation)
    matrix[:3, 3] *= scale
    size = (size[0] * scale, size[1] * scale)
    light = AreaLight(1.0, light_to_world=matrix, size=size, ellipse=ellipse, spread=spread)
    nothing, _ = gather_triangles([], FRAME)
    (group,), _ = emitter_groups([light], World(), [Material()], nothing, FRAME)
    area = group.size[0]

    count = 20_000
    u = np.random.default_rng(1).random((3, count), np.float32)
    at = _at(count, np.zeros(3))
    to_light, measure = group.sample(None, *at, u[0], u[1:])
    assert np.isfinite(to_light).all() and np.isfinite(measure).all() and (measure >= 0).all()
    pdf = group.pdf(None, *at, to_light)
    assert np.isfinite(pdf).all() and (pdf >= 0).all()

    # Solid angle of the light, and of what its pdf says of it, by quadrature over its area.
    points = _points_on(matrix, size, ellipse, 500)
    unit_normal = -matrix[:3, 2]
    square = (points**2).sum(axis=0)
    angle = np.maximum(-(unit_normal @ points), 0) / square**1.5 * (area / points.shape[1])
    if angle.sum() == 0:
        assert not measure.any()
        return
    at = _at(points.shape[1], np.zeros(3))
    said = group.pdf(None, *at, points.astype(np.float32)).astype(float)
    if spread == np.pi:
        assert (said * angle).sum() == pytest.approx(1, abs=5e-3)
        lit = measure > 0
        assert np.quantile(np.abs(pdf[lit] * measure[lit] * area - 1), 0.99) < 5e-3
    # What reaches the point of the light's grid, by either.
    cosine = np.maximum(-(unit_normal @ points), 0) / np.sqrt(square)
    truth = (angle * group._grid(None, cosine.astype(np.float32))).sum()
    values = measure.astype(float) * area
    assert abs(values.mean() - truth) <= 5 * values.std() / np.sqrt(count) + 5e-3 * truth


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(
    "shape", ["large", "sliver", "around", "edge-on", "far", "of 1e-8 sr", "of 1e-12 sr"]
)
def test_emissive_triangles_have_their_solid_angle(shape: str, scale: float):
    corners = {
        "large": [(1, 0, 1), (0, 1, 1), (-1, -0.5, 1)],
        "sliver": [(5, 0, 1), (5, 0.05, 1), (-5, 0, 1)],
        "around": [(9, 0, 0.02), (-3, 5, 0.02), (-4, -6, 0.02)],
        "edge-on": [(1, 1, 0.01), (2, 1, 0.012), (1, 2, 0.01)],
        "far": [(100, 0, 1), (101, 1, 0), (100, 2, 2)],
        "of 1e-8 sr": [(1e4, 0, 1e4), (1e4 + 1, 1, 1e4), (1e4, 2, 1e4 + 2)],
        "of 1e-12 sr": [(1e6, 0, 1e6), (1e6 + 1, 1, 1e6), (1e6, 2, 1e6 + 2)],
    }[shape]
    mesh = Mesh(np.array(corners, float) * scale, [[0, 1, 2]])
    triangles, _ = gather_triangles([mesh], FRAME)
    (group,), _ = emitter_groups((), World(), (Material(0.0, 1.0),), triangles, FRAME)
    count = 100_000
    u = np.random.default_rng(2).random((3, count), np.float32)
    at = _at(count, np.zeros(3))
    to_light, measure = group.sample(None, *at, u[0], u[1:])
    a, b, c = (v / np.linalg.norm(v) for v in mesh.vertices.astype(float))
    # A. van Oosterom and J. Strackee, 1983; a (b x c) by differences.
    truth = 2 * abs(np.arctan2(a @ np.cross(b - a, c - a), 1 + a @ b + b @ c + c @ a))
    values = measure.astype(float) * group.size[0]
    assert np.isfinite(values).all()
    assert abs(values.mean() - truth) < 5 * values.std() / np.sqrt(count) + 2e-4 * truth
    pdf = group.pdf_of_piece(np.zeros(count, int), *at, to_light)
    assert np.quantile(np.abs(pdf * values - 1), 0.99) < 1e-3


def _sky(height: int = 24, width: int = 48) -> np.ndarray:
    """A picture with black parts, coloured noise, and a sun of one texel."""
    image = np.random.default_rng(3).random((height, width, 3)) ** 3
    image[: height // 4, width // 3 :] = 0
    image[2 * height // 3, width // 4] = (90, 60, 30)
    return image.astype(np.float32)


TURN = place(rotation=(0.4, -0.9, 2.0))[:3, :3]


def _radiance(image: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """(3, N) of an equirectangular picture, interpolated between the four nearest texels."""
    height, width = image.shape[:2]
    x, y, z = direction
    s = (0.5 - np.arctan2(y, x) / (2 * np.pi)) * width - 0.5
    t = (1 - np.arccos(np.clip(z, -1, 1)) / np.pi) * height - 0.5
    column, row = np.floor(s).astype(int), np.floor(t).astype(int)
    s, t = (s - column)[:, None], (t - row)[:, None]

    def texel(j: int, i: int) -> np.ndarray:
        return image[(row + j) % height, (column + i) % width].astype(float)

    below = texel(0, 0) * (1 - s) + texel(0, 1) * s
    return (below * (1 - t) + (texel(1, 0) * (1 - s) + texel(1, 1) * s) * t).T


@pytest.mark.parametrize("image", [_sky(), np.ones((1, 1, 3), np.float32), _sky(2, 3)], ids=["sky", "1", "6"])
def test_light_from_a_picture(image: np.ndarray):
    nothing, _ = gather_triangles([], FRAME)
    world = World(image=image, rotation=TURN)
    (group,), _ = emitter_groups((), world, [Material()], nothing, FRAME)
    count = 400_000
    random = np.random.default_rng(4)
    everywhere = random.normal(size=(3, count))
    everywhere /= np.linalg.norm(everywhere, axis=0)
    light = _radiance(image, TURN @ everywhere)
    (hits,) = group.hits(_at(count)[0], everywhere.astype(np.float32))
    assert np.quantile(np.abs(hits.gain - light), 0.99) < 1e-4 * light.max()

    pdf = group.pdf(None, *_at(count), everywhere.astype(np.float32)).astype(float) * 4 * np.pi
    assert abs(pdf.mean() - 1) < 4 * pdf.std() / np.sqrt(count) + 1e-6
    u = random.random((3, count), np.float32)
    direction, measure = group.sample(None, *_at(count), u[0], u[1:])
    assert np.linalg.norm(direction, axis=0) == pytest.approx(1, abs=1e-5)
    product = group.pdf(None, *_at(count), direction) * measure
    assert np.quantile(np.abs(product - 1), 0.999) < 1e-3
    seen = group.tint(None, direction) * measure
    functions = (
        lambda d: np.ones(d.shape[1]),
        lambda d: (d[2] > 0.3).astype(float),
        lambda d: np.exp(d[0] - d[2]),
    )
    for function in functions:
        uniform = light * np.maximum(NORMAL @ everywhere, 0) * function(everywhere) * 4 * np.pi
        values = seen * np.maximum(NORMAL @ direction, 0) * function(direction)
        error = np.hypot(uniform.std(axis=1), values.std(axis=1)) / np.sqrt(count)
        assert (np.abs(values.mean(axis=1, dtype=float) - uniform.mean(axis=1)) < 4 * error + 1e-4).all()
    # As if all had the mean colour, and more of it next to the horizon.
    irradiance = group.irradiance(POINT[:, None], NORMAL[:, None].astype(np.float32))[0]
    light = LUMINANCE @ light
    found = (light * np.maximum(NORMAL @ everywhere, 0)).mean() * 4 * np.pi
    assert irradiance == pytest.approx(found / light.mean() * group.far_fluence[0] / (4 * np.pi), rel=0.25)


NORMALS = np.array([(0, 0, 1), (0, -1, 0), (1, 1, 0), (-0.3, 0.1, 0.95), (0.5, -0.6, -0.62)], float)


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("normal", NORMALS / np.linalg.norm(NORMALS, axis=1)[:, None], ids=str)
def test_surfaces_are_lit_by_a_picture_by_points_of_nearly_one_weight(normal: np.ndarray, bent: bool):
    """Each brings what all bring in the mean, but for the colour, and what lies below a horizon."""
    ground, _ = gather_triangles([floor()], FRAME)
    image = np.random.default_rng(6).random((40, 80, 1)) ** 4 * np.ones((1, 1, 3))
    image[9:11, 20] = 500
    image[30, 50:52] = 900
    above = Material(surface=Diffuse(0.5, normal=SURFACE_NORMAL if bent else None))
    world = World(image=image.astype(np.float32), rotation=TURN)
    (group,), _ = emitter_groups((), world, [above], ground, FRAME)
    count = 100_000
    random = np.random.default_rng(7)
    u = random.random((3, count), np.float32)
    direction, measure = group.sample(None, *_at(count, POINT, normal), u[0], u[1:])
    density = group.pdf(None, *_at(count, POINT, normal), direction)
    assert np.quantile(np.abs(density * measure - 1), 0.999) < 1e-3
    values = group.tint(None, direction)[0] * measure * np.maximum(normal @ direction, 0)
    everywhere = random.normal(size=(3, 16 * count)).astype(np.float32)
    everywhere /= np.linalg.norm(everywhere, axis=0)
    lit = (normal @ everywhere > 0) & (group.tint(None, everywhere)[0] > 0)
    pdf = group.pdf(None, *_at(lit.sum(), POINT, normal), everywhere[:, lit])
    assert (pdf > 0).all()
    # Its suns are found by samples alone.
    cosine = np.maximum(normal @ everywhere, 0) * group.tint(None, everywhere)[0] * 4 * np.pi
    error = np.hypot(cosine.std() / np.sqrt(16), values.std()) / np.sqrt(count)
    assert abs(values.mean(dtype=float) - cosine.mean(dtype=float)) < 4 * error
    if bent:
        # Some of all directions, wherever they are.
        assert 0.02 < (normal @ direction < 0).mean() < 0.3
    else:
        assert values.std() < 0.5 * values.mean()
    assert values.max() < 6 * values.mean()


def test_a_sun_in_a_picture_is_found():
    nothing, _ = gather_triangles([], FRAME)
    image = np.full((64, 128, 3), 0.1, np.float32)
    image[50, 40] = 2e4
    (group,), _ = emitter_groups((), World(image=image), [Material()], nothing, FRAME)
    count = 20_000
    u = np.random.default_rng(4).random((3, count), np.float32)
    up = np.array([0.0, 0, 1])
    direction, measure = group.sample(None, *_at(count, POINT, up), u[0], u[1:])
    values = group.tint(None, direction)[0] * measure * np.maximum(direction[2], 0)
    # By the cosine alone it would be about 60.
    assert values.std() < 2 * values.mean()


def test_a_picture_is_seen_where_nothing_else_is():
    image = _sky()
    nothing, _ = gather_triangles([], FRAME)
    direction = np.random.default_rng(6).normal(size=(100, 3)).astype(np.float32)
    distance = np.where(np.arange(100) % 2, np.inf, 3).astype(np.float32)
    for visible in (True, False):
        world = World(image=image, rotation=TURN, visible_to_camera=visible)
        (group,), _ = emitter_groups((), world, [Material()], nothing, FRAME)
        assert group.any_visible == visible
        seen = group.seen(np.zeros((100, 3), np.float32), direction, distance)
        if not visible:
            assert seen is None
            continue
        unit = direction.T / np.linalg.norm(direction, axis=1)
        truth = np.where(np.isinf(distance), _radiance(image, TURN @ unit), 0)
        assert np.allclose(seen, truth, atol=1e-4 * truth.max())


def test_a_world_that_is_wrong_is_told():
    for fields, words in (
        ({"image": np.zeros((2, 3))}, "image"),
        ({"image": np.full((2, 3, 3), np.nan)}, "finite"),
        ({"image": np.zeros((0, 3, 3))}, "texel"),
        ({"rotation": np.diag([1, 1, 2])}, "perpendicular"),
    ):
        with pytest.raises(SceneError, match=words):
            World(**fields)


@pytest.mark.parametrize("kind", ["clouds", "flat and far", "in a row"])
def test_rays_leave_each_box_once_and_come_to_an_end(kind):
    """Also those that graze faces, which Embree finds again and again a hair's breadth further on."""
    random = np.random.default_rng(1)
    boxes, rays = (3, 40), (3, 2000)
    if kind == "clouds":
        centre, half = random.normal(size=boxes) * 3, random.uniform(0.01, 1, boxes)
        position, direction = random.normal(size=(2, *rays))
    elif kind == "flat and far":
        stretch = np.array([[3e3], [3e3], [0.0]])
        centre = random.normal(size=boxes) * stretch + [[0], [0], [1e3]]
        half = random.uniform(1, 1000, boxes) * (stretch > 0)
        position = random.normal(size=rays) * (stretch + [[0], [0], [1]]) + [[0], [0], [1e3]]
        direction = random.normal(size=rays) * [[1], [1], [1e-3]]
    else:
        centre = np.arange(40) * [[2.5], [0], [0]]
        half = np.ones(boxes)
        position = random.uniform(-1, 1, rays) * [[0], [1e-3], [1]] + [[-5], [1], [0]]
        direction = random.normal(size=rays) * [[0], [1e-5], [1e-5]] + [[1], [0], [0]]
    low, high = centre - half, centre + half
    position, direction = position.astype(np.float32), direction.astype(np.float32)
    direction /= np.linalg.norm(direction, axis=0)
    left = np.zeros((40, 2000), int)
    for steps, (lane, box) in enumerate(Bounds(low, high).crossed(position, direction)):
        np.add.at(left, (box, lane), 1)
        assert steps < 500
    with np.errstate(divide="ignore"):
        ends = [(side[:, :, None] - position[:, None]) / direction[:, None] for side in (low, high)]
    crossed = (np.minimum(*ends).max(axis=0) < np.maximum(*ends).min(axis=0)) & (
        np.maximum(*ends).min(axis=0) > 0
    )
    assert left.max() == 1 and (left[crossed] == 1).all()


@pytest.mark.parametrize("bent", [False, True])
@pytest.mark.parametrize("lamps", [[], [PointLight(20.0, position=(1, 1, 3), radius=0.1)]], ids=["0", "1"])
def test_a_picture_that_is_all_behind_surfaces_lights_none_of_them(bent: bool, lamps: list):
    image = np.zeros((64, 128, 3), np.float32)
    image[16:20, 20:24] = 100
    material = Material(surface=Diffuse(0.5, normal=SURFACE_NORMAL if bent else None))
    camera = Camera.look_at((0, -6, 3), (0, 0, 0), 24, 16, 1.0)
    scene = Scene(camera, [floor()], [material], lamps, World(image=image))
    for integrator in ("sobol", "control_variates"):
        film = render(scene, Settings(samples=4, threads=1, integrator=integrator))
        assert film.messages == [] and film.statistics["non-finite samples"] == 0
        dark = render(replace(scene, world=World()), Settings(samples=64, threads=1)).combined
        assert np.isfinite(film.combined).all()
        assert film.combined.mean() == pytest.approx(dark.mean(), rel=0.1, abs=1e-7)
