# SPDX-License-Identifier: GPL-3.0-or-later
"""The same picture as Cycles without bounces, for every kind of light, and in fog."""

from __future__ import annotations

from types import ModuleType

import pytest

from benchmarks import fog_chart
from benchmarks.compare import Comparison, compare
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


@pytest.mark.full
@pytest.mark.parametrize("cell", cells(), ids=str)
def test_all_fog_is_that_of_cycles(cv: ModuleType, cell: Cell) -> None:
    assert_fog_is_that_of_cycles(cell, 16, 8, 512)
