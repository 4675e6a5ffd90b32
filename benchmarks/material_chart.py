# SPDX-License-Identifier: GPL-3.0-or-later
"""A chart of materials by CV Render beside Cycles, with a map of their differences: a picture and a table."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import dev

from .compare import pictures
from .method_figures import Canvas
from .scenes.material_chart import CHART, COLUMNS, ROWS, build, means

FOLDER = dev.ROOT / ".dev" / "material_chart"


def seen(radiance: np.ndarray) -> np.ndarray:
    """Colours 0 to 255 of a picture (H, W, 3), row 0 at the bottom; of the result at the top."""
    light = np.clip(radiance[::-1], 0, 1)
    curve = np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
    return np.round(255 * curve).astype(np.uint8)


def signed(ratio: np.ndarray, full: float) -> np.ndarray:
    """Red where a ratio (H, W) is above 0, blue below; full colour at ``full``."""
    part = np.clip(ratio[::-1] / full, -1, 1)[..., None]
    colour = np.where(part > 0, (200, 20, 20), (20, 60, 200))
    return np.round(255 + np.abs(part) * (colour - 255)).astype(np.uint8)


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="dev.py bench material_chart", description=__doc__.partition("\n")[0]
    )
    add = parser.add_argument
    add("--edge", type=int, default=48, help="pixels of a tile in a row")
    add("--samples", type=int, default=32, help="of CV Render; Cycles takes four times as many")
    add("--seeds", type=int, default=2, help="pictures of each engine that are averaged")
    add("--full-colour", type=float, default=0.1, metavar="ERROR", help="relative error of the full colour")
    add("-o", "--output", type=Path, default=FOLDER, metavar="FOLDER")
    options = parser.parse_args()
    bpy = dev.open_this_blender()
    build(options.edge)
    size = COLUMNS * options.edge, ROWS * options.edge
    ours = pictures("CV_RENDER", size, options.samples, range(options.seeds))
    theirs = pictures("CYCLES", size, 4 * options.samples, range(100, 100 + options.seeds))

    print(f"Blender {bpy.app.version_string}, {size[0]} x {size[1]}\n")
    print("| material | CV Render / Cycles - 1, red, green, blue, % | standard error, % |\n|---|---|---|")
    by_seed = [np.array([means(picture) for picture in engine]) for engine in (ours, theirs)]
    truth = by_seed[1].mean(axis=0)
    scale = np.maximum(truth, 0.1 * truth.mean(axis=1, keepdims=True))
    difference = 100 * (by_seed[0].mean(axis=0) - truth) / scale
    variance = sum(engine.var(axis=0, ddof=1) for engine in by_seed) / options.seeds
    error = 100 * np.sqrt((variance / scale**2).mean(axis=1))
    for sample, row, spread in zip(CHART, difference, error, strict=True):
        print(f"| {sample.name} | {row[0]:+.2f}, {row[1]:+.2f}, {row[2]:+.2f} | {spread:.2f} |")

    a, b = ours.mean(axis=0), theirs.mean(axis=0)
    ratio = (a - b).mean(axis=-1) / np.maximum(b.mean(axis=-1), 0.05 * b.mean())
    panels = {
        "CV Render": seen(a),
        "Cycles": seen(b),
        f"difference, full colour at {options.full_colour:g}": signed(ratio, options.full_colour),
    }
    gap, top = 8, 22
    canvas = Canvas(len(panels) * (size[0] + gap) + gap, top + size[1] + gap)
    for number, (label, colours) in enumerate(panels.items()):
        x = gap + number * (size[0] + gap)
        canvas.text(x, top / 2, label)
        canvas.image(x, top, colours, 1)
    canvas.save(options.output / f"chart-{bpy.app.version[0]}.{bpy.app.version[1]}.png")


if __name__ == "__main__":
    main()
