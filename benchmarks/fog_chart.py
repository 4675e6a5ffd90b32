# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog of every shape under every kind of light: means of pictures by CV Render over those by Cycles.

Each light meets each shape of fog, each anisotropy and each optical depth. Both the picture and what fog
scatters alone (the pass Volume Direct) are compared, with standard errors: of Cycles from the differences
of its seeds in each pixel, of CV Render from the means of its pictures, whose pixels share their errors.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.stats import norm, t

import dev

from .scenes.fog_chart import Cell, build, cells

LIMIT = 0.003
"""Of what CV Render and Cycles may differ by, relative to the mean."""

SIGMAS = 3.0
"""From here on a difference is no noise; with the errors of few seeds, from as improbable a multiple on."""

COLUMNS = (
    "CV / Cycles",
    "Sobol / Cycles",
    "CV / Sobol",
    "fog: CV / Cycles",
    "Sobol / Cycles",
    "CV, few / many",
)


@dataclass(frozen=True)
class Estimate:
    """A mean over pixels and colours, and its standard error."""

    mean: float
    error: float

    def __truediv__(self, other: Estimate) -> Estimate:
        ratio = self.mean / other.mean
        return Estimate(ratio, abs(ratio) * np.hypot(self.error / self.mean, other.error / other.mean))


def of_pixels(pictures: np.ndarray) -> Estimate:
    """Of pictures (seeds, H, W, 3) with independent pixels."""
    grey = pictures.mean(axis=-1)
    variance = grey.var(axis=0, ddof=1) / len(grey)
    return Estimate(float(grey.mean()), float(np.sqrt(variance.sum()) / variance.size))


def of_pictures(pictures: np.ndarray) -> Estimate:
    """Of pictures (seeds, H, W, 3), whatever their pixels have in common."""
    means = pictures.mean(axis=(1, 2, 3))
    return Estimate(float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means))))


def set_output(edge: int) -> None:
    """Let the open scene render what is compared into a multilayer EXR."""
    import bpy

    from .engines import blender

    blender.set_output(edge, edge)
    layer, image = bpy.context.view_layer, bpy.context.scene.render.image_settings
    if hasattr(image, "media_type"):  # Blender 5
        image.media_type, image.use_exr_interleave = "MULTI_LAYER_IMAGE", True
    image.file_format = "OPEN_EXR_MULTILAYER"
    layer.cycles.use_pass_volume_direct = layer.cv_render.use_pass_volume_direct = True


def pictures(engine: str, samples: int, seeds: range, integrator: str = "control_variates") -> np.ndarray:
    """(2, seeds, H, W, 3) of the open scene: all of it, and what fog scatters."""
    from engine_core.image.exr import read_exr

    from .engines.blender import BlenderEngine

    renderer = BlenderEngine(engine, engine, integrator=integrator)
    found = []
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.exr"
        for seed in seeds:
            renderer.render(samples, seed, path)
            channels = read_exr(path)
            found.append([_layer(channels, "Combined"), _layer(channels, "Volume Direct", "VolumeDir")])
    return np.array(found, np.float64).swapaxes(0, 1)


def _layer(channels: dict[str, np.ndarray], *names: str) -> np.ndarray:
    """(H, W, 3) of the pass that has one of these names."""
    wanted = (tuple(f".{name}.{colour}" for name in names) for colour in "RGB")
    return np.stack([next(channels[k] for k in channels if k.endswith(ends)) for ends in wanted], axis=-1)


def compare(
    cell: Cell, edge: int, samples: int, seeds: int, cycles_samples: int, cycles_seeds: int
) -> list[Estimate]:
    """The ratios of a row, in the order of `COLUMNS`.

    edge : of the pictures. samples : of CV Render's few; many are four times as many.
    """
    build(cell)
    set_output(edge)
    few, many = (pictures("CV_RENDER", n, range(seeds)) for n in (samples, 4 * samples))
    sobol = pictures("CV_RENDER", 4 * samples, range(seeds), "sobol")
    theirs = pictures("CYCLES", cycles_samples, range(100, 100 + cycles_seeds))
    few, cv, sobol = ([of_pictures(layer) for layer in by] for by in (few, many, sobol))
    truth = [of_pixels(layer) for layer in theirs]
    return [
        cv[0] / truth[0],
        sobol[0] / truth[0],
        cv[0] / sobol[0],
        cv[1] / truth[1],
        sobol[1] / truth[1],
        few[1] / cv[1],
    ]


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench fog_chart", description=__doc__.partition("\n")[0])
    add = parser.add_argument
    add("words", nargs="*", metavar="WORD", help="only lights and fogs with one of these as their names")
    add("--edge", type=int, default=48, help="of the pictures, in pixels")
    add("--samples", type=int, default=16, help="of CV Render's few; many are four times as many")
    add("--seeds", type=int, default=8, help="of CV Render")
    add("--cycles-samples", type=int, default=512)
    add("--cycles-seeds", type=int, default=2)
    options = parser.parse_args()
    bpy = dev.open_this_blender()
    sigmas = t.isf(norm.sf(SIGMAS), options.seeds - 1)
    print(f"Blender {bpy.app.version_string}, {options.edge} x {options.edge}; off 1 by per cent ± error; "
          f"? beyond {sigmas:.1f} of these, ! and beyond {100 * LIMIT:g} per cent\n")  # fmt: skip
    print("| light | fog | g | depth |" + "|".join(f" {name} " for name in COLUMNS) + "|")
    print("|" + (4 + len(COLUMNS)) * "---|")
    for cell in cells():
        if options.words and not {cell.light, cell.fog} & set(options.words):
            continue
        told = []
        for ratio in compare(
            cell, options.edge, options.samples, options.seeds, options.cycles_samples, options.cycles_seeds
        ):
            off = ratio.mean - 1
            sure, far = bool(abs(off) > sigmas * ratio.error), abs(off) > LIMIT
            told.append(f"{100 * off:+.3f} ± {100 * ratio.error:.3f}{' !' if sure and far else ' ?' * sure}")
        print(f"| {cell.light} | {cell.fog} | {cell.g:g} | {cell.depth:g} | {' | '.join(told)} |", flush=True)


if __name__ == "__main__":
    main()
