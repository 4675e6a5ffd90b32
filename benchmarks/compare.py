# SPDX-License-Identifier: GPL-3.0-or-later
"""Is it the same picture? Every kind of light by CV Render and by Cycles, both converged.

Several seeds of each engine give the noise of every pixel. The means of the two pictures have to
agree, and the differences of their pixels have to be no larger than that noise explains.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.stats import norm, t

import dev

from .scenes.one_light import CASES, Case, build

ROUNDING = 2e-5
"""What float32 and the table of Cycles' pixel filter may add to a pixel, relative to its value."""


@dataclass(frozen=True)
class Comparison:
    """CV Render against Cycles; all three are within what the noise explains if the pictures are the same.

    ratio, ratio_error : of the pictures' means, and its standard error.
    difference : root mean square over the pixels, in units of what the noise lets expect.
    largest : the largest difference of a pixel, as the normal deviate that is as improbable.
    """

    ratio: float
    ratio_error: float
    difference: float
    largest: float


def compare_pictures(ours: np.ndarray, theirs: np.ndarray, samples: int) -> Comparison:
    """ours, theirs : (seeds, H, W, 3) radiance, each of ``samples`` a pixel."""
    engines = [picture.mean(-1) for picture in (ours, theirs)]
    means = [seeds.mean(0) for seeds in engines]
    variances = [seeds.var(0, ddof=1) / len(seeds) for seeds in engines]
    difference, variance = means[0] - means[1], sum(variances)
    # An edge that cuts off less of a pixel than one sample may be missed by all seeds of an engine,
    # whose variance then says nothing: what the pixel could change by is seen from its neighbours.
    near = sliding_window_view(np.pad(sum(means) / 2, 1, "edge"), (3, 3))
    contrast = near.max((-2, -1)) - near.min((-2, -1))
    unseen = (contrast / samples) ** 2 / (2 * len(ours)) + 2 * (ROUNDING * means[1]) ** 2
    relative = [np.sqrt(v.sum()) / m.sum() for v, m in zip(variances, means, strict=True)]
    deviate = np.max(np.abs(difference) / np.sqrt(variance + unseen + np.finfo(float).tiny))
    return Comparison(
        float(means[0].mean() / means[1].mean()),
        float(np.hypot(*relative)),
        float(np.sqrt(np.sum(difference**2) / np.sum(variance + unseen))),
        float(norm.isf(t.sf(deviate, len(ours) + len(theirs) - 2))),
    )


def pictures(engine: str, size: tuple[int, int], samples: int, seeds: Sequence[int]) -> np.ndarray:
    """(seeds, H, W, 3) of the open scene by Blender's ``engine``."""
    from .engines.blender import BlenderEngine, read_picture, set_output

    set_output(*size)
    renderer = BlenderEngine(engine, engine)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.exr"
        found = []
        for seed in seeds:
            renderer.render(samples, seed, path)
            found.append(read_picture(path))
    return np.array(found)


def compare(case: Case, size: int, samples: int, seeds: int) -> Comparison:
    """Render ``case`` with as many ``seeds`` by either engine."""
    build(case)
    ours = pictures("CV_RENDER", (size, size), samples, range(seeds))
    return compare_pictures(ours, pictures("CYCLES", (size, size), samples, range(100, 100 + seeds)), samples)


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench compare", description=__doc__.partition("\n")[0])
    parser.add_argument(
        "cases", nargs="*", metavar="WORD", help="only the lights with one of these in their names"
    )
    parser.add_argument("--size", type=int, default=96)
    parser.add_argument("--samples", type=int, default=256)
    parser.add_argument("--seeds", type=int, default=8)
    options = parser.parse_args()
    bpy = dev.open_this_blender()
    print(f"Blender {bpy.app.version_string}, {options.size} x {options.size}, "
          f"{options.seeds} x {options.samples} samples by either engine\n")  # fmt: skip
    print("| light | CV Render / Cycles, mean | standard error | RMS difference / noise | largest pixel z |")
    print("|---|---|---|---|---|")
    for case in CASES:
        if options.cases and not any(word in case.name for word in options.cases):
            continue
        if bpy.app.version[:2] < case.since:
            print(f"| {case.name} | from Blender {case.since[0]}.{case.since[1]} on | | | |")
            continue
        found = compare(case, options.size, options.samples, options.seeds)
        print(f"| {case.name} | {found.ratio:.5f} | {found.ratio_error:.5f} "
              f"| {found.difference:.2f} | {found.largest:.1f} |")  # fmt: skip


if __name__ == "__main__":
    main()
