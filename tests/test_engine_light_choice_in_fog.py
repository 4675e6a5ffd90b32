# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice among lights in fog: probabilities that are what they say, near what each light scatters."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from scenes import mixed_lights, place
from scipy import integrate, stats
from test_engine_light_choice import lights_of

from engine_core import (
    AreaLight,
    Camera,
    Light,
    Material,
    Mesh,
    PointLight,
    Scene,
    Settings,
    SpotLight,
    SunLight,
    Volume,
    World,
    render,
)
from engine_core.transport.light_choice_in_fog import (
    WEIGHED,
    AirLights,
    CellsOfPicture,
    FogChoice,
    RaySegments,
    fog_clusters,
    segments,
)
from engine_core.transport.light_clusters import CANDIDATES, CELL
from engine_core.transport.light_estimates import Lights

CELLS, START, END = 6, 0.1, 14.0
FOGS = {"thin": (1e-3, 0.0), "a body": (0.5, 0.0), "everywhere": (0.3, 0.3), "thick": (3.0, 3.0)}


def rays(pilots: int, seed: int, extinction: float = 0.1, leg: float = 0.0) -> RaySegments:
    """Segments (CELLS, pilots) of rays from the origin through squares side by side."""
    random = np.random.default_rng(seed)
    column, row = np.divmod(np.arange(CELLS), 2)
    x, y = 0.04 * (np.stack([column, row])[:, :, None] + random.random((2, CELLS, pilots))) - 0.07
    direction = np.stack([x, y, -np.ones_like(x)])
    direction /= np.linalg.norm(direction, axis=0)
    return segments(0 * direction, direction, 0 * x + START, END, extinction, leg)


def choice_of(lights: Lights, extinction: float = 0.1, leg: float = 0.0, hits: bool = True) -> FogChoice:
    air = AirLights(lights)
    found = np.full((CELLS, 64), hits)
    return FogChoice(air, fog_clusters(air, rays(64, 5, extinction, leg), found))


def flat(where: RaySegments) -> tuple[RaySegments, np.ndarray]:
    """All segments in a row, and their cells."""
    _, cells, count = where.place.shape
    return where.reshape(cells * count), np.repeat(np.arange(cells), count)


def all_chances(choice: FogChoice, lights: Lights, where: RaySegments, cell: np.ndarray) -> np.ndarray:
    """(L, M) probabilities of every light for every segment."""
    count, size = len(lights), len(cell)
    at = np.repeat(np.arange(size), count)
    each = RaySegments(*(x[:, at] for x in where))
    return choice.pdf(np.tile(np.arange(count), size), each, cell[at]).reshape(size, count).T


def points(count: int, seed: int = 1) -> list[Light]:
    random = np.random.default_rng(seed)
    low, high = (-4, -4, -12), (4, 4, -1)
    return [PointLight(50 * random.random() ** 3, position=random.uniform(low, high)) for _ in range(count)]


def anywhere(random: np.random.Generator) -> np.ndarray:
    """(4, 4) of a light in front of the rays' origin, turned any way."""
    return place(random.uniform((-4, -4, -12), (4, 4, -1)), random.uniform(-3, 3, 3))


def spots(count: int, seed: int = 1) -> list[Light]:
    random = np.random.default_rng(seed)
    return [
        SpotLight(
            random.random(),
            light_to_world=anywhere(random),
            angle=random.uniform(0.4, 2.5),
            radius=0.2 * (i % 2),
        )
        for i in range(count)
    ]


def areas(count: int, seed: int = 1) -> list[Light]:
    random = np.random.default_rng(seed)
    return [
        AreaLight(
            random.random(),
            light_to_world=anywhere(random),
            size=(0.6, 0.3),
            ellipse=i % 3 == 0,
            spread=np.pi if i % 2 else 1.0,
        )
        for i in range(count)
    ]


def tubes(count: int, seed: int = 1) -> list[Light]:
    random = np.random.default_rng(seed)
    return [
        AreaLight(
            random.random(),
            light_to_world=anywhere(random),
            size=(1.4, 0.1) if i % 2 else (0.1, 1.4),
        )
        for i in range(count)
    ]


