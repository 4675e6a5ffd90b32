# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture by control variates: built, shown whole, and refined where its error is.

The same parts as `integration.control_variates`, in the renderer's own batches: pixels are the bins,
the first axis running to the right.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .directly_seen import directly_seen
from .image.film import FAR, LARGEST, Film
from .integration.allocation import black_of_chessboard, learned_deviation, sample_counts
from .integration.build import NodeEvaluator, grow, root_edge
from .integration.control_variate import LOG_BINS, ControlVariate, TileOfRegions
from .integration.control_variates import BEYOND_HOPE, TWICE_ONE_IN, ControlVariates
from .integration.mapping import Map, in_order
from .integration.point_sets import staged_points
from .integration.regions import RegionTree
from .integration.residual import ResidualSampler
from .integration.standard_error import Spread, sampled_twice, standard_error
from .points_of_tiles import hiding
from .settings import Settings
from .transport.direct_light import ALPHA, NORMAL, CameraHits, DirectLight, DirectLightOverTile, Pixels
from .transport.light_choice import EveryLight
from .trial import Trial

MOST_LIGHTS = 8
"""Lights that are summed at every evaluation; more are chosen among, which no polynomial follows."""

LOOKS = 16
"""Camera rays of a pixel where only these tell its alpha."""

CHANNELS = 3
"""What is approximated: radiance. Alpha is the mean of camera rays, so that it is 0 or 1 where it must be."""

MOST = 1 << 14
"""Samples of a pixel at most: nets are made for the longest."""

FIRST_PASS = 8
"""Samples a pixel, the polynomials' included, of the first of the passes that double them."""

DEFENSIVE, DEFENSIVE_OF_F = 0.1, 0.4
"""Of the residual samples, spread evenly; and where h is given up: then nodes saw little of what there is."""

OF_F = 0.75
"""Power of the deviation in the number of samples where h is given up."""

SHARE = 0.25
"""Of all samples, spent on the polynomials. Fewer than is best without a pilot: it knows more than nodes."""

FREE = 0.1
"""The part of a pixel's first sample that the budget pays at least. All of it, and of one or two samples a
pixel none would be left for where the error is."""

MOST_REGIONS = 400_000
"""Of a picture: about 2 kB each."""


