# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture by plain samples, tile by tile: of surfaces, and of fog and lasers that nothing serves better."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np

from .image.film import FAR, LARGEST, Film, Layer
from .integration.allocation import black_of_chessboard
from .integration.point_sets import PointSet, staged_points
from .integration.quadrature import sum_quadrature
from .integration.sample_mean import sum_samples
from .integration.standard_error import Spread, standard_error
from .parts import Part
from .points_of_tiles import hiding
from .scene import Camera
from .settings import Settings
from .transport.direct_light import DirectLight, DirectLightOverTile, Pixels, SomePixels
from .transport.light_choice import EveryLight, LightChoice
from .transport.light_clusters import CELL

PREPARED_SAMPLES = 1024
"""Samples whose points are prepared before the first pass; more are added as they are needed."""

BLOCK = 16
"""Edge in pixels of the blocks that the noise threshold stops."""

QUADRATURE_SHARE = 16
"""Samples that stand for one camera ray with a quadrature over the lights."""

QUADRATURE_TOLERANCE = 1e-2
"""Of each quadrature, in units of the picture's mean radiance."""

# Light choices of all tiles are kept between passes while they are no more numbers than this.
_KEPT_CHOICES = 1 << 25


@dataclass(eq=False)
class Tile:
    """A part of the picture that one worker renders at a time, in pixels of the whole frame."""

    x0: int
    y0: int
    x1: int
    y1: int
    choice: LightChoice | EveryLight | None = None

    def pixels(self) -> Pixels:
        """All pixels, cell after cell."""
        x, y = np.meshgrid(
            np.arange(self.x0, self.x1, dtype=np.int32), np.arange(self.y0, self.y1, dtype=np.int32)
        )
        x, y = x.ravel(), y.ravel()
        columns = len(self._span(self.x0, self.x1, CELL))
        cell = (y // CELL - self.y0 // CELL) * columns + (x // CELL - self.x0 // CELL)
        order = np.argsort(cell, kind="stable")
        return Pixels(x[order], y[order], cell[order])

    def cells(self) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows of its cells in the whole frame, in the order of `Pixels.cell`."""
        x, y = np.meshgrid(self._span(self.x0, self.x1, CELL), self._span(self.y0, self.y1, CELL))
        return x.ravel(), y.ravel()

    def cell_count(self) -> int:
        """How many cells it has."""
        return len(self._span(self.x0, self.x1, CELL)) * len(self._span(self.y0, self.y1, CELL))

    def blocks(self) -> tuple[slice, slice]:
        """Rows and columns of its blocks in the whole frame."""
        rows, columns = self._span(self.y0, self.y1, BLOCK), self._span(self.x0, self.x1, BLOCK)
        return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)

    @staticmethod
    def _span(low: int, high: int, edge: int) -> range:
        return range(low // edge, (high - 1) // edge + 1)


class PlainPicture:
    """What plain samples make of a picture.

    tiles : from the middle of the picture outwards. samples : of each pixel, at most. of_halves : those of a
        chessboard's white and black ones. points : of surfaces.
    counts : rays by kind, and what was not finite. seen : (2, 3, W, H) of what is seen directly, None where
        samples see for themselves; and ``seen_in`` (H, W) bool, pixels where they do not, None for all.
    """

    def __init__(
        self,
        integrand: DirectLight,
        parts: Sequence[tuple[Part, Layer]],
        film: Film,
        camera: Camera,
        settings: Settings,
        threads: int,
        check: Callable[[], None],
    ) -> None:
        """film : of the surfaces. check : called before every batch; may raise, to give up."""
        self._integrand, self._parts, self._film, self._settings = integrand, parts, film, settings
        self._corner, self._check = camera.region[:2], check
        self._split = settings.light_samples or _light_samples(len(integrand.lights))
        if integrand.samples_every:
            self._split = 1
        name = "monte_carlo" if settings.integrator == "monte_carlo" else "sobol"
        screen = integrand.screen_dimensions
        self.points = staged_points(name, screen, integrand.rest_dimensions, self._split, settings.seed)
        self._part_points = [
            staged_points(
                name, screen, part.plain.rest_dimensions, part.split, settings.seed + 17 * (number + 1)
            )
            for number, (part, _) in enumerate(parts)
        ]
        self._quadrature = settings.integrator == "quadrature" and len(integrand.lights) > 0
        self._tolerance = 0.0
        samples = settings.samples
        if self._quadrature:
            samples = max(1, samples // QUADRATURE_SHARE)
        self.of_halves = samples, samples
        self.tiles = _tiles(camera, settings.tile_size or _tile_size(camera, threads))
        x0, y0, x1, y1 = camera.region
        self._active = np.ones((-(-y1 // BLOCK), -(-x1 // BLOCK)), bool)
        cells = sum(tile.cell_count() for tile in self.tiles)
        self._keep_choices = cells * len(integrand.lights) <= _KEPT_CHOICES
        width, height = camera.region_size
        self._spread = Spread.empty(3, width * height) if settings.standard_error else None
        self.counts: Counter[str] = Counter()
        self._counting = Lock()
        self.seen: np.ndarray | None = None
        self.seen_in: np.ndarray | None = None

    def see(self, index: np.ndarray, mean: np.ndarray, error: np.ndarray) -> None:
        """Take what pixels see directly from elsewhere; arguments as what `seen_through_lens` returns."""
        height, width = shape = self._film.depth.shape
        self.seen, self.seen_in = np.zeros((2, 3, width, height)), np.zeros(shape, bool)
        self.seen_in.reshape(-1)[index] = True
        row, column = np.divmod(index, width)
        self.seen[:, :, column, row] = mean, error

    def take_more(self, times: tuple[int, int]) -> None:
        """So many times the samples, of a chessboard's white and black pixels."""
        white, black = self.of_halves
        self.of_halves = white * times[0], black * times[1]

    @property
    def samples(self) -> int:
        return max(self.of_halves)

    @property
    def rays(self) -> int:
        """To be traced in all, about."""
        return self.samples * (1 + self._split + len(self._parts)) * self._film.depth.size

    def begin(self) -> None:
        """Before the first samples."""
        if self._quadrature:
            self._tolerance = QUADRATURE_TOLERANCE * float(self.few_pixels().mean())

    def due(self) -> list[Tile]:
        """Tiles that the noise threshold has not stopped."""
        return [tile for tile in self.tiles if self._active[tile.blocks()].any()]

    def prepare(self, samples: int) -> None:
        """Points of so many samples."""
        # At once what most renders need in all: nets are not cheap to begin again.
        needed = max(samples, min(self.samples, PREPARED_SAMPLES))
        self.points[0].prepare(needed)
        self.points[1].prepare(needed * self._split)
        for (part, _), points in zip(self._parts, self._part_points, strict=True):
            points[0].prepare(needed)
            points[1].prepare(needed * part.split)

    def few_pixels(self) -> np.ndarray:
        """(3, B) radiance of surfaces in a few pixels all over the picture, by 4 samples each."""
        number = np.unique(np.linspace(0, self._film.depth.size - 1, 1024).astype(np.int64))
        y, x = np.divmod(number, self._film.depth.shape[1])
        x0, y0 = self._corner
        x, y = (x + x0).astype(np.int32), (y + y0).astype(np.int32)
        cells, cell = np.unique(np.stack([y // CELL, x // CELL]), axis=1, return_inverse=True)
        cell = cell.ravel()
        order = np.argsort(cell, kind="stable")
        pixels = Pixels(x[order], y[order], cell[order])
        choice = self._integrand.choice_of_cells(cells[1], cells[0], self._check)
        integrand = DirectLightOverTile(self._integrand, choice, self._check)
        for group in self.points:
            group.prepare(16)
        with np.errstate(all="ignore"):
            sums = sum_samples(integrand, pixels, pixels.key(), self.points, 0, 4, 1)
        return sums.values[:3] / 4

    def sample(self, tile: Tile, start: int, count: int, done: Callable[[int], None]) -> None:
        """Add samples ``start`` to ``start + count`` to the film's pixels of one tile. done : called with
        how many camera rays are."""
        self._check()
        pixels = tile.pixels()
        if not self._active[tile.blocks()].all():
            pixels = pixels[self._active[pixels.y // BLOCK, pixels.x // BLOCK]]
        halves = [(pixels, count)]
        if start + count > min(self.of_halves):
            black = (pixels.x + pixels.y - sum(self._corner)) % 2 != 0
            left = [min(count, of_half - start) for of_half in self.of_halves]
            halves = [(pixels[which], some) for which, some in zip((~black, black), left, strict=True)]
        choice = tile.choice or self._integrand.choice_of_cells(*tile.cells(), self._check)
        if self._keep_choices:
            tile.choice = choice
        sees, elsewhere = self.seen is None, None
        if self.seen_in is not None:
            sees, elsewhere = True, SomePixels(self.seen_in, self._corner)
        integrand = DirectLightOverTile(self._integrand, choice, self._check, sees, elsewhere=elsewhere)
        for some, due in halves:
            if len(some) and due > 0:
                self._add(integrand, some, start, due, done)
        with self._counting:
            self.counts.update(integrand.counts)

    def _add(
        self,
        integrand: DirectLightOverTile,
        pixels: Pixels,
        start: int,
        count: int,
        done: Callable[[int], None],
    ) -> None:
        """`sample` some of a tile's pixels."""
        column, row = pixels.x - self._corner[0], pixels.y - self._corner[1]
        film = self._film

        def after_first(part: slice, first: int, hits) -> None:
            depth = hits.depth.reshape(part.stop - part.start, -1)
            if first == 0:
                film.depth[row[part], column[part]] = np.minimum(depth[:, 0], FAR)
            done(depth.size)

        if self._quadrature:
            sums = sum_quadrature(
                integrand, pixels, pixels.key(), self.points[0], start, count, self._tolerance, after_first
            )
        else:
            sums = sum_samples(
                integrand,
                pixels,
                pixels.key(),
                self.points,
                start,
                count,
                self._split,
                self._settings.batch_size,
                after_first,
            )
        mean = sums.values / count
        if self.seen is not None:
            mean[:3] += self.seen[0][:, column, row]
        mean = np.minimum(mean, LARGEST).astype(np.float32)
        before = film.combined[row, column].T
        if self._settings.noise_threshold and start == count and 2 * start >= self._settings.min_samples:
            channels = slice(0, 4 if self._settings.transparent else 3)
            self._retire_blocks(pixels, before[channels], mean[channels])
        share = np.float32(count / (start + count))
        if self._spread is not None and start == count:
            number = row.astype(np.int64) * film.depth.shape[1] + column
            self._spread.half[:, number] = (before[:3] - mean[:3]) / 2
        film.combined[row, column] = (before + (mean[:4] - before) * share).T
        if self._settings.normals:
            old = film.normal[row, column].T
            film.normal[row, column] = (old + (mean[4:7] - old) * share).T
        film.sample_count[row, column] = start + count
        for (part, layer), points in zip(self._parts, self._part_points, strict=True):
            self._sample_part(part, layer, points, pixels, row, column, start, count)

    def _sample_part(
        self,
        part: Part,
        layer: Layer,
        points: tuple[PointSet, PointSet],
        pixels: Pixels,
        row: np.ndarray,
        column: np.ndarray,
        start: int,
        count: int,
    ) -> None:
        """Add samples of fog or lasers to the pixels of one tile."""
        if self._quadrature and part.plain.rest_dimensions == 1:
            sums = sum_quadrature(part.plain, pixels, pixels.key(), points[0], start, count, self._tolerance)
        else:
            sums = sum_samples(
                part.plain, pixels, pixels.key(), points, start, count, part.split, self._settings.batch_size
            )
        mean = np.clip(sums.values[:3] / count, -LARGEST, LARGEST)
        before = layer.radiance[row, column].T
        share = np.float32(count / (start + count))
        layer.radiance[row, column] = (before + (mean - before) * share).T
        layer.sample_count[row, column] = start + count

    @property
    def noise(self) -> float | None:
        """Error to be expected of a pixel's channel, on average, as the first sample of all tells; None in a
        picture too narrow for that.
        """
        radiance = self._reflected()
        everywhere = np.ones(radiance.shape[:2], bool)
        (deviation,) = mean_deviations(radiance, (0, 1), everywhere, sides=self.seen_in)
        return None if deviation is None else deviation / self.samples**0.75

    def hiding(self, edge: int) -> np.ndarray | None:
        """(rows, columns) of tiles with such an edge in pixels: as `noise`, in most of their pixels."""
        radiance = self._reflected()
        if radiance.shape[1] < 3:
            return None
        apart = np.zeros(radiance.shape[:2])
        middle = radiance[:, :-2] - 2 * radiance[:, 1:-1] + radiance[:, 2:]
        apart[:, 1:-1] = np.abs(middle).sum(axis=2, dtype=np.float64) / math.sqrt(6)
        # What has no neighbour on one side is as the next.
        apart[:, 0], apart[:, -1] = apart[:, 1], apart[:, -2]
        return hiding(apart / 3, edge) / self.samples**0.75

    def noise_of_halves(self) -> tuple[float, float] | None:
        """As `noise`, as a chessboard's white pixels alone tell, and the black ones."""
        radiance = self._reflected()
        # Neighbours at the corners are of one colour.
        black = black_of_chessboard(radiance.shape[:2])
        white, black = mean_deviations(radiance, (1, 1), ~black, black, sides=self.seen_in)
        if white is None or black is None:
            return None
        return white / self.samples**0.75, black / self.samples**0.75

    def _reflected(self) -> np.ndarray:
        """(H, W, 3) as it is, without what camera rays see by themselves where that is known."""
        radiance = self._film.combined[..., :3]
        return radiance if self.seen is None else radiance - self.seen[0].transpose(2, 1, 0)

    def deviation_a_sample(self) -> float | None:
        """As `ControlVariatePicture.deviation_a_sample`, of pixels that all have the same samples."""
        noise = self.noise
        return None if noise is None else 3 * noise / self.samples**0.25

    def _retire_blocks(self, pixels: Pixels, first: np.ndarray, second: np.ndarray) -> None:
        """Stop blocks whose error is small enough, judged by two halves (C, B) of their samples.

        The difference of two independent halves has twice the standard deviation of their mean; for
        Sobol points it overestimates the error. The halves enter the picture too: docs/sampling.md
        states the bias of that.
        """
        block = (pixels.y // BLOCK) * self._active.shape[1] + pixels.x // BLOCK
        block, place = np.unique(block, return_inverse=True)
        counts = np.bincount(place)
        error = 0.5 * np.abs(first - second).mean(axis=0, dtype=np.float64)
        brightness = np.abs(0.5 * (first + second)).mean(axis=0, dtype=np.float64)
        error = np.sqrt(np.bincount(place, error * error) / counts)
        brightness = np.bincount(place, brightness) / counts
        quiet = error <= self._settings.noise_threshold * np.sqrt(brightness)
        self._active.reshape(-1)[block[quiet]] = False

    def finish(self) -> None:
        """Fill the film's standard error, from the halves of what every pixel got in its last whole pass."""
        count = self._film.sample_count
        # One half of a chessboard may have more than the other.
        of_pixel = (
            np.where(black_of_chessboard(count.shape), *self.of_halves[::-1]) * 2 // min(self.of_halves)
        )
        error = standard_error(
            self._spread, np.minimum(count, of_pixel).ravel(), count.shape, independent=True
        ).reshape(3, *count.shape)
        if self.seen is not None:
            error = np.hypot(error, self.seen[1].transpose(0, 2, 1))
        self._film.standard_error[:] = np.minimum(error, LARGEST).transpose(1, 2, 0)


def mean_deviations(
    radiance: np.ndarray, step: tuple[int, int], *which: np.ndarray, sides: np.ndarray | None = None
) -> list[float | None]:
    """Of a pixel's channel in radiance (H, W, 3), by how much each differs from the mean of those a ``step``
    of rows and columns before and after; of blocks, the root of the mean square, so that rare specks count.

    which : (H, W) bool, pixels that count, each time. None where there are none, or none has such neighbours.
    sides : (H, W) bool, between which none are compared.

    What is linear makes none; sharper detail counts as if it were noise.
    """
    down, right = step
    height, width = radiance.shape[0] - 2 * down, radiance.shape[1] - 2 * right
    if height <= 0 or width <= 0:
        return [None] * len(which)

    def moved(times: int, of: np.ndarray = radiance) -> np.ndarray:
        return of[times * down :, times * right :][:height, :width]

    apart = np.abs(moved(0) - 2 * moved(1) + moved(2)).sum(axis=2, dtype=np.float64)
    # Of three independent samples a - 2 b + c has six times the variance.
    square = np.square(apart) / 6
    middle = [some[down : down + height, right : right + width] for some in which]
    if sides is not None:
        before, here, behind = (moved(times, sides) for times in range(3))
        middle = [some & (before == here) & (here == behind) for some in middle]
    return [_mean_of_blocks(square, some) for some in middle]


def _mean_of_blocks(square: np.ndarray, which: np.ndarray) -> float | None:
    """A channel's deviation by squares (H, W), of three channels, where they count."""
    sums = np.stack([np.where(which, square, 0), which])
    for axis in (1, 2):
        sums = np.add.reduceat(sums, np.arange(0, sums.shape[axis], BLOCK), axis=axis)
    square, count = sums[:, sums[1] > 0]
    return float(np.sqrt(square / count).mean()) / 3 if len(count) else None


def _light_samples(lights: int) -> int:
    """Shadow rays for each camera ray: one for one light, up to 8 (a power of two) for several.

    An edge of a shadow integrates as n^-0.75 over a net of n points, so several lights want their
    nets long more than they want camera rays (docs/sampling.md has the figures).
    """
    return 1 << (min(max(lights, 1), 8) - 1).bit_length()


def _tile_size(camera: Camera, threads: int) -> int:
    """A multiple of `BLOCK` that gives every thread some tiles, and every tile enough pixels for a batch."""
    width, height = camera.region_size
    edge = int(np.sqrt(width * height / (8 * threads)))
    return int(np.clip(edge // BLOCK * BLOCK, 32, 128))


def _tiles(camera: Camera, size: int) -> list[Tile]:
    """The region cut along a grid aligned to the whole frame, from its middle outwards."""
    x0, y0, x1, y1 = camera.region
    tiles = [
        Tile(max(x, x0), max(y, y0), min(x + size, x1), min(y + size, y1))
        for y in range(y0 // size * size, y1, size)
        for x in range(x0 // size * size, x1, size)
    ]
    middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
    tiles.sort(key=lambda t: max(abs((t.x0 + t.x1) / 2 - middle_x), abs((t.y0 + t.y1) / 2 - middle_y)))
    return tiles