def corridor(count: int) -> list[Light]:
    """Tubes along the rays and across them in turn, below the ceiling, facing down."""
    down = (-np.pi / 2, 0, 0)
    return [
        AreaLight(
            1.0,
            light_to_world=place((0.02, 0.06, z), down),
            size=(0.6, 0.08) if i % 2 else (0.08, 0.6),
        )
        for i, z in enumerate(np.linspace(-2, -12, count))
    ]


def airlight(
    lights: Lights, where: RaySegments, extinction: float, leg: float, nodes: int = 200
) -> np.ndarray:
    """(L, M) of unshadowed light, scattered alike to all sides; equiangular, anywhere on lights of a size."""
    random = np.random.default_rng(6)
    x, weight = np.polynomial.legendre.leggauss(nodes)
    direction = where.direction.astype(float)
    result = np.zeros((len(lights), direction.shape[1]))
    for group, first in zip(lights.groups, lights.first, strict=False):
        for number in range(len(group)):
            foot = group.centre[:, number] @ direction
            near = np.linalg.norm(group.centre[:, number, None] - foot * direction, axis=0)
            a, b = (np.arctan((end - foot) / near) for end in (START, END))
            theta = 0.5 * (a + b) + 0.5 * (b - a) * x[:, None]
            t = foot + near * np.tan(theta)
            step = 0.5 * (b - a) * weight[:, None] * near / np.cos(theta) ** 2
            position = (t * direction[:, None, :]).reshape(3, -1)
            u = random.random((3, position.shape[1]), np.float32)
            to_light, measure = group.sample(np.full(position.shape[1], number), position, None, u[0], u[1:])
            r = np.linalg.norm(to_light, axis=0).reshape(t.shape)
            light = measure.reshape(t.shape) * np.exp(-extinction * (t - START) - leg * r)
            result[first + number] = (light * step).sum(axis=0) * group.strength[:, number].mean()
    return result


KINDS = {"points": (points, 0.2), "spots": (spots, 0.8), "areas": (areas, 7.0), "tubes": (tubes, 0.5)}


@pytest.mark.parametrize("fog", FOGS)
@pytest.mark.parametrize("kind", KINDS)
def test_less_variance_than_an_even_choice(kind: str, fog: str):
    lamps, most = KINDS[kind]
    lights, count = lights_of(lamps(100)), 100
    where, cell = flat(rays(4, 9, *FOGS[fog]))
    truth = airlight(lights, where, *FOGS[fog])
    total = truth.sum(axis=0)
    chance = all_chances(choice_of(lights, *FOGS[fog]), lights, where, cell)
    chosen = ((truth**2 / chance).sum(axis=0) - total**2) / total**2
    even = (count * (truth**2).sum(axis=0) - total**2) / total**2
    assert chosen.mean() < most
    assert chosen.mean() < 0.2 * even.mean()


def test_a_thousand_lights_cost_a_few_and_have_hardly_more_variance():
    lights = lights_of(points(1000))
    fog = FOGS["thin"]
    choice = choice_of(lights, *fog)
    assert all(len(c.candidates) <= CANDIDATES for c in choice._choice._clusters)
    where, cell = flat(rays(2, 9, *fog))
    truth = airlight(lights, where, *fog, nodes=40)
    total = truth.sum(axis=0)
    chance = all_chances(choice, lights, where, cell)
    chosen = ((truth**2 / chance).sum(axis=0) - total**2) / total**2
    even = (1000 * (truth**2).sum(axis=0) - total**2) / total**2
    assert chosen.max() < 0.2 and chosen.mean() < 0.02 * even.mean()


def test_a_light_next_to_a_ray_is_weighed_by_its_nearness():
    """100 lights alike, of which each ray nearly meets one."""
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 10), np.linspace(-0.4, 0.4, 10))
    lights = lights_of([PointLight(1.0, position=(*p, -8.0)) for p in zip(x.flat, y.flat, strict=True)])
    chosen = np.array([44, 55, 46])
    direction = lights.centre[:, chosen] + 1e-3
    direction /= np.linalg.norm(direction, axis=0)
    where = segments(0 * direction, direction, np.full(3, START), END, 0.1)
    chance = all_chances(choice_of(lights), lights, where, np.array([3, 3, 5]))
    assert (chance.argmax(axis=0) == chosen).all()
    assert (chance.max(axis=0) > 0.6).all()