class ControlVariatePicture:
    """H of a whole picture, and the residual of its tiles.

    regions, nodes : how many there are. told : what was done, for people.
    deviation_a_sample : sum over pixels of the deviation of a sample, channels summed, over how many samples
        are due; None as long as that is not known.
    noise : error to be expected of a pixel's channel, on average; None as that.
    """

    deviation_a_sample: float | None = None
    noise: float | None = None

    def __init__(
        self,
        integrand: DirectLight,
        settings: Settings,
        region: tuple[int, int, int, int],
        film: Film,
        check: Callable[[], None],
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._direct_light = integrand
        self._settings = settings
        self._corner = region[:2]
        self._film = film
        self._check = check
        self._bins = (region[2] - region[0], region[3] - region[1])
        choice = EveryLight() if len(integrand.lights) > 1 else None
        self.integrand = DirectLightOverTile(integrand, choice, check, seen=not integrand.sees)
        self.covered = 4
        self._options = ControlVariates(share=SHARE)
        self.regions = self.nodes = 0
        self.told = "built"
        self._reached = -1

    def build(self, map_: Map, enough: Callable[[], bool]) -> bool:
        """Build the polynomials and write their means into the film; False where not one region is afforded.

        map_ : runs a function over items on the workers, and returns the results in order.
        enough : whether to go on with the polynomials that there are.
        """
        settings, bins = self._settings, self._bins
        alone = settings.integrator == "cv_only"
        total = float(settings.samples) * bins[0] * bins[1]
        evaluator = NodeEvaluator(
            self.integrand,
            bins,
            self._pixels,
            self.covered,
            None,
            settings.seed,
            map_,
            CHANNELS,
        )
        budget = total * (1.0 if alone else self._options.share)
        log_edge = root_edge(bins, self.covered, budget / evaluator.cost)
        if log_edge is None:
            return False
        expected = int(budget / evaluator.cost)
        tree = RegionTree(bins, self.covered, log_edge, evaluator, False, map_=map_, expected=expected)
        self._see(_mean(tree), map_)
        trial = Trial(
            self.integrand,
            self._pixels,
            settings,
            lambda log_bins: self._variate_of(tree, log_edge, map_, log_bins),
            tree,
            budget,
            map_,
        )

        def grown() -> bool:
            return enough() or not alone and trial.lost(evaluator.evaluations)

        try:
            helps = grow(tree, evaluator, budget, total, MOST_REGIONS, grown)
        except BaseException:
            # Given up between two sweeps' evaluations: what was built before them is whole.
            self._check = lambda: None
            self._show(tree, log_edge, in_order)
            raise
        self.regions, self.nodes = len(tree), tree.store.count
        self._left = total - evaluator.evaluations - trial.spent
        self._show(tree, log_edge, map_)
        if not alone and (trial.beaten or not helps):
            # Its means are shown until there are samples, and pixels still have as many as they need.
            self._plain[:], self.told = True, "given up: samples of f itself are better"
        self._alone = alone
        if alone:
            self._due, self._twice, self.passes = np.ones(bins, np.int64), np.zeros(bins, bool), 1
            self._have = np.zeros(bins, np.int64)
            self._points = staged_points("sobol", 2, 0, 1, settings.seed + 1)
            self._points[0].prepare(LOOKS)
        else:
            self._allocate(map_)
        return True

    def _see(self, reflected: float, map_: Map) -> None:
        """What camera rays see by themselves is integrated apart from what is ``reflected``, in the mean."""
        # Read alone, and of one number where nothing is seen.
        self._first = self._first_error = np.broadcast_to(np.float32(0), (CHANNELS, *self._bins))
        if self._direct_light.sees:
            eye = DirectLightOverTile(self._direct_light, None, self._check, reflects=False)
            eye.counts = self.integrand.counts
            (x, y), (width, height) = self._corner, self._bins
            region = x, y, x + width, y + height
            seen = directly_seen(eye, self._direct_light.stage, region, self._settings, map_, reflected)
            self._first, self._first_error = np.clip(seen, -LARGEST, LARGEST).astype(np.float32)

    def _show(self, tree: RegionTree, log_edge: int, map_: Map) -> None:
        """Integrate the polynomials, and write their means into the film."""
        self._variate = self._variate_of(tree, log_edge, map_)
        self._mean = np.zeros((CHANNELS, *self._bins), np.float32)
        self._error = np.zeros(self._bins, np.float32)
        self._plain = np.zeros(self._bins, bool)
        map_(self._integrate, range(len(self._variate)))
        self._film.combined[..., ALPHA] = 1

    def _variate_of(
        self, tree: RegionTree, log_edge: int, map_: Map, log_bins: int = LOG_BINS
    ) -> ControlVariate:
        return ControlVariate(tree, log_edge, self._options.max_overlaps, map_, log_bins)

    def _pixels(self, index: np.ndarray) -> Pixels:
        x, y = index[0] + self._corner[0], index[1] + self._corner[1]
        return Pixels(x.astype(np.int32), y.astype(np.int32), np.zeros(len(x), np.int32))

    def _integrate(self, number: int) -> None:
        self._check()
        tile, (x, y) = self._variate.tile(number), self._part(number)
        mean, error, unexplained = tile.means(self._variate.spread)
        self._mean[:, x, y] = np.clip(mean, -LARGEST, LARGEST).reshape(CHANNELS, *tile.shape)
        self._error[x, y] = np.minimum(error, LARGEST).reshape(tile.shape)
        self._plain[x, y] = unexplained.reshape(tile.shape) > BEYOND_HOPE
        self._write(x, y, self._first[:, x, y] + self._mean[:, x, y])
        if self._settings.terms:
            self._film.control_variate[y, x] = self._film.combined[y, x, :CHANNELS]

    def _allocate(self, map_: Map) -> None:
        """Sample all pixels once, which stays, and decide by it and the nodes how often each is sampled."""
        settings, bins = self._settings, self._bins
        # Only to know the error is any pixel sampled twice.
        twice = np.zeros(bins, bool)
        if settings.standard_error:
            twice = sampled_twice(self._error.size, TWICE_ONE_IN, settings.seed).reshape(bins)
        # Alpha and normals are known from samples alone.
        self._every = self._direct_light.transparent or settings.normals
        self._twice = twice
        self._points = staged_points("sobol", 2, self.integrand.rest_dimensions, 1, settings.seed + 1)
        for group in self._points:
            group.prepare(1)
        self._sampler = ResidualSampler(self._points, self.covered, batch=settings.batch_size)
        self._spread = Spread.empty(CHANNELS, self._error.size) if settings.standard_error else None
        self._residual = np.zeros((CHANNELS, self._error.size), np.float32)
        self._have = np.ones(bins, np.int64)
        square = np.zeros(bins)

        def sample_pilot(number: int) -> None:
            x, y = part = self._part(number)
            one = self._have[part].ravel()
            self._sample(number, np.zeros_like(one), one)
            # H stays on show where f itself is sampled, until the samples are there.
            mean, residual = (a.reshape(self._mean.shape)[:, x, y] for a in (self._mean, self._residual))
            approximate = np.where(self._plain[part], mean, 0)
            mean -= approximate
            square[part] = np.square(np.abs(residual - approximate).sum(axis=0), dtype=np.float64)

        map_(sample_pilot, range(len(self)))
        self._square = square
        self._deviation = error = learned_deviation(square, np.ones(bins, bool), self._error, map_)
        defensive, in_proportion, budget = DEFENSIVE, error, self._left
        if self._plain.all():
            # It took more to see that h is of no use than these cost; and the error of a net of two is far
            # less than that of a point.
            budget += error.size / settings.samples
            # Each has one in any case.
            defensive = max(DEFENSIVE, DEFENSIVE_OF_F * (1 - 1 / settings.samples))
            # A net's error falls faster than by the root of its points.
            in_proportion = error**OF_F
        due, _ = sample_counts(in_proportion.ravel(), budget / (1 + twice.mean()), defensive, FREE, map_)
        self._due = due = np.minimum(due, MOST).reshape(bins)
        if settings.noise_threshold:
            brightness = np.sqrt(np.maximum(self._film.combined[..., :CHANNELS].mean(axis=-1).T, 0))
            wanted = settings.noise_threshold * np.where(brightness > 0, brightness, np.inf)
            # The error of a net falls about as n^-3/4.
            over = np.divide(error, wanted, dtype=np.float64)
            enough = np.ceil(np.log2(np.maximum(over, 1)) * 4 / 3).astype(np.int64)
            least = 1 << (min(settings.min_samples, MOST) - 1).bit_length()
            self._due = np.minimum(due, np.maximum(1 << np.minimum(enough, 30), least))
        self.deviation_a_sample = float(error.sum(dtype=np.float64) / max(self._due.sum(), error.size))
        # Nets' errors fall faster than by the root of their points.
        expected = error / np.maximum(self._due, 1).astype(np.float32) ** np.float32(0.75)
        self.noise = float(expected.mean(dtype=np.float64)) / CHANNELS
        self.passes = 1 + max(0, int(np.log2(settings.samples / FIRST_PASS)))
        for group in self._points:
            group.prepare(int(self._due.max()))

    def hiding(self, edge: int) -> np.ndarray | None:
        """(rows, columns) of tiles with such an edge in pixels: as `noise`, in most of their pixels."""
        if self.noise is None:
            return None
        expected = np.sqrt(self._square) / np.maximum(self._due, 1) ** 0.75
        return hiding(expected.T / CHANNELS, edge)

    def noise_of_halves(self, map_: Map) -> tuple[float, float]:
        """As `noise`, as the pilots of a chessboard's white pixels alone tell, and those of the black ones.

        map_ : runs a function over items on the workers.
        """
        black, of_halves = black_of_chessboard(self._bins), []
        for told in (~black, black):
            error = learned_deviation(self._square, told, self._error, map_)
            # Samples go where the error is, and each net's falls as below.
            mean = error.mean(dtype=np.float64) ** 0.75 * (error**0.25).mean(dtype=np.float64)
            of_halves.append(float(mean / np.maximum(self._due, 1).mean() ** 0.75) / CHANNELS)
        return of_halves[0], of_halves[1]

    def take_more(self, times: tuple[int, int]) -> None:
        """So many times the samples, powers of two, of a chessboard's white and black pixels; before any pass
        over them.
        """
        of_each = np.where(black_of_chessboard(self._bins), times[1], times[0])
        self._due = np.minimum(self._due * of_each, MOST)
        self.passes += max(times).bit_length() - 1
        for group in self._points:
            group.prepare(int(self._due.max()))

    @property
    def rays(self) -> int:
        """To be traced in all, about."""
        return 2 * int(self._due.sum())

    def __len__(self) -> int:
        """How many tiles there are to refine."""
        return len(self._variate)

    def box(self, number: int) -> tuple[int, int, int, int]:
        """x0, y0, x1, y1 of a tile in the film."""
        (x0, y0), (x1, y1) = self._variate.box(number)
        return x0, y0, x1, y1

    def _count(self, where: tuple, number: int) -> np.ndarray:
        """Samples that pixels have after pass ``number``: a power of two, twice as many each time, or 0."""
        if number < 0:
            return self._have[where]
        due = self._due[where]
        return np.maximum(due >> (self.passes - 1 - number), np.minimum(due, 1))

    def _part(self, number: int) -> tuple[slice, slice]:
        """A tile's columns and rows."""
        x0, y0, x1, y1 = self.box(number)
        return slice(x0, x1), slice(y0, y1)

    def work(self, number: int, pass_: int) -> int:
        """Samples that a tile takes in a pass; in the first at least one, or it would not be shown."""
        where = self._part(number)
        new = self._count(where, pass_) - self._count(where, pass_ - 1)
        return max(int((new * (1 + self._twice[where])).sum()), int(pass_ == 0))

    def refine(self, number: int, pass_: int, done: Callable[[int], None]) -> None:
        """Sample a tile's residual and write it into the film. done : called with samples done."""
        if self._alone:
            tile = self._variate.tile(number)
            self._look(tile, self._pixels(tile.index), done)
            return
        x, y = part = self._part(number)
        self._sample(number, *(self._count(part, p).ravel() for p in (pass_ - 1, pass_)), done)
        film, h = self._film, self._first[:, x, y] + self._mean[:, x, y]
        residual = self._residual.reshape(self._mean.shape)[:, x, y]
        self._write(x, y, h + residual)
        if self._settings.terms:
            for term, value in ((film.control_variate, h), (film.residual, residual)):
                term[y, x] = np.clip(value, -LARGEST, LARGEST).T
        film.sample_count[y, x] = (self._count(part, pass_) * (1 + self._twice[part])).T
        self._reached = pass_

    def _sample(
        self,
        number: int,
        have: np.ndarray,
        count: np.ndarray,
        done: Callable[[int], None] = lambda samples: None,
    ) -> None:
        """Sample the B pixels of a tile, which have ``have`` (B,) samples, up to ``count`` (B,)."""
        tile = self._variate.tile(number)
        x, y = part = self._part(number)
        twice, film = self._twice[part].ravel(), self._film
        pixels, new = self._pixels(tile.index), count - have
        depth = film.depth[y, x].T.ravel()
        seen = np.zeros((self._direct_light.channels - ALPHA, len(new)))

        def after_batch(some: np.ndarray, samples: np.ndarray, hits: CameraHits) -> None:
            begin = np.cumsum(samples) - samples
            first = np.flatnonzero(have.take(some) == 0)
            depth[some.take(first)] = np.minimum(hits.depth.take(begin.take(first)), FAR)
            if self._every:
                sums = np.add.reduceat(hits.values[ALPHA:], begin, axis=1, dtype=np.float64)
                for row, values in zip(seen, sums, strict=True):
                    np.add.at(row, some, values)
            done(len(hits.depth))

        def of_tile(picture: np.ndarray) -> np.ndarray:
            """The tile's part of a picture's array (C, all pixels)."""
            return picture.reshape(-1, *self._bins)[:, x, y]

        of_picture, spread = self._spread, None
        if of_picture is not None:
            spread = Spread(*(of_tile(a).reshape(CHANNELS, -1) for a in (of_picture.half, of_picture.twice)))
        mean, spread = self._sampler.sample(
            self.integrand,
            pixels,
            pixels.key(),
            tile,
            tile.density(self._variate.spread),
            self._error[part].ravel(),
            count,
            np.ones(len(new)),
            twice,
            after_batch,
            self._plain[part].ravel(),
            have,
            (of_tile(self._residual).reshape(CHANNELS, -1), spread),
        )
        of_tile(self._residual)[:] = np.clip(mean, -LARGEST, LARGEST).reshape(CHANNELS, *tile.shape)
        if of_picture is not None:
            for old, now in ((of_picture.half, spread.half), (of_picture.twice, spread.twice)):
                of_tile(old)[:] = now.reshape(CHANNELS, *tile.shape)
        film.depth[y, x] = depth.reshape(tile.shape).T
        if self._every:
            # Alpha and normals are means over samples: those before, and the new ones.
            seen /= np.maximum(new * (1 + twice), 1)
            share = new / np.maximum(count, 1)
            alpha, normal = film.combined[y, x, ALPHA].T, film.normal[y, x].T
            seen, share = (a.reshape(-1, *tile.shape) for a in (seen, share))
            alpha += (seen[0] - alpha) * share[0]
            if self._settings.normals:
                normal += (seen[NORMAL.start - ALPHA :] - normal) * share

    def _look(self, tile: TileOfRegions, pixels: Pixels, done: Callable[[int], None]) -> None:
        """Camera rays alone: the polynomials know neither depth, nor normals, nor alpha."""
        x, y = tile.index
        film, rays = self._film, LOOKS if self._direct_light.transparent else 1
        step = max(1, self._settings.batch_size // rays)
        for low in range(0, len(pixels), step):
            part = slice(low, low + step)
            keys = pixels[part].key()
            hits = self.integrand.first(pixels[part], self._points[0].points(keys, 0, rays))
            seen = hits.values[ALPHA:].reshape(-1, len(keys), rays).mean(axis=2)
            film.depth[y[part], x[part]] = np.minimum(hits.depth.reshape(-1, rays)[:, 0], FAR)
            film.sample_count[y[part], x[part]] = rays
            film.combined[y[part], x[part], ALPHA] = seen[0]
            if self._settings.normals:
                film.normal[y[part], x[part]] = seen[NORMAL.start - ALPHA :].T
            done(len(keys))

    def _write(self, x: np.ndarray | slice, y: np.ndarray | slice, value: np.ndarray) -> None:
        """Channels (C, ...) of pixels into the film; nothing is brighter than it can hold."""
        value = np.clip(value, -LARGEST, LARGEST)
        for channel, pixels in enumerate(value):
            self._film.combined[..., channel].T[x, y] = pixels

    def finish(self) -> None:
        """Fill the film's standard error."""
        count = self._count((slice(None), slice(None)), self._reached)
        error = standard_error(
            self._spread, count.ravel(), self._bins, self._deviation.ravel(), np.ones(count.size)
        )
        error = np.hypot(error.reshape(-1, *self._bins), self._first_error)
        self._film.standard_error[:] = np.minimum(error, LARGEST).transpose(2, 1, 0)


def _mean(tree: RegionTree) -> float:
    """What a tree's polynomials are in the mean, about; of a channel."""
    regions = tree.leaves()
    middle = regions.nodes.shape[1] // 2
    means = [float(regions.volume @ v.take(regions.nodes[:, middle])) for v in tree.store.values]
    return max(sum(means) / len(means), 0.0)


def obstacles(integrand: DirectLight) -> str:
    """Why no polynomial serves an integrand; empty if they do.

    They follow no choice among lights, nor among triangles of one, no lens, and not the needles that a BSDF
    finds lamps with when it is sampled alone; and light without size leaves them nothing but the pixel.
    """
    found = {
        f"more than {MOST_LIGHTS} lights": len(integrand.lights) > MOST_LIGHTS,
        "mesh lights of many triangles": integrand.chooses_piece,
        "depth of field": integrand.screen_dimensions > 2,
        "no light has a size": integrand.only_points,
        "no surface reflects": not integrand.reflects,
        "BSDFs sampled alone": integrand.sampling == "bsdf" and not integrand.lambertian,
    }
    return ", ".join(what for what, there in found.items() if there)
