# SPDX-License-Identifier: GPL-3.0-or-later
"""Draw the figures of docs/method.md: regions and samples over three pictures, and curves of convergence.

Lines, letters and the PNG are made with NumPy alone: no library for plots is needed.
"""

from __future__ import annotations

import argparse
import math
import statistics
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path
from unittest import mock

import numpy as np

import dev
from engine_core.integration import Result, control_variates, integrate
from engine_core.integration.regions import BIN, WHOLE, RegionTree

from .integrands import INTEGRANDS, Integrand, reference
from .integrators import Entrant

Colour = tuple[int, int, int]
BLACK, GREY, PALE, WHITE = (20, 20, 20), (150, 150, 150), (225, 225, 225), (255, 255, 255)
EDGE = (235, 120, 20)

SMOOTH = 3
"""Pixels that one of the figure's is drawn with, along each side."""

_LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789.-,/()=: _"
_ROWS = (
    "EHHVHHHUHHUHHUEHGGGHEUHHHHHUVGGUGGVVGGUGGGEHGNHHFHHHVHHHE44444E72222ICHIKOKIHGGGGGGV"
    "HRLLHHHHHPLJHHEHHHHHEUHHUGGGEHHHLIDUHHUKIHFGGE11UV444444HHHHHHEHHHHHA4HHHLLLAHHA4AHH"
    "HHA4444V1248GVEHJLPHE4C4444EEH1248VV2421HE26AIV22VGU11HE68GUHHEV124888EHHEHHEEHHF12C"
    "00000CC000V0000000C4801248G02488842842224800V0V000CC0CC00000000000000V"
)
"""Seven rows of five dots for each letter, a row a digit of base 32."""


