# SPDX-License-Identifier: GPL-3.0-or-later
"""The same picture as Cycles without bounces, for every kind of light."""

from __future__ import annotations

from types import ModuleType

import pytest

from benchmarks.compare import Comparison, compare
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
