# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers that no polynomial makes: what rays see of lasers, and fog about lights in the picture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .image.film import LARGEST, Layer
from .integration.integrand import StagedIntegrand
from .integration.mapping import Map, even_parts
from .integration.point_sets import SobolPoints, staged_points
from .integration.sample_mean import sum_samples
from .integration.sobol import hash_combine
from .integration.standard_error import box_sums
from .parts import AroundLights, Region, Seen, Targets, cell_of
from .seen_through_lens import seen_through_lens
from .settings import Settings
from .transport.around_light import Block
from .transport.camera_hits import Pixels

FIRST_SAMPLES = 4, 1
"""Twice as many a pixel about a light tell what its own light, and that of others, deviates by."""

SAMPLES, MOST_SAMPLES = 16.0, 4096
"""Of a pixel about a light, where they deviate by the picture's mean radiance in a picture of one sample, and
at most. They grow as the power of 2/3 of the deviation, and of `Settings.samples`: so errors are least that
fall as 1 / samples."""

ROWS = 16
"""Of the picture, whose beams are drawn at once."""


class SeenPicture:
    """An integral over the pixel alone.

    told : what was done, for people. seconds, regions, nodes : as in `ScreenPicture`; there are none.
    """

    told = "seen by camera rays alone"
    regions = nodes = 0

    def __init__(
        self, by: Seen, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._by, self._settings, self._region, self._layer, self._check = by, settings, region, layer, check
        self.seconds: dict[str, float] = {}

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Draw all of it. map_ : runs a function over items on the workers. enough : not asked."""
        x0, y0, x1, y1 = self._region
        points = SobolPoints(range(2), self._settings.seed + 3, 0, dtype=np.float64)
        points.prepare(max(self._by.points))
        layer, by = self._layer, self._by

        def draw(low: int) -> None:
            y, x = (a.ravel().astype(np.int32) for a in np.mgrid[low : min(low + ROWS, y1), x0:x1])
            pixels = Pixels(x, y, cell_of(x, y, self._region))
            for touched, means, count in zip(by.touched, by.means, by.points, strict=True):
                rows = touched(pixels)
                step = max(1, self._settings.batch_size // count)
                for chunk in (rows[first : first + step] for first in range(0, len(rows), step)):
                    self._check()
                    some = pixels[chunk]
                    mean, error = means(some, points.points(some.key(), 0, count))
                    at = some.y - y0, some.x - x0
                    layer.radiance[at] += np.clip(mean, -LARGEST, LARGEST).T
                    if self._settings.standard_error:
                        layer.standard_error[at] += np.minimum(error, LARGEST).T

        map_(draw, range(y0, y1, ROWS))
        if self._settings.terms:
            layer.control_variate[:] = layer.radiance


class TargetsPicture:
    """What a lens sees of small things alone.

    told, seconds, regions, nodes : as in `SeenPicture`.
    """

    told = "seen through parts of the lens"
    regions = nodes = 0

    def __init__(
        self, by: Targets, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region, check : as in `SeenPicture`."""
        self._by, self._settings, self._region, self._layer, self._check = by, settings, region, layer, check
        self.seconds: dict[str, float] = {}

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Draw all of it. map_ : as of `SeenPicture`. enough : whether to make do with the first points."""
        settings, layer, of_lens = self._settings, self._layer, self._by.of_lens()
        at = of_lens, self._region, settings, settings.seed + 3
        index, mean, error = seen_through_lens(self._by.first, *at, map_, enough, self._check)
        layer.radiance.reshape(-1, 3)[index] = np.clip(mean, -LARGEST, LARGEST).T
        if settings.standard_error:
            layer.standard_error.reshape(-1, 3)[index] = np.minimum(error, LARGEST).T
        if settings.terms:
            layer.control_variate[:] = layer.radiance


@dataclass(eq=False)
class _Term:
    """One integrand over the pixels (B,) of a block: those of its lights' samples that were taken.

    first : half of those that are taken to begin with. number : of all terms. total : (3, B) sum of samples.
    spread : (B,) deviation of a sample. count : (B,).
    """

    integrand: StagedIntegrand
    block: Block
    first: int
    lights: int
    number: int
    total: np.ndarray
    spread: np.ndarray
    count: np.ndarray


class AroundLightsPicture:
    """Pixels about lights in the picture, each integrated by itself.

    told, seconds, regions, nodes : as in `SeenPicture`.
    """

    regions = nodes = 0

    def __init__(
        self, by: AroundLights, settings: Settings, region: Region, layer: Layer, check: Callable[[], None]
    ) -> None:
        """region, check : as in `SeenPicture`; integrands check for themselves."""
        self._settings, self._region, self._layer = settings, region, layer
        self.told = f"sampled around {len(by.blocks)}"
        self.seconds: dict[str, float] = {}
        self._terms: list[_Term] = []
        for block, own, others in zip(by.blocks, by.own, by.others, strict=True):
            for first, (integrand, lights) in zip(
                (FIRST_SAMPLES[0], *[FIRST_SAMPLES[1]] * len(others)), ((own, 1), *others), strict=True
            ):
                n = len(block.x)
                empty = np.zeros((3, n)), np.zeros(n), np.full(n, 2 * first)
                self._terms.append(_Term(integrand, block, first, lights, len(self._terms), *empty))
        # A pixel's samples of each integrand have nets of their own, and pixels keys of theirs.
        self._nets = {
            dimensions: staged_points("sobol", 2, dimensions, 1, settings.seed + 5)
            for dimensions in {term.integrand.rest_dimensions for term in self._terms}
        }

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Take the first samples of all; arguments as in `SeenPicture`."""
        self._prepare(2 * max(FIRST_SAMPLES))

        def begin(piece: tuple[_Term, slice]) -> None:
            term, part = piece
            rows = np.arange(len(term.count))[part]
            one, other = (self._sum(term, rows, low, term.first) for low in (0, term.first))
            term.total[:, part] = one + other
            term.spread[part] = np.square(np.abs(one - other).sum(axis=0)) / 2

        pieces = []
        for term in self._terms:
            most = max(1, self._settings.batch_size // term.first)
            pieces += [(term, part) for part in even_parts(len(term.count), most)]
        map_(begin, pieces)
        for term in self._terms:
            term.spread = np.sqrt(_of_neighbours(term.block, term.spread))
        self.show(map_)

    def allocate(self, map_: Map, around: np.ndarray, bright: float, of_surfaces: float | None) -> None:
        """Decide how many samples each pixel has; arguments as in `ScreenPicture.allocate`.

        A pixel's own first samples, which stay, have no say.
        """
        self._work = []
        for term in self._terms:
            wanted = term.spread * (self._settings.samples / max(bright, float(np.finfo(np.float32).tiny)))
            # What costs more is taken less often.
            wanted = SAMPLES * np.cbrt(np.square(wanted) / term.lights)
            # What none of its neighbours found may be there all the same.
            least = 2 * term.first * self._settings.samples ** (2 / 3)
            log = np.rint(np.log2(np.clip(wanted, min(least, MOST_SAMPLES), MOST_SAMPLES))).astype(int)
            for n in 1 << np.unique(log):
                rows = np.flatnonzero(1 << log == n)
                most = max(1, self._settings.batch_size // int(n))
                if n > 2 * term.first:
                    self._work += [(int(n), term, rows[part]) for part in even_parts(len(rows), most)]
        self._prepare(max((n for n, _, _ in self._work), default=0))
        # The largest first, so that no thread ends up with it alone.
        self._work.sort(key=lambda work: -work[0] * len(work[2]))

    def __len__(self) -> int:
        """How many pieces of work there are."""
        return len(self._work)

    def work(self, number: int) -> int:
        """Samples that a piece takes."""
        n, term, rows = self._work[number]
        return (n - 2 * term.first) * len(rows)

    def refine(self, number: int, done: Callable[[int], None]) -> None:
        """Take the samples of a piece."""
        n, term, rows = self._work[number]
        term.total[:, rows] += self._sum(term, rows, 2 * term.first, n - 2 * term.first)
        term.count[rows] = n
        done(self.work(number))

    def finish(self) -> None:
        """What samples tell beside the radiance: their counts, and the error."""
        (x0, y0), layer = self._region[:2], self._layer
        for term in self._terms:
            at = term.block.y - y0, term.block.x - x0
            layer.sample_count[at] += term.count
            if self._settings.standard_error:
                error = (term.spread / term.count / 3)[:, None]
                layer.standard_error[at] = np.hypot(layer.standard_error[at], error)

    def show(self, map_: Map) -> None:
        """Sum all terms up, in one order. map_ : not used."""
        (x0, y0), radiance = self._region[:2], self._layer.radiance
        radiance[:] = 0
        for term in self._terms:
            mean = np.clip(term.total / term.count, -LARGEST, LARGEST).T
            radiance[term.block.y - y0, term.block.x - x0] += mean
        if self._settings.terms:
            self._layer.residual[:] = radiance

    def _prepare(self, count: int) -> None:
        for nets in self._nets.values():
            for group in nets:
                group.prepare(count)

    def _sum(self, term: _Term, rows: np.ndarray, start: int, count: int) -> np.ndarray:
        """(3, B) sum of samples ``start`` to ``start + count`` of pixels ``rows`` (B,) of a term's block."""
        x, y = (a[rows].astype(np.int32) for a in (term.block.x, term.block.y))
        pixels = Pixels(x, y, cell_of(x, y, self._region))
        keys = hash_combine(pixels.key(), term.number)
        points = self._nets[term.integrand.rest_dimensions]
        sums = sum_samples(term.integrand, pixels, keys, points, start, count, 1, self._settings.batch_size)
        return sums.values[:3]


def _of_neighbours(block: Block, square: np.ndarray) -> np.ndarray:
    """(B,) means over a block's pixels next to each of ``square`` (B,), without its own; where it has none,
    over all others.
    """
    x, y = block.x - block.x.min(), block.y - block.y.min()
    values = np.zeros((2, x.max() + 1, y.max() + 1))
    values[:, x, y] = np.stack([square, np.ones(len(square))])
    total, count = np.maximum(box_sums(values, 1)[:, x, y] - values[:, x, y], 0)
    every = (square.sum() - square) / max(len(square) - 1, 1)
    return np.where(count > 0.5, total / np.maximum(count, 1), every)