class Canvas:
    """An RGB picture; x to the right and y down, in pixels of the figure."""

    def __init__(self, width: int, height: int) -> None:
        self.pixels = np.full((height * SMOOTH, width * SMOOTH, 3), 255, np.uint8)

    def line(self, points: np.ndarray, colour: Colour, width: float = 1.5) -> None:
        """Through points (N, 2), with round ends."""
        points = np.asarray(points, float) * SMOOTH
        parts = []
        for a, b in zip(points[:-1], points[1:], strict=True):
            parts.append(a + np.linspace(0, 1, 2 + int(2 * np.abs(b - a).max()))[:, None] * (b - a))
        self._dots(np.concatenate(parts), colour, width)

    def dot(self, x: float, y: float, colour: Colour, width: float = 6) -> None:
        self._dots(np.array([[x, y]]) * SMOOTH, colour, width)

    def box(self, left: float, top: float, right: float, bottom: float, colour: Colour) -> None:
        """Its edge, thin and sharp."""
        x0, y0, x1, y1 = (round(v * SMOOTH) for v in (left, top, right, bottom))
        self.pixels[y0 : y1 + 1, [x0, x1]] = colour
        self.pixels[[y0, y1], x0 : x1 + 1] = colour

    def image(self, left: int, top: int, colours: np.ndarray, scale: int) -> None:
        """colours (h, w, 3), each ``scale`` pixels of the figure."""
        big = np.repeat(np.repeat(colours, scale * SMOOTH, axis=0), scale * SMOOTH, axis=1)
        y, x = top * SMOOTH, left * SMOOTH
        self.pixels[y : y + big.shape[0], x : x + big.shape[1]] = big

    def text(self, x: float, y: float, text: str, colour: Colour = BLACK, anchor: float = 0) -> None:
        """Its middle at y; at x its begin (anchor 0), middle (0.5) or end (1)."""
        places = [7 * _LETTERS.index(letter) for letter in text.upper()]
        rows = np.array([[int(row, 32) for row in _ROWS[k : k + 7]] for k in places])
        bits = np.pad(rows[:, :, None] >> np.arange(4, -1, -1) & 1, ((0, 0), (0, 0), (0, 1)))
        mask = np.concatenate(list(bits), axis=1).astype(bool)
        size = SMOOTH * 4 // 3  # pixels of a letter's dot
        mask = np.repeat(np.repeat(mask, size, axis=0), size, axis=1)
        top, left = round(y * SMOOTH - mask.shape[0] / 2), round(x * SMOOTH - anchor * mask.shape[1])
        self.pixels[top : top + mask.shape[0], left : left + mask.shape[1]][mask] = colour

    def save(self, path: Path) -> None:
        h, w = (n // SMOOTH for n in self.pixels.shape[:2])
        small = self.pixels.reshape(h, SMOOTH, w, SMOOTH, 3).mean(axis=(1, 3))
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(png(np.round(small).astype(np.uint8)))
        print(f"wrote {path}")

    def _dots(self, places: np.ndarray, colour: Colour, width: float) -> None:
        radius = width * SMOOTH / 2
        reach = np.arange(-math.ceil(radius), math.ceil(radius) + 1)
        disk = np.stack(np.meshgrid(reach, reach)).reshape(2, -1)
        disk = disk[:, (disk**2).sum(axis=0) <= radius * radius]
        x, y = (np.round(places).astype(int).T[:, :, None] + disk[:, None, :]).reshape(2, -1)
        inside = (x >= 0) & (y >= 0) & (x < self.pixels.shape[1]) & (y < self.pixels.shape[0])
        self.pixels[y[inside], x[inside]] = colour


def png(pixels: np.ndarray) -> bytes:
    """(h, w, 3) uint8 as a PNG file."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    h, w, _ = pixels.shape
    rows = np.concatenate([np.zeros((h, 1), np.uint8), pixels.reshape(h, -1)], axis=1)
    head = struct.pack(">IIBBBBB", w, h, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


# Regions, and where samples went


def with_tree(integrand: Integrand, bins: tuple[int, ...], samples: float) -> tuple[Result, RegionTree]:
    """What the default makes of it, and the regions that it made on its way."""
    trees, grow = [], control_variates.grow

    def grown(tree: RegionTree, *others: object) -> bool:
        trees.append(tree)
        return grow(tree, *others)

    with mock.patch.object(control_variates, "grow", grown):
        return integrate(integrand.f, integrand.ndim, bins=bins, samples=samples), trees[0]


def outlines(tree: RegionTree) -> np.ndarray:
    """(4, R) left, top, right and bottom, in bins, of the regions that the middle of the rest lies in."""
    regions = tree.leaves()
    start, size = regions.start, np.int64(1) << regions.size.astype(np.int64)
    middle = np.int64(1) << (WHOLE - 1)
    at = ((start[2:] <= middle) & (middle < start[2:] + size[2:])).all(axis=0)
    top, left = np.ldexp(start[:2, at].astype(float), -BIN)
    height, width = np.ldexp(size[:2, at].astype(float), -BIN)
    return np.stack([left, top, left + width, top + height])


def shades(values: np.ndarray, low: Colour, high: Colour) -> np.ndarray:
    """values (h, w) in [0, 1] as colours."""
    t = np.clip(values, 0, 1)[:, :, None]
    return np.round(np.array(low) * (1 - t) + np.array(high) * t).astype(np.uint8)


def regions_figure(path: Path, names: Sequence[str], side: int, samples: float, scale: int = 5) -> None:
    """Above, pictures with the regions over them; below, the samples of each bin."""
    panel, gap, left, top = side * scale, 18, 10, 34
    canvas = Canvas(left * 2 + len(names) * panel + (len(names) - 1) * gap, top * 2 + 2 * panel + 30)
    for number, name in enumerate(names):
        result, tree = with_tree(INTEGRANDS[name], (side, side), samples)
        x = left + number * (panel + gap)
        canvas.text(x, top / 2 + 4, f"{name}: {result.regions} regions")
        picture = result.value[0] / np.quantile(result.value[0], 0.995)
        canvas.image(x, top, shades(np.sqrt(np.maximum(picture, 0)), (25, 35, 60), WHITE), scale)
        for low_x, low_y, high_x, high_y in (outlines(tree) * scale).T:
            canvas.box(x + low_x, top + low_y, x + high_x, top + high_y, EDGE)
        below = top + panel + 30
        count = result.sample_count
        canvas.text(x, below - 12, f"samples of a bin: {count.min()} to {count.max()}")
        logs = np.log2(np.maximum(count, 1)) / max(1, math.log2(count.max()))
        canvas.image(x, below, shades(logs, WHITE, (30, 60, 130)), scale)
        canvas.box(x, below, x + panel, below + panel, GREY)
    canvas.save(path)


# Convergence

CURVES = {
    "monte_carlo": ("monte carlo", (150, 150, 150)),
    "sobol": ("sobol", (30, 110, 200)),
    "quadrature": ("quadrature", (150, 90, 180)),
    "thesis_2020": ("thesis 2020", (60, 150, 70)),
    "ControlVariates(residual=False)": ("h alone", (235, 160, 40)),
    "default": ("default", (210, 40, 40)),
}
"""Method -> its label and colour."""


def curve(name: str, integrand: Integrand, samples: Sequence[int], seeds: int) -> np.ndarray:
    """(N, 2) evaluations a bin and median relative RMSE; where there are too few samples, none."""
    truth, entrant, points = reference(integrand), Entrant.named(name), []
    for count in samples:
        try:
            runs = [entrant.run(integrand, integrand.bins, count, seed)[0] for seed in range(seeds)]
        except ValueError:
            continue
        evaluations = statistics.mean(run.evaluations for run in runs) / math.prod(integrand.bins)
        error = statistics.median(truth.relative_error(run.value) for run in runs)
        points.append((evaluations, error))
        print(f"{integrand.name:10} {name:32} {evaluations:8.1f} {error:.2e}", flush=True)
    return np.array(points)


def convergence_figure(path: Path, names: Sequence[str], samples: Sequence[int], seeds: int) -> None:
    """A panel an integrand: error against evaluations, both logarithmic."""
    panel_w, panel_h, gap, left, top = 300, 330, 62, 62, 30
    width = left + len(names) * panel_w + (len(names) - 1) * gap + 20
    canvas = Canvas(width, top + panel_h + 86)
    low_x, high_x = math.log10(samples[0]) - 0.1, math.log10(samples[-1]) + 0.2
    for number, name in enumerate(names):
        curves = {key: curve(key, INTEGRANDS[name], samples, seeds) for key in CURVES}
        logs = np.log10(np.concatenate([found[:, 1] for found in curves.values()]))
        low_y, high_y = logs.min() - 0.15, logs.max() + 0.15
        x0 = left + number * (panel_w + gap)

        def x_at(value: float, x0: float = x0) -> float:
            return x0 + (math.log10(value) - low_x) / (high_x - low_x) * panel_w

        def y_at(value: float, low_y: float = low_y, high_y: float = high_y) -> float:
            return top + (high_y - math.log10(value)) / (high_y - low_y) * panel_h

        canvas.text(x0, top / 2 - 2, name)
        for power in range(math.ceil(low_y), math.floor(high_y) + 1):
            y = y_at(10.0**power)
            canvas.line([(x0, y), (x0 + panel_w, y)], PALE, 1)
            canvas.text(x0 - 6, y, f"1e{power}", anchor=1)
        for count in samples[::2]:
            x = x_at(count)
            canvas.line([(x, top), (x, top + panel_h)], PALE, 1)
            canvas.text(x, top + panel_h + 12, f"{count}", anchor=0.5)
        canvas.box(x0, top, x0 + panel_w, top + panel_h, GREY)
        for key, found in curves.items():
            # Quadrature takes as many evaluations as it likes: beyond the panel it is not drawn.
            drawn = found[np.log10(found[:, 0]) < high_x]
            places = np.array([(x_at(n), y_at(e)) for n, e in drawn]).reshape(-1, 2)
            colour = CURVES[key][1]
            if len(places) > 1:
                canvas.line(places, colour, 2)
            for x, y in places:
                canvas.dot(x, y, colour)
    canvas.text(left, top + panel_h + 34, "relative rmse over evaluations of a bin")
    x = float(left)
    for label, colour in CURVES.values():
        y = top + panel_h + 62
        canvas.line([(x, y), (x + 28, y)], colour, 2)
        canvas.dot(x + 14, y, colour)
        canvas.text(x + 36, y, label)
        x += 36 + 8 * len(label) + 32
    canvas.save(path)


def main() -> None:
    parser = argparse.ArgumentParser(prog="dev.py bench method_figures", description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=dev.ROOT / "docs/images", metavar="FOLDER")
    parser.add_argument("--seeds", type=int, default=5)
    options = parser.parse_args()
    folder = options.output
    regions_figure(folder / "method_regions.png", ("disk2", "direct4", "sscat_occ"), 64, 32)
    counts = [1 << k for k in range(2, 11)]
    convergence_figure(
        folder / "method_convergence.png", ("ridge3", "sscat_occ", "direct4"), counts, options.seeds
    )


if __name__ == "__main__":
    main()