@pytest.mark.parametrize("count", [12, 48])
def test_rays_that_nearly_touch_tubes_choose_them(count: int):
    lights = lights_of(corridor(count))
    where, _ = flat(rays(30, 9))
    truth = airlight(lights, where, 0.1, 0.0, nodes=2000)
    chance = all_chances(FogChoice(AirLights(lights)), lights, where, np.zeros(where.place.shape[1], np.intp))
    worth = truth / truth.sum(axis=0) / chance
    # By what a square as large would bring, 31.
    assert worth.max() < 5


@pytest.mark.parametrize("count", [WEIGHED - 2, 100])
@pytest.mark.parametrize("hits", [True, False])
def test_probabilities_are_positive_and_sum_to_one(count: int, hits: bool):
    lights = lights_of(mixed_lights(count), world=0.5)
    where, cell = flat(rays(10, 8))
    chance = all_chances(choice_of(lights, hits=hits), lights, where, cell)
    assert (chance > 0).all()
    assert chance.sum(axis=0) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("count", [WEIGHED - 2, 100])
def test_lights_are_chosen_as_often_as_pdf_says(count: int):
    lights = lights_of(mixed_lights(count), world=0.5)
    only = np.setdiff1d(np.arange(len(lights)), [3, 4, 17])
    air = AirLights(lights, only)
    choice = FogChoice(air, fog_clusters(air, rays(64, 5), np.ones((CELLS, 64), bool)))
    where, cell = flat(rays(1, 8))
    split = 4_000
    w = (np.arange(split) + np.random.default_rng(3).random((CELLS, split))) / split
    light, chance, left = choice.choose(where, cell, w.astype(np.float32))
    assert np.isin(light, only).all()
    at = np.repeat(np.arange(CELLS), split)
    each = RaySegments(*(x[:, at] for x in where))
    assert choice.pdf(light, each, cell[at]) == pytest.approx(chance, rel=1e-4)
    assert stats.kstest(left, "uniform").statistic < 0.02
    for segment in range(CELLS):
        counts = np.bincount(light[at == segment], minlength=len(lights))[only]
        one = RaySegments(*(np.repeat(x[:, [segment]], len(only), axis=1) for x in where))
        expected = choice.pdf(only, one, np.full(len(only), segment)) * split
        # Stratified: within a sample or two.
        assert (np.abs(counts - expected) < 3 + 1e-4 * split).all()


def test_cells_around_a_place_have_chances_by_how_near_they_are():
    cells = CellsOfPicture.of(*(a.ravel() for a in np.meshgrid([3, 4, 5], [7, 8])))
    count = 40_000
    w = (np.arange(count) + 0.5) / count
    # 8 pixels right of the middle of cell (4, 7), and as many above; then in the first cell's corner.
    for at, chances in (((4.75, 7.75), {1: 9, 2: 3, 4: 3, 5: 1}), ((3.01, 7.01), {0: 16})):
        place = np.repeat(np.array([at]).T * CELL, count, axis=1)
        cell, left = cells.drawn(place, w)
        expected = np.array([chances.get(k, 0) for k in range(6)]) / 16
        assert np.bincount(cell, minlength=6) / count == pytest.approx(expected, abs=1e-4)
        for k in chances:
            assert stats.kstest(left[cell == k], "uniform").statistic < 1e-3
        assert left.dtype == np.float32 and left.min() >= 0 and left.max() < 1


def test_a_cell_does_not_depend_on_its_company():
    lights = lights_of(mixed_lights(80))
    air = AirLights(lights)
    where, found = rays(64, 5), np.ones((CELLS, 64), bool)
    together = fog_clusters(air, where, found)
    alone = fog_clusters(air, RaySegments(*(x[:, 2:3] for x in where)), found[2:3])
    assert np.array_equal(together[2].candidates, alone[0].candidates)
    assert np.array_equal(together[2].table, alone[0].table)


