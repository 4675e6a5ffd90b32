# SPDX-License-Identifier: GPL-3.0-or-later
"""An integral of its own over every pixel, by a control variate over the screen alone.

Polynomials cover the two dimensions of the picture; what else is integrated is integrated inside each
node, by a rule, and at each sample of the residual, by an unbiased estimate: of fog, the light along a
whole camera ray. So h costs a few products, H one small matrix product a size of region, and most pixels
no sample at all.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np

from .image.film import LARGEST, Layer
from .integration.allocation import evenly_spread, sample_counts
from .integration.build import NodeEvaluator, grow, root_edge
from .integration.control_variates import drawn
from .integration.integrand import values_at
from .integration.point_sets import staged_points
from .integration.regions import BIN, RegionTree, neighbourly
from .integration.rules import bin_means, face_weights, lagrange
from .parts import SHADOW_RAYS, Map, OverScreen, cell_of
from .settings import Settings
from .transport.camera_hits import Pixels

CHANNELS = 3

SHARE = 1 / 3
"""Of the budget, spent on nodes."""

FEWEST = 4096
"""Nodes and samples of a picture, however small."""

PILOT_ONE_IN = 48
"""One pixel in so many is sampled first, and tells its block how right the nodes' prediction is."""

LOG_BLOCK = 3
"""log2 of the edge in pixels of the blocks that pilot samples speak for, with the blocks around."""

DEFENSIVE = 0.1
"""Of the residual samples, spread evenly."""

CHANCE = 1 / 32
"""The least with which a pixel is sampled at all."""

FRESH_SHARE, FEWEST_FRESH, MOST_FRESH = 1 / 16, 256, 8192
"""How many pixels tell of a net's error: of the samples that are left, at least, at most."""

DEAR = 8.0
"""Of `Settings.samples`, a sample of the residual that is worth so much is none to be spread about."""

MOST_DEAR = 4
"""What chances are divided by at most."""

PLACE = 1 / 64
"""Part of what the neighbours' samples show that is believed of a pixel whatever the nodes say of it."""

VISIBLE = 0.08
"""Noise of a pixel, of its brightness, that chance alone may make in a picture of one sample."""

PEAK = 4.0
"""How many times as large a single speck may be, as far as samples nearby tell."""

OUTLINE_OF_SHADOW = 0.03
"""Deviation of a sample, of the radiance, in regions that a shadow's outline crosses."""

FAITH = 0.5
"""How many samples' worth the whole picture weighs beside what the blocks around a pixel show."""

MOST = 1 << 12
"""Samples of a pixel at most."""

MOST_REGIONS = 1_000_000

BEYOND_HOPE = 0.5
"""Part of its variance that a region's polynomial may leave over: where it is more, f itself is sampled."""


