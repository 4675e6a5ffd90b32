# SPDX-License-Identifier: GPL-3.0-or-later
"""The same picture as Cycles without bounces, for every kind of light, and in fog."""

from __future__ import annotations

from types import ModuleType

import numpy as np
import pytest

from benchmarks import fog_chart
from benchmarks.compare import Comparison, compare, pictures
from benchmarks.scenes import random_fog
from benchmarks.scenes.fog_chart import Cell, cells
from benchmarks.scenes.one_light import CASES, Case


def rendered(cv: ModuleType, case: Case, size: int, samples: int, seeds: int) -> Comparison:
    import bpy  # opened by ``cv``, with the extension

    if bpy.app.version[:2] < case.since:
        pytest.skip(f"lights have this from Blender {case.since[0]}.{case.since[1]} on")
    return compare(case, size, samples, seeds)


# The rim of its pool (1e-4 of the picture's mean) sees a sliver of the lamp through the grid, which all
# samples of a pixel may miss: its seeds then know nothing of its noise.
SELDOM_LIT = {"area, disk, spread 30 degrees"}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_light_is_that_of_cycles_within_the_noise(cv: ModuleType, case: Case) -> None:
    found = rendered(cv, case, size=48, samples=64, seeds=3)
    assert abs(found.ratio - 1) < 4 * found.ratio_error + 1e-4
    assert 0.5 < found.difference < 1.25


@pytest.mark.full
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_converged_light_is_that_of_cycles(cv: ModuleType, case: Case) -> None:
    found = rendered(cv, case, size=96, samples=256, seeds=8)
    assert abs(found.ratio - 1) < min(4 * found.ratio_error + 5e-5, 2e-3)
    assert 0.5 < found.difference < 1.15
    assert found.largest < 7 or case.name in SELDOM_LIT


FEW = {
    ("spot", "world"),
    ("world image", "camera inside"),
    ("mesh", "ball"),
    ("glow", "overlapping"),
}


def assert_fog_is_that_of_cycles(cell: Cell, samples: int, seeds: int, cycles_samples: int) -> None:
    ratios = fog_chart.compare(cell, 32, samples, seeds, cycles_samples, 2)
    for name, ratio in zip(fog_chart.COLUMNS, ratios, strict=True):
        assert abs(ratio.mean - 1) < 5 * ratio.error + 1e-3, name


@pytest.mark.parametrize("cell", [cell for cell in cells() if (cell.light, cell.fog) in FEW], ids=str)
def test_fog_is_that_of_cycles_within_the_noise(cv: ModuleType, cell: Cell) -> None:
    assert_fog_is_that_of_cycles(cell, 16, 6, 128)


def test_the_worlds_fog_goes_on_behind_the_cameras_far_plane(cv: ModuleType) -> None:
    import bpy  # opened by ``cv``, with the extension

    fog_chart.build(Cell("point", "world", 0.0, 0.5))
    bpy.context.scene.camera.data.clip_end = 2.5  # before all surfaces
    ours, theirs = (pictures(e, (32, 32), n, range(4)) for e, n in (("CV_RENDER", 16), ("CYCLES", 128)))
    assert ours.mean() == pytest.approx(theirs.mean(), rel=0.01)


@pytest.mark.full
@pytest.mark.parametrize("cell", cells(), ids=str)
def test_all_fog_is_that_of_cycles(cv: ModuleType, cell: Cell) -> None:
    assert_fog_is_that_of_cycles(cell, 16, 8, 512)


def blocks(pictures: np.ndarray) -> np.ndarray:
    """(seeds, 3, 4) means over blocks of 12 x 16 pixels and colours."""
    return pictures.reshape(-1, 3, 12, 4, 16, 3).mean(axis=(2, 4, 5), dtype=np.float64)


def assert_scene_is_that_of_cycles(seed: int, samples: int, cycles_samples: int) -> None:
    """The whole picture's mean, and blocks', but for what their seeds' noise explains."""
    random_fog.build(seed)
    engines = ("CV_RENDER", samples, range(4)), ("CYCLES", cycles_samples, range(100, 104))
    ours, theirs = (blocks(pictures(engine, (64, 36), n, seeds)) for engine, n, seeds in engines)
    mean = theirs.mean()
    for means in ((ours, theirs), [a.mean(axis=(1, 2)) for a in (ours, theirs)]):
        error = np.sqrt(sum(a.var(axis=0, ddof=1) / len(a) for a in means))
        difference = means[0].mean(axis=0) - means[1].mean(axis=0)
        assert (np.abs(difference) <= 7 * error + 3e-3 * mean).all(), difference


@pytest.mark.parametrize("seed", range(4))
def test_a_random_scene_is_that_of_cycles(cv: ModuleType, seed: int) -> None:
    assert_scene_is_that_of_cycles(seed, 4, 64)


@pytest.mark.full
@pytest.mark.parametrize("seed", range(4, 44))
def test_random_scenes_are_those_of_cycles(cv: ModuleType, seed: int) -> None:
    assert_scene_is_that_of_cycles(seed, 8, 128)