@pytest.mark.parametrize("position", [(0, 0, 0), (0, 0, -3), (0, 0, 5), (1e12, 0, 0), (1e-12, 0, -1e-12)])
@pytest.mark.parametrize("end", [1e-20, 3.0, np.inf])
@pytest.mark.parametrize("extinction", [0.0, 1e-30, 1.0, 1e30])
def test_nasty_places_leave_a_distribution(position: tuple[float, ...], end: float, extinction: float):
    pose = place(position)
    lamps = [
        PointLight(1.0, position=position),
        PointLight(1e30, position=position, radius=2.0),
        SpotLight(1.0, light_to_world=pose, angle=1e-3),
        SpotLight(1.0, light_to_world=pose, angle=np.pi),
        AreaLight(1.0, light_to_world=pose),
        AreaLight(1.0, light_to_world=pose, spread=0.01),
    ]
    lights = lights_of(lamps, world=1.0)
    direction = np.array([(0, 0, -1), (0, 0, 1), (1, 0, 0), (0.6, 0, -0.8)], float).T
    where = segments(0 * direction, direction, np.zeros(4), end, extinction, extinction)
    with np.errstate(all="raise", under="ignore"):
        chance = all_chances(choice_of(lights), lights, where, np.zeros(4, int))
    assert (chance > 0).all()
    assert chance.sum(axis=0) == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("where", [(0.3, 0.2, -1.0), (2.0, 0.0, 3.0), (0.0, 1e-3, -6.0)])
def test_estimate_without_extinction_is_the_integral(where: Sequence[float]):
    air = AirLights(lights_of([PointLight(4 * np.pi, position=where)]))
    (estimate,) = air.irradiance(*segments(np.zeros((3, 1)), [[0], [0], [-1.0]], [0.5], [9.0], [0.0]))
    centre = np.array(where)
    truth, _ = integrate.quad(
        lambda t: 1 / ((centre + (0, 0, t)) ** 2).sum(), 0.5, 9, points=[-where[2]], limit=500
    )
    assert 0.75 * truth < estimate[0] < 1.01 * truth


@pytest.mark.parametrize("radius", [0.0, 0.3])
def test_segments_are_cut_by_all_that_a_spot_lights(radius: float):
    """What any point of the light lights lies within the cut: by brute force."""
    random = np.random.default_rng(3)
    for seed in range(40):
        pose = place(random.uniform(-2, 2, 3), random.uniform(-3, 3, 3), random.uniform(0.5, 2, 3))
        spot = SpotLight(1.0, light_to_world=pose, radius=radius, angle=random.uniform(0.2, 2.8))
        lights = lights_of([spot])
        direction = random.normal(size=(3, 1))
        direction /= np.linalg.norm(direction)
        t = np.linspace(0, 8, 400)
        u = np.random.default_rng(seed).random((3, 400), np.float32)
        _, measure = lights.groups[0].sample(None, t * direction, None, u[0], u[1:])
        air = AirLights(lights)
        origin = np.zeros((3, 1), np.float32)
        first, last = (x[0, 0] for x in air._lit(np.zeros(1, int), origin, direction.astype(np.float32)))
        lit = t[measure > 1e-4 * measure.max(initial=1e-30)]
        # From within the light its cone counts for nothing.
        lit = lit[np.linalg.norm(lit * direction - lights.centre, axis=0) > radius]
        assert ((lit > first - 1e-3) & (lit < last + 1e-3)).all()


@pytest.mark.parametrize(
    "lamp", [SunLight(1.0, direction=(0.2, 0.5, -1)), PointLight(2e3, position=(9, 8, 3))]
)
def test_a_light_that_casts_no_shadow_is_chosen_though_fog_is_before_it(lamp):
    """None is between it and what it lights; beside it, nine lamps that are next to nothing."""
    weak = [PointLight(1e-4, position=(x - 2.0, 0.7 * x, 2.0), radius=0.1) for x in range(9)]
    camera = Camera.look_at((0, -3, 1), (0, 0, 1), 12, 8, 0.8)
    corners = [(x, 1.0, z) for x, z in ((-9, -9), (9, -9), (9, 9), (-9, 9))]
    wall = Mesh(corners, [(0, 1, 2), (0, 2, 3)], casts_shadow=False)
    free = dataclasses.replace(lamp, casts_shadow=False)
    air = Volume(scattering=1.5, absorption=0.1)
    pictures = [
        render(
            Scene(camera, (wall,), (Material(0.0),), lights, World(volume=0), volumes=[air]),
            Settings(samples=64, integrator="sobol", seed=3),
        ).combined[..., :3]
        for lights in ((free,), (free, *weak))
    ]
    alone, among = (picture.mean(axis=2, dtype=np.float64) for picture in pictures)
    assert among.mean() == pytest.approx(alone.mean(), rel=0.03)
    assert among.max() < 1.5 * alone.max()