class ScreenPicture:
    """One layer of a picture: built, shown whole, and refined where its error is.

    regions, nodes : how many there are. seconds : by stage. told : what was done, for people.
    """

    def __init__(
        self,
        by: OverScreen,
        settings: Settings,
        region: tuple[int, int, int, int],
        layer: Layer,
        check: Callable[[], None],
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._at_nodes, self._rule = by.at_nodes, by.rule
        self._sampled, self._alone, self._outlines = by.sampled, by.alone, by.outlines
        self._elsewhere, self._fresh = by.elsewhere, by.fresh
        self._split, self._alone_cost = by.split, max(1.0, by.split / SHADOW_RAYS)
        if by.alone is by.sampled:
            self._alone_cost = max(1.0, by.rays / SHADOW_RAYS)
        self._settings, self._layer, self._check = settings, layer, check
        self._cost = max(1.0, by.rays / SHADOW_RAYS)
        self._frame, self._corner = region, region[:2]
        self._bins = (region[2] - region[0], region[3] - region[1])
        self.regions = self.nodes = 0
        self.told = "given up: sampled"
        self.seconds: dict[str, float] = {}
        self._tree: RegionTree | None = None

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Build the polynomials and write their means into the layer; all plain where they do not help.

        map_ : runs a function over items on the workers. enough : whether to make do with what there is.
        """
        settings, bins = self._settings, self._bins
        alone = settings.integrator == "cv_only"
        # A small picture has as many things in it as a large one.
        self._left = total = max(float(settings.samples) * bins[0] * bins[1], FEWEST * self._cost)
        began = perf_counter()
        evaluator = NodeEvaluator(
            self._at_nodes, bins, self._pixels, 2, self._rule, settings.seed, map_, CHANNELS
        )
        worth = evaluator.cost / self._cost
        budget = total * worth * (1.0 if alone else SHARE)
        log_edge = root_edge(bins, 2, budget / evaluator.cost)
        # Alone, polynomials must serve all pixels. They cover outlines too, or there would be more edges of
        # regions than regions; but what is sampled there is f.
        self._outline = np.zeros(bins[::-1], bool) if alone else self._outlines(self._frame, map_).T
        if self._elsewhere is not None:
            self._outline |= self._elsewhere.T
        if log_edge is not None and not self._outline.all():
            tree = RegionTree(bins, 2, log_edge, evaluator, False)
            helps = grow(tree, evaluator, budget, total, MOST_REGIONS, enough)
            self.regions, self.nodes = len(tree), tree.store.count
            self._left -= evaluator.evaluations / worth
            if helps or alone:
                self._tree, self.told = tree, "built"
        grown = perf_counter()
        self._integrate()
        if self._fresh is not None and self.regions:
            self._correct(map_)
        self.seconds = {"nodes": grown - began, "means": perf_counter() - grown}
        self._write(slice(None), slice(None))

    def _pixels(self, index: np.ndarray) -> Pixels:
        x, y = index[0] + self._corner[0], index[1] + self._corner[1]
        return Pixels(x.astype(np.int32), y.astype(np.int32), cell_of(x, y, self._frame))

    def _integrate(self) -> None:
        """H of all pixels, which region each lies in (-1: none), and the predicted deviation of f - h."""
        width, height = self._bins
        self._mean = np.zeros((height, width, CHANNELS), np.float32)
        self._region = np.full((height, width), -1, np.int32)
        self._residual = np.zeros_like(self._mean)
        if self._tree is None:
            return
        tree = self._tree
        leaves, values = tree.leaves(), tree.store.values
        weights = face_weights(2)
        density = neighbourly(leaves.density, leaves, tree.store.count)
        coefficients = np.stack([v.take(leaves.nodes) for v in values], axis=-1)  # (R, 9, C)
        self._coefficients = coefficients.astype(np.float32)
        first = np.einsum("rnc,n->rc", coefficients, weights)
        inside = np.zeros(len(leaves))
        if tree.store.spread is not None:
            spread, *edges = np.atleast_2d(tree.store.spread)
            inside = neighbourly(spread.take(leaves.nodes) @ weights, leaves, tree.store.count)
            for of_nodes in (e.take(leaves.nodes) for e in edges):
                # Where some see a shadow's edge and others do not, there is its outline, steep as a root.
                mixed = of_nodes.min(axis=1) < of_nodes.max(axis=1)
                inside = np.hypot(inside, OUTLINE_OF_SHADOW * mixed * first.sum(axis=1))
        variance = np.maximum(np.einsum("rnc,n->rc", coefficients**2, weights) - first**2, 0)
        # One pixel's own variance can't be told from its noise: only where regions are no longer halved.
        hopeless = leaves.density**2 > BEYOND_HOPE * np.sqrt(variance).sum(axis=1) ** 2
        log = leaves.size.astype(np.int64) - BIN
        hopeless &= (log.sum(axis=0) == 0) & (leaves.density > 0)
        self._deviation, self._inside = density.astype(np.float32), inside.astype(np.float32)
        self._start = (leaves.start >> BIN).astype(np.int32)
        self._per_pixel = np.ldexp(1.0, -log).astype(np.float32)
        plain = np.flatnonzero(hopeless)
        code = log[0] * 64 + log[1]
        for kind in np.unique(code):
            chosen = np.flatnonzero(code == kind)
            edge = [1 << int(n) for n in divmod(int(kind), 64)]
            x, y = (self._start[d].take(chosen) for d in range(2))
            corner = y * width + x
            within = np.arange(edge[1])[:, None] * width + np.arange(edge[0])
            at = within.reshape(-1, 1) + corner
            # One product: means over pixels, times the regions' node values.
            each = np.einsum("xi,yj->yxij", *(bin_means(n) for n in edge)).reshape(-1, 9).astype(np.float32)
            grid = self._coefficients.take(chosen, axis=0).transpose(1, 0, 2).reshape(9, -1)
            self._mean.reshape(-1, CHANNELS)[at] = (each @ grid).reshape(*at.shape, CHANNELS)
            self._region.reshape(-1)[at] = chosen
        if plain.size:
            is_plain = np.zeros(len(leaves) + 1, bool)
            is_plain[plain] = True
            self._outline |= is_plain[self._region]
        self._tree = None

    def _correct(self, map_: Map) -> None:
        """Take off what the net at all nodes has in common: a smooth part of H, found by other nets.

        Some pixels are integrated by nets of their own beside this one; their differences, as a part of H
        that is a polynomial of the place, are fitted. What the fit leaves is 0 in the mean over seeds.
        """
        width, height = self._bins
        budget = self._left / self._cost
        count = int(np.clip(FRESH_SHARE * budget, FEWEST_FRESH, MOST_FRESH))
        index = np.flatnonzero(
            evenly_spread((width, height), max(width * height / count, 1), 3).T & ~self._outline
        )
        index = index[self._mean.reshape(-1, CHANNELS)[index].any(axis=1)]
        if len(index) < FEWEST_FRESH // 2:
            return

        def differ(part: np.ndarray) -> np.ndarray:
            self._check()
            y, x = np.divmod(part, width)
            pixels = self._pixels(np.stack([x, y]))
            middle = np.full((2, len(part), 1), 0.5, np.float32)
            fresh, ours = (f.first(pixels, middle).values for f in (self._fresh, self._sampled))
            return (fresh - ours)[:CHANNELS].T

        found = np.concatenate(map_(differ, self._chunks(index, 64)))
        self._left -= len(index) * self._cost * 1.5
        y, x = np.mgrid[:height, :width]
        terms = _terms(x / width - 0.5, y / height - 0.5).astype(np.float32)
        basis = (
            terms.reshape(len(terms), -1)[:, index].T[:, :, None]
            * self._mean.reshape(-1, CHANNELS)[index][:, None]
        )
        for channel in range(CHANNELS):
            a = basis[:, :, channel].astype(np.float64)
            scale = np.sqrt(np.square(a).sum(axis=0)) + 1e-300
            solution = np.linalg.lstsq(a / scale, found[:, channel], rcond=1e-6)[0] / scale
            self._mean[:, :, channel] *= 1 + np.tensordot(solution, terms, 1).astype(np.float32)
        # h, from which samples are told apart, has none of it.

    def allocate(self, map_: Map) -> None:
        """Sample a few pixels, which stay, and decide by them and the nodes how often all are sampled."""
        began = perf_counter()
        settings, (width, height) = self._settings, self._bins
        served = (self._region >= 0) & ~self._outline
        self._approximate = served
        # H stays on show until samples are there; from here on it is no part of a plain pixel.
        self._mean[~served] = 0
        said = np.ones((height, width), np.float32)
        if served.any():
            said[served] = self._deviation.take(self._region[served])
        self._points = staged_points("sobol", 2, self._sampled.rest_dimensions, 1, settings.seed + 1)
        self._alone_points = staged_points(
            "sobol", 2, self._alone.rest_dimensions, self._split, settings.seed + 1
        )
        self._prepare(2)
        # Dear samples are fewer.
        dear = float(np.clip(self._cost / DEAR, 1, MOST_DEAR))
        pilot = evenly_spread((width, height), PILOT_ONE_IN * dear, settings.seed).T & served
        self._count = np.zeros((height, width), np.int32)
        self._count[pilot] = 1
        alone = ~served if self._elsewhere is None else ~served & ~self._elsewhere.T
        self._count[alone] = 2
        found = np.zeros((height, width), np.float32)

        def few(chunk: tuple[int, np.ndarray]) -> None:
            n, part = chunk
            y, x = np.divmod(part, width)
            residual = self._residuals(x, y, n)
            self._residual[y, x] = residual.mean(axis=1)
            # Of f itself, how much its samples differ tells what h would of f - h.
            square = residual[:, 0] if n == 1 else (residual[:, 0] - residual[:, 1]) / np.sqrt(2)
            found[y, x] = np.square(np.abs(square).sum(axis=1))

        chunks = [
            (n, part)
            for n, which in ((1, pilot), (2, alone))
            for part in self._chunks(np.flatnonzero(which), n)
        ]
        map_(few, chunks)
        rows = np.flatnonzero(pilot)
        deviation = learned_by_blocks(found.reshape(-1)[rows], rows, said)
        if served.any():
            # What a node says of its own noise is known: few samples would miss what is rare in it.
            own = self._inside.take(self._region[served])
            deviation[served] = np.hypot(deviation[served], own)
        if not served.all():
            deviation[~served] = 0
            rows = np.flatnonzero(alone)
            deviation[alone] = learned_by_blocks(found.reshape(-1)[rows], rows, np.ones_like(said), rows)
        pilot |= ~served
        cost = np.where(served, self._cost, self._alone_cost)
        budget = self._left - float((self._count * cost).sum())
        # Where a sample is cheaper, more of them are worth it.
        cheap = np.sqrt(self._cost / cost)
        mean_cost = float((deviation * cheap * cost).sum()) / max(float((deviation * cheap).sum()), 1e-300)
        budget /= max(mean_cost, 1.0)
        due, chance = sample_counts((deviation * cheap).ravel(), max(budget, 1), DEFENSIVE, CHANCE / dear)
        due, chance = np.minimum(due, MOST).reshape(height, width), chance.reshape(height, width)
        if served.any():
            # What is sampled by chance is noisier by it: only where none sees that, whatever it costs.
            brightness = np.maximum(self._mean.sum(axis=2), 0)
            allowed = VISIBLE / np.sqrt(settings.samples) * (brightness + 0.25 * brightness.mean() + 1e-300)
            peaks = np.sqrt(_largest_around(np.where(pilot, found, 0)))
            least = np.maximum(np.square(deviation / allowed), peaks / (PEAK * allowed))
            np.minimum(least, 1, out=least)
            chance[served] = np.maximum(chance[served], least[served])
        kept = drawn(np.where(pilot, 1, chance).ravel(), settings.seed + 7).reshape(height, width)
        self._chance = np.where(pilot, 1, chance).astype(np.float32)
        due = np.where(kept, due, 0)
        due = np.where(served | alone, np.maximum(due, self._count), 0)
        self._due = due.astype(np.int32)
        self._deviation_learned = deviation
        self._prepare(int(due.max()))
        more = due > self._count
        self._work = [
            (n, part)
            for n in np.unique(due[more])[::-1]
            for which in (served, alone)
            for part in self._chunks(np.flatnonzero((due == n) & more & which), int(n))
        ]
        self.seconds["allocation"] = perf_counter() - began

    def _chunks(self, rows: np.ndarray, n: int) -> list[np.ndarray]:
        step = max(1, self._settings.batch_size // (n * 2))
        return [rows[low : low + step] for low in range(0, len(rows), step)]

    def __len__(self) -> int:
        """How many pieces of work there are."""
        return len(self._work)

    def work(self, number: int) -> int:
        """Samples that a piece takes."""
        n, part = self._work[number]
        return int(n) * len(part)

    def refine(self, number: int, done: Callable[[int], None]) -> None:
        """Sample the residual of a piece, and write it into the layer."""
        n, part = self._work[number]
        y, x = np.divmod(part, self._bins[0])
        mean = self._residuals(x, y, int(n)).mean(axis=1)
        self._residual[y, x] = mean / self._chance[y, x][:, None]
        self._count[y, x] = n
        self._write(y, x)
        done(int(n) * len(part))

    def _residuals(self, x: np.ndarray, y: np.ndarray, n: int) -> np.ndarray:
        """(B, n, C) samples of f - h in pixels (B,), or of f where h serves none of them."""
        self._check()
        pixels = self._pixels(np.stack([x, y]))
        keys = pixels.key()
        served = len(x) > 0 and self._approximate[y[0], x[0]]
        integrand, (first, rest) = (
            (self._sampled, self._points) if served else (self._alone, self._alone_points)
        )
        split = 1 if served else self._split
        screen, u = first.points(keys, 0, n), rest.points(keys, 0, n * split)
        stage = integrand.first(pixels, screen)
        f = values_at(integrand, stage, len(x) * n, None, u.reshape(len(u), len(x) * n * split))[:CHANNELS]
        f = f.reshape(CHANNELS, len(x), n, split).mean(axis=3, dtype=np.float64).transpose(1, 2, 0)
        return f - self._variate(x, y, screen) if served else f

    def _prepare(self, count: int) -> None:
        for points, split in ((self._points, 1), (self._alone_points, self._split)):
            points[0].prepare(count)
            points[1].prepare(count * split)

    def _variate(self, x: np.ndarray, y: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(B, n, C) h at points u (2, B, n) of pixels' unit squares."""
        region = self._region[y, x]
        weights = []
        for axis, place in enumerate((x, y)):
            t = (place - self._start[axis].take(region))[:, None] + u[axis]
            t *= self._per_pixel[axis].take(region)[:, None]
            weights.append(lagrange(t))  # (3, B, n)
        both = weights[0][:, None] * weights[1]
        return np.matmul(
            both.reshape(9, *u.shape[1:]).transpose(1, 2, 0), self._coefficients.take(region, axis=0)
        )

    def _write(self, y: np.ndarray | slice, x: np.ndarray | slice) -> None:
        h, residual = self._mean[y, x], self._residual[y, x]
        layer = self._layer
        layer.radiance[y, x] = np.clip(h + residual, -LARGEST, LARGEST)
        layer.control_variate[y, x], layer.residual[y, x] = h, residual

    def finish(self) -> None:
        """All that is left: pixels sampled in the pilot alone, counts, and the error."""
        self._write(slice(None), slice(None))
        self._layer.sample_count[:] = self._count
        # A mean of n points of a net, that is taken by chance.
        error = self._deviation_learned / np.sqrt(np.maximum(self._due, 1) * self._chance)
        self._layer.standard_error[:] = (error / CHANNELS)[..., None]


def _terms(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(6, ...) monomials up to the second degree."""
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])


def learned_by_blocks(
    found: np.ndarray, rows: np.ndarray, said: np.ndarray, wanted: np.ndarray | None = None
) -> np.ndarray:
    """Deviation of a sample: what the nodes predicted, as right as it was in the blocks around.

    found : (R,) f - h squared in pixels ``rows`` (R,). said : (H, W) the nodes' deviation.
    wanted : (N,) pixels; None for all, (H, W). A pixel's own sample has no say in its own deviation, so that
        it may be kept.
    """
    height, width = said.shape
    variance = np.square(said, dtype=np.float64)
    variance += 1e-4 * variance.mean() + 1e-300
    own = variance.reshape(-1)[rows]
    shape = tuple(-(-n >> LOG_BLOCK) for n in said.shape)
    block = (rows // width >> LOG_BLOCK) * shape[1] + (rows % width >> LOG_BLOCK)
    sums = [
        _around(np.bincount(block, weights, shape[0] * shape[1]).reshape(shape))
        for weights in (found, own, np.ones(len(rows)))
    ]
    # Of the whole picture what is typical: a few outliers are no reason to sample it all.
    some = sums[2] > 0
    typical = np.median(sums[0][some] / np.maximum(sums[1][some], 1e-300)) if some.any() else 1.0
    typical_mean = np.median(sums[0][some] / sums[2][some]) if some.any() else 0.0

    def of(seen, hoped, count):
        prior = FAITH * np.where(count > 0, hoped / np.maximum(count, 1), 1e-300)
        ratio = np.where(count > 0, (seen + prior * typical) / np.maximum(hoped + prior, 1e-300), typical)
        return ratio, PLACE * (seen + FAITH * typical_mean) / (count + FAITH)

    ratio, mean = of(*sums)
    less = [s.reshape(-1)[block] for s in sums]
    own_ratio, own_mean = of(*(np.maximum(a - b, 0) for a, b in zip(less, (found, own, 1), strict=True)))
    if wanted is None:
        y, x = np.arange(height) >> LOG_BLOCK, np.arange(width) >> LOG_BLOCK
        square = variance * ratio[:, x].take(y, axis=0)
        square += mean[:, x].take(y, axis=0)
        square.reshape(-1)[rows] = own * own_ratio + own_mean
        return np.sqrt(square, out=square)
    at = np.searchsorted(rows, wanted)
    block = (wanted // width >> LOG_BLOCK) * shape[1] + (wanted % width >> LOG_BLOCK)
    square = variance.reshape(-1)[wanted] * ratio.reshape(-1)[block] + mean.reshape(-1)[block]
    same = np.flatnonzero(rows.take(np.minimum(at, len(rows) - 1)) == wanted) if len(rows) else at[:0]
    square[same] = (own * own_ratio + own_mean).take(at[same])
    return np.sqrt(square)


def _largest_around(a: np.ndarray) -> np.ndarray:
    """(H, W) the largest of ``a`` in each pixel's block and the eight around."""
    shape = a.shape
    for axis in range(2):
        a = np.maximum.reduceat(a, np.arange(0, a.shape[axis], 1 << LOG_BLOCK), axis=axis)
        padded = np.pad(a, [(1, 1) if i == axis else (0, 0) for i in range(2)])
        low, middle, high = (np.take(padded, np.arange(k, k + a.shape[axis]), axis=axis) for k in range(3))
        a = np.repeat(np.maximum(np.maximum(low, middle), high), 1 << LOG_BLOCK, axis=axis)
        a = np.take(a, np.arange(shape[axis]), axis=axis)
    return a


def _around(a: np.ndarray) -> np.ndarray:
    """Sums of each with its eight neighbours."""
    padded = np.pad(a, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:]
