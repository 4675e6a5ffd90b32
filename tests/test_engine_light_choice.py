# SPDX-License-Identifier: GPL-3.0-or-later
"""The choice among lights: a distribution whose probabilities are what it says, at every point."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scenes import floor, mixed_lights, place, sphere
from scipy import stats

from engine_core import AreaLight, Light, Material, Mesh, PointLight, SpotLight, World
from engine_core.bsdf.diffuse import Lambert
from engine_core.bsdf.microfacet import GGX
from engine_core.geometry.frame import Frame
from engine_core.geometry.triangles import gather_triangles
from engine_core.transport.emitters import emitter_groups
from engine_core.transport.highlights import Highlights
from engine_core.transport.light_choice import WEIGHED, CandidateLights, LightChoice, WeighedLights
from engine_core.transport.light_clusters import CANDIDATES, TOLERANCE, clusters_of_cells
from engine_core.transport.light_estimates import Lights
from engine_core.transport.surface_shading import Slot

SAMPLES = 100_000
CONFIDENCE = 0.01
FRAME = Frame(np.zeros(3), 1.0)
CELLS, PILOTS = 3, 64


def lights_of(lamps: Sequence[Light], meshes: Sequence[Mesh] = (), world: float = 0.0) -> Lights:
    materials = (Material(0.0, 1.0),) if meshes else (Material(),)
    triangles, _ = gather_triangles(meshes, FRAME)
    groups, _ = emitter_groups(lamps, World(world), materials, triangles, FRAME)
    return Lights(groups)


def points(random: np.random.Generator, *shape: int) -> tuple[np.ndarray, np.ndarray]:
    """Positions about the origin and normals, float32 (3, *shape)."""
    position = random.uniform(-3, 3, (3, *shape))
    normal = random.normal(size=(3, *shape))
    return position.astype(np.float32), (normal / np.linalg.norm(normal, axis=0)).astype(np.float32)


def glossy(random: np.random.Generator, normal: np.ndarray) -> Highlights:
    """Of points with normals (3, *shape): widths of all kinds, from all sides, half of them with a lobe."""
    normal = normal.reshape(3, -1)
    count = normal.shape[1]
    viewer = random.normal(size=normal.shape).astype(np.float32)
    viewer /= np.linalg.norm(viewer, axis=0)
    viewer *= np.sign((viewer * normal).sum(axis=0))
    has = np.flatnonzero(np.arange(count) % 2)
    row = np.full(count, -1, np.int32)
    row[has] = np.arange(len(has))
    alpha = (10 ** random.uniform(-4, 0, len(has))).astype(np.float32)
    weight = random.random((3, len(has)), np.float32)
    lobe = GGX.of(weight, normal[:, has], viewer[:, has], (alpha, alpha), None, None)
    matte = Lambert(np.full((3, count), 0.2, np.float32), normal, viewer)
    return Highlights.of([Slot(matte, None, False), Slot(lobe, row, True)], count)


def choice_of(lights: Lights, seed: int = 5, hits: bool = True, shine: bool = False) -> LightChoice:
    if len(lights) <= WEIGHED:
        return WeighedLights(lights)
    random = np.random.default_rng(seed)
    position, normal = points(random, CELLS, PILOTS)
    # Cells are small: their points lie near each other.
    position = position[:, :, :1] + 0.2 * position
    found = random.random((CELLS, PILOTS)) < 0.9 if hits else np.zeros((CELLS, PILOTS), bool)
    shown = glossy(random, normal) if shine else None
    return CandidateLights(lights, clusters_of_cells(lights, position, normal, found, highlights=shown))


def all_chances(
    choice: LightChoice, lights: Lights, position, normal, cell, highlights: Highlights | None = None
) -> np.ndarray:
    """(L, M) probabilities of every light at every point."""
    count, size = len(lights), position.shape[1]
    light = np.tile(np.arange(count), size)
    at = np.repeat(np.arange(size), count)
    highlights = None if highlights is None else highlights.take(at)
    chances = choice.pdf(light, position[:, at], normal[:, at], cell[at], None, highlights)
    return chances.reshape(size, count).T


def spots(count: int) -> list[Light]:
    random = np.random.default_rng(3)
    return [
        SpotLight(
            random.random(3) ** 4,
            light_to_world=place(random.uniform(-3, 3, 3), random.uniform(-3, 3, 3)),
            radius=random.choice([0, 0.2]),
            angle=random.uniform(0.3, 2.5),
        )
        for _ in range(count)
    ]


def areas(count: int) -> list[Light]:
    random = np.random.default_rng(4)
    return [
        AreaLight(
            random.random(3),
            light_to_world=place(random.uniform(-3, 3, 3), random.uniform(-3, 3, 3)),
            size=random.uniform(0.01, 0.5, 2),
        )
        for _ in range(count)
    ]


def sparks(count: int) -> list[Light]:
    random = np.random.default_rng(2)
    return [PointLight(random.random() ** 6, position=random.uniform(-3, 3, 3)) for _ in range(count)]


CASES = {
    "2 points": lambda: lights_of(sparks(2)),
    "30 points": lambda: lights_of(sparks(30)),
    "33 points": lambda: lights_of(sparks(33)),
    "200 points": lambda: lights_of(sparks(200)),
    "1000 points": lambda: lights_of(sparks(1000)),
    "mixed": lambda: lights_of(mixed_lights(120), world=0.02),
    "spots": lambda: lights_of(spots(80)),
    "areas": lambda: lights_of(areas(80)),
    "mesh": lambda: lights_of([], [sphere((0, 0, 4), 1.0, segments=32), floor(2.0, -4.0)]),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize(("split", "shine"), [(1, False), (4, False), (4, True)])
def test_lights_are_chosen_as_often_as_pdf_says(case: str, split: int, shine: bool):
    lights = CASES[case]()
    choice, random, count = choice_of(lights, shine=shine), np.random.default_rng(1), len(lights)
    position, normal = points(random, 3)
    cell = np.array([0, 1, 1])
    shown = glossy(random, normal) if shine else None
    chances = all_chances(choice, lights, position, normal, cell, shown)
    rows = np.repeat(np.arange(3), SAMPLES // split)
    w = random.random((len(rows), split), np.float32)
    shown = shown.take(rows) if shine else None
    light, pdf, w = choice.choose(position[:, rows], normal[:, rows], cell[rows], w, None, shown)
    assert (w >= 0).all() and (w < 1).all()
    assert light.min() >= 0 and light.max() < count
    for row in range(3):
        part = slice(row * SAMPLES, (row + 1) * SAMPLES)
        wanted = chances[:, row].astype(np.float64)
        assert np.allclose(pdf[part], wanted[light[part]], rtol=2e-4)
        counts, often = np.bincount(light[part], minlength=count), wanted * SAMPLES >= 5
        counts = np.append(counts[often], counts[~often].sum())
        expected = np.append(wanted[often], max(1 - wanted[often].sum(), 1e-9)) * SAMPLES
        expected *= SAMPLES / expected.sum()
        assert stats.chisquare(counts, expected).pvalue > CONFIDENCE / 20
        assert stats.kstest(w[part], "uniform").pvalue > CONFIDENCE / 20


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("shine", [False, True])
def test_probabilities_are_positive_and_sum_to_one(case: str, shine: bool):
    lights, random = CASES[case](), np.random.default_rng(8)
    position, normal = points(random, 50)
    cell = np.sort(np.random.default_rng(9).integers(0, CELLS, 50))
    shown = glossy(random, normal) if shine else None
    chances = all_chances(choice_of(lights, shine=shine), lights, position, normal, cell, shown)
    assert (chances > 1e-3 / len(lights)).all()
    if len(lights) <= WEIGHED:
        # A light that should give nothing has as little as a light can, unless that is true of all.
        reaches = lights.irradiance(position, normal) > 0
        less = chances.max(axis=0, where=~reaches, initial=0)
        more = np.where(reaches, chances, np.inf).min(axis=0)
        assert (less < 0.2 * more)[reaches.any(axis=0)].all()
    assert np.allclose(chances.sum(axis=0), 1, atol=1e-4)


def test_pdf_takes_points_in_any_order():
    lights = lights_of(sparks(200))
    choice, random = choice_of(lights), np.random.default_rng(1)
    position, normal = points(random, 100)
    cell, light = random.integers(0, CELLS, 100), random.integers(0, 200, 100)
    order = np.argsort(cell, kind="stable")
    there = choice.pdf(light[order], position[:, order], normal[:, order], cell[order])
    assert np.array_equal(choice.pdf(light, position, normal, cell)[order], there)


def test_a_cell_does_not_depend_on_its_company():
    lights, random = lights_of(mixed_lights(100)), np.random.default_rng(6)
    position, normal = points(random, 40, PILOTS)
    found = random.random((40, PILOTS)) < 0.7
    together = clusters_of_cells(lights, position, normal, found)
    for row in (0, 17, 39):
        part = slice(row, row + 1)
        (alone,) = clusters_of_cells(lights, position[:, part], normal[:, part], found[part])
        for name in ("candidates", "slot", "mass", "share", "table"):
            assert np.array_equal(getattr(alone, name), getattr(together[row], name)), name


@pytest.mark.parametrize(
    "lamps",
    [
        sparks(40) + [PointLight(1e30, position=(0, 0, 1))],
        sparks(40) + [PointLight(1e-30, position=(0, 0, 1))] * 40,
        [PointLight(1.0, position=(0, 0, 1))] * 300,
        [PointLight(10.0**k, position=(0, 0, 10.0 ** (k / 2))) for k in range(-36, 36)],
        [PointLight(1.0, position=(0, 0, 0), radius=r) for r in np.geomspace(1e-18, 1e18, 50)],
        [SpotLight(1.0, light_to_world=place((0, 0, 5), (3.14, 0, 0)), angle=1e-3)] * 40,
    ],
    ids=["one of 1e30", "dark ones", "coincident", "all scales", "all radii", "none reaches"],
)
@pytest.mark.parametrize("hits", [True, False])
def test_nasty_lights_leave_a_distribution(lamps: list[Light], hits: bool):
    lights = lights_of(lamps)
    choice, random = choice_of(lights, hits=hits), np.random.default_rng(3)
    position, normal = points(random, 64)
    position[:, :8] = np.array([[0], [0], [1]], np.float32)  # where lights are
    position[:, 8:16] = 0
    position[:, 16:24] *= np.float32(1e12)
    cell = np.repeat(np.arange(2), 32)
    with np.errstate(all="ignore"):
        chances = all_chances(choice, lights, position, normal, cell)
        light, pdf, w = choice.choose(position, normal, cell, random.random((64, 4), np.float32))
    assert np.allclose(chances.sum(axis=0), 1, atol=1e-4) and (chances > 0).all()
    assert np.allclose(pdf, chances[light, np.repeat(np.arange(64), 4)], rtol=1e-3)
    assert (w >= 0).all() and (w < 1).all()


def test_the_ends_of_the_unit_interval_choose_lights_of_some_chance():
    lights = lights_of(sparks(300))
    position, normal = points(np.random.default_rng(4), 1000)
    ends = np.tile(np.array([0, 2.0**-24, 1 - 2.0**-24], np.float32), (1000, 1))
    for some in (lights, lights_of(sparks(20))):
        _, pdf, _ = choice_of(some).choose(position, normal, np.zeros(1000, int), ends)
        assert (pdf > 0).all() and (pdf <= 1 + 1e-6).all()


def test_candidates_are_as_few_as_suffice():
    """Of far lights all are alike over a small cell: a few candidates stand for a thousand."""
    random = np.random.default_rng(2)
    near = PointLight(1.0, position=(0.3, 0, 0.3))
    far = [PointLight(100.0, position=50 * v / np.linalg.norm(v)) for v in random.normal(size=(999, 3))]
    lights = lights_of([near, *far])
    position, normal = points(random, 1, PILOTS)
    position *= np.float32(0.03)
    normal[:] = np.array([0, 0, 1], np.float32)[:, None, None]
    clusters = clusters_of_cells(lights, position, normal, np.ones((1, PILOTS), bool))
    assert 0 in clusters[0].candidates
    assert len(clusters[0].candidates) < CANDIDATES
    # Where no pilot was, their chances are still nearly those of weighing every light.
    position, normal = np.float32(0.03) * points(random, 20)[0], normal[:, 0, :20]
    few, every = (
        all_chances(choice, lights, position, normal, np.zeros(20, int))
        for choice in (CandidateLights(lights, clusters), WeighedLights(lights))
    )
    assert np.abs(few - every).sum(axis=0).max() / 2 < 2 * TOLERANCE


@pytest.mark.parametrize("size", [(0.05, 0.05), (0.6, 0.6), (1.5, 0.2)])
@pytest.mark.parametrize("spread", [0.3, 1.0, 2.0])
def test_lights_with_a_spread_are_chosen_where_they_shine(size: tuple[float, float], spread: float):
    lamps = [
        AreaLight(1.0, light_to_world=place((x, y, 3)), size=size, spread=spread)
        for x in np.linspace(-2.5, 2.5, 5)
        for y in np.linspace(-2.5, 2.5, 5)
    ]
    lights, random, count = lights_of(lamps), np.random.default_rng(7), 500
    position = random.uniform(-3, 3, (3, count)).astype(np.float32)
    position[2] = 0
    normal = np.broadcast_to(np.float32([[0], [0], [1]]), position.shape)
    (group,), truth = lights.groups, np.zeros((len(lights), count))
    for number in range(len(lights)):
        for _ in range(50):
            u = random.random((3, count), np.float32)
            to_light, measure = group.sample(np.full(count, number), position, normal, u[0], u[1:])
            truth[number] += measure * to_light[2] / np.linalg.norm(to_light, axis=0)
    lit = truth.sum(axis=0) > 0
    share = truth[:, lit] / truth[:, lit].sum(axis=0)
    chance = all_chances(WeighedLights(lights), lights, position, normal, np.zeros(count, np.intp))[:, lit]
    # As many times the square of what all bring as their samples have: without the spread, up to 8.7.
    assert (share**2 / chance).sum(axis=0).mean() < 1.6
