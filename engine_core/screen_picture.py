# SPDX-License-Identifier: GPL-3.0-or-later
"""An integral of its own over every pixel, by a control variate over the screen alone.

Polynomials cover the two dimensions of the picture; what else is integrated is integrated inside each
node, by a rule, and at each sample of the residual, by an unbiased estimate: the light along a whole
camera ray. So h costs a few products, H one small matrix product a size of region, and most pixels
no sample at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from time import perf_counter

import numpy as np

from .image.film import LARGEST, Layer
from .integration.allocation import drawn, evenly_spread, sample_counts
from .integration.build import NodeEvaluator, grow, root_edge
from .integration.integrand import values_at
from .integration.mapping import Map, even_parts
from .integration.point_sets import staged_points
from .integration.regions import BIN, Regions, RegionTree, neighbourly
from .integration.rules import bin_means, face_weights, lagrange, weighted
from .learned import Learned
from .parts import SHADOW_RAYS, OverScreen, cell_of
from .settings import Settings
from .transport.around_light import Wedge
from .transport.camera_hits import Pixels
from .transport.silhouettes import of_bodies

CHANNELS = 3

SHARE, SHARE_OF_RAYS = 1 / 3, 1 / 2
"""Of the budget: how much less nodes leave to samples at most, and how much they spend, which leave nothing
to chance along their rays; of few samples up to twice that."""

FEWEST = 4096
"""Nodes and samples of a picture, however small."""

PILOT_ONE_IN = 48
"""One pixel in so many is sampled first, and tells its block how right the nodes' prediction is."""

ROWS = 64
"""Of the picture at once; whole blocks."""

PIXELS_AT_ONCE = 1 << 16
"""Whose polynomials are integrated, about."""

DEFENSIVE = 0.1
"""Of the residual samples, spread evenly."""

CHANCE = 1 / 32
"""The least with which a pixel is sampled at all."""

DEAR = 6.0
"""Of `Settings.samples`, a sample of the residual that is worth so much is none to be spread about."""

MOST_DEAR = 8
"""What chances are divided by at most."""

OUTLINE_OF_SHADOW = 0.06
"""Deviation of a sample, of the radiance, within `NEAR` pixels of regions that a shadow's outline crosses.
First samples do not tell: of what is rare there, which makes dark specks, they see nothing.
"""

OUTLINE_WEIGHT = 2.0
"""Of their deviation, from four samples on: across an edge the error of a net falls faster than by the root
of its points, of one or two it does not."""

NEAR = 2
"""Pixels from an outline, where more of it may be that was not found."""

WORTH, WORTH_OF_F = 10.0, 6.0
"""How many times the samples that nodes leave the budget for may be taken of a picture of one, where specks
are what is seen; over the root of `Settings.samples` of more, down to once. And where all are of f itself,
which no chance makes specks of, over those samples."""

LEAST_SHARE = 1 / 6
"""Of that, for samples that every pixel of no polynomial has."""

SPECK = 0.2
"""Of the picture's mean radiance, how bright samples that are taken by chance may be, in a picture of one."""

LEAST_OF_BUDGET = 1 / 10
"""How much of what it may spend a picture does, though surfaces deviate more."""

AS_SURFACES = 4.0
"""Samples that are taken, of as many as would do as much for the noise as surfaces' do: those take ten times
as long, with their polynomials."""

CALM = 0.5
"""Of the samples that are taken in any case, how many low specks may ask for and no more nodes be wanted."""

DARK = 1 / 16
"""Of that mean, the radiance below which no more is asked for."""

STEP = 0.05
"""Between nodes of a region with an outline in it, of the nodes' mean: no polynomial goes up one."""

NOTHING = 0.1
"""Of what others' nodes see at a region's edge, the most that its own see if they are to have missed it."""

AT_OUTLINES = 8
"""Samples that pixels which an outline crosses have at most before it is known how much they deviate, a power
of two; 2 at least."""

AT_BESIDE = 2
"""Samples at least, and an even number, of pixels in such regions that the outline itself does not cross."""

PIECES = 4
"""Into which a batch is parted, as a sample is many evaluations, and all workers should have some."""

MOST = 1 << 12
"""Samples of a pixel at most."""

MOST_REGIONS = 1_000_000

HOPELESS, EVERYWHERE = ((1 / 12, 0.1), (1 / 4, 0.1)), 0.3
"""As `build.HOPELESS`, of polynomials whose samples are whole rays: a ray of few points is several times as
cheap, and does more for the noise where many thin things shade the fog. Leaves show .13 to .33 in .6 of the
picture, a lantern of bars and hoops .11 to .33 in .36 to .46; what gains, less than .3 in .25, or less than
.05.
"""

BESIDE_NET, MANY = (HOPELESS[0], (HOPELESS[1][0], 0.01)), 4
"""The same where a net of points takes over, from so many samples on: it has half of the error in the same
time where shadows are everywhere (leaves, a fan behind bars). That of few is seen as a pattern. At first
forty cones are everywhere, too (.38), and then are not (.19).
"""

BEYOND_HOPE = 0.5
"""Part of its variance that a region's polynomial may leave over: where it is more, f itself is sampled."""


class ScreenPicture:
    """One layer of a picture: built, shown whole, and refined where its error is.

    built : whether polynomials were of use. regions, nodes : how many there are. seconds : by stage.
    told : what was done, for people. noise : error of a pixel's channel to be expected, on average, once it
    is known what samples are due.
    """

    noise = 0.0

    def __init__(
        self,
        by: OverScreen,
        settings: Settings,
        region: tuple[int, int, int, int],
        layer: Layer,
        check: Callable[[], None],
    ) -> None:
        """region : x0, y0, x1, y1 in the whole frame. check : called before every batch; may raise."""
        self._whole, self._rule, self._alone = by.whole, by.rule, by.alone
        self._outlines, self._elsewhere = by.outlines, by.elsewhere
        self._wedges, self._bodies = by.wedges, by.bodies
        by_net = by.followed and settings.integrator != "cv_only"
        self._hopeless = BESIDE_NET if by_net and settings.samples >= MANY else HOPELESS
        self._alone_cost = max(1.0, by.alone_rays / SHADOW_RAYS)
        self._settings, self._layer, self._check = settings, layer, check
        # The layer's own, as long as no sample is added to what the polynomials are.
        self._mean, self._count = layer.radiance[..., :CHANNELS], layer.sample_count
        self._residual = layer.residual if settings.terms else np.zeros(layer.residual.shape, np.float32)
        self._cost = max(1.0, by.rays / SHADOW_RAYS)
        self._frame, self._corner = region, region[:2]
        self._bins = (region[2] - region[0], region[3] - region[1])
        self.regions, self.nodes, self.built = 0, 0, False
        self.told = "given up: sampled"
        self.seconds: dict[str, float] = {}
        self._tree: RegionTree | None = None

    def build(self, map_: Map, enough: Callable[[], bool]) -> None:
        """Build the polynomials and their means; all plain where they do not help.

        map_ : runs a function over items on the workers. enough : whether to make do with what there is.
        """
        settings, bins = self._settings, self._bins
        alone = settings.integrator == "cv_only"
        # A small picture has as many things in it as a large one.
        self._left = self._total = total = max(
            float(settings.samples) * bins[0] * bins[1], FEWEST * self._cost
        )
        began = perf_counter()
        evaluator = NodeEvaluator(
            self._whole, bins, self._pixels, 2, self._rule, settings.seed, map_, CHANNELS
        )
        budget = total * SHADOW_RAYS * (1.0 if alone else SHARE_OF_RAYS * (1 + 1 / settings.samples))
        log_edge = root_edge(bins, 2, budget / evaluator.cost)
        # Alone, polynomials must serve all pixels. They cover outlines too, or there would be more edges of
        # regions than regions; but what is sampled there is f.
        self._outline = np.zeros(bins[::-1], bool) if alone else self._outlines(self._frame, map_).T
        met = None if alone else self._bodies(self._frame, map_)
        if self._elsewhere is not None:
            self._outline |= self._elsewhere.T
        if log_edge is not None and not self._outline.all():
            tree = RegionTree(bins, 2, log_edge, evaluator, False)

            def done() -> bool:
                return enough() or (not alone and _calm(tree, settings.samples))

            helps = grow(tree, evaluator, budget, total, MOST_REGIONS, done, self._hopeless, EVERYWHERE)
            self.regions, self.nodes = len(tree), tree.store.count
            self._left -= min(evaluator.evaluations / SHADOW_RAYS, SHARE * total)
            if helps or alone:
                self._tree, self.told = tree, "built"
        self.built = self._tree is not None
        grown = perf_counter()
        self._integrate(map_, met)
        map_(self._keep_variate, self._rows())
        self.seconds = {"nodes": grown - began, "means": perf_counter() - grown}

    def _pixels(self, index: np.ndarray) -> Pixels:
        x, y = index[0] + self._corner[0], index[1] + self._corner[1]
        return Pixels(x.astype(np.int32), y.astype(np.int32), cell_of(x, y, self._frame))

    def _integrate(self, map_: Map, met: np.ndarray | None) -> None:
        """H of all pixels, which region each lies in (-1: none), and the predicted deviation of f - h.

        met : of `silhouettes`.
        """
        width, height = self._bins
        self._region = np.full((height, width), -1, np.int32)
        self._deviation = self._inside = np.zeros(0, np.float32)
        self._crossed = np.zeros(0, bool)
        self._beside = np.zeros((height, width), bool)
        if self._tree is None:
            return
        tree = self._tree
        leaves, values = tree.leaves(), tree.store.values
        weights = face_weights(2)
        density = neighbourly(leaves.density, leaves, tree.store.count, map_)
        coefficients = np.stack([v.take(leaves.nodes) for v in values], axis=-1)  # (R, 9, C)
        self._coefficients = coefficients.astype(np.float32)
        first = np.einsum("rnc,n->rc", coefficients, weights)
        inside, self._crossed = np.zeros(len(leaves)), np.zeros(len(leaves), bool)
        if tree.store.spread is not None:
            spread, *edges = np.atleast_2d(tree.store.spread)
            noise = weighted(spread.take(leaves.nodes), weights)
            inside = neighbourly(noise, leaves, tree.store.count, map_)
            for of_nodes in (e.take(leaves.nodes) for e in edges):
                # Where some see a shadow's edge and others do not, there is its outline, steep as a root.
                self._crossed |= of_nodes.min(axis=1) < of_nodes.max(axis=1)
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
        each = {}
        pieces = []
        for kind in np.unique(code):
            edge = tuple(1 << int(n) for n in divmod(int(kind), 64))
            # Means over pixels, of the nodes' polynomials.
            weights = np.einsum("xi,yj->yxij", *(bin_means(n) for n in edge)).reshape(-1, 9)
            each[edge] = weights.astype(np.float32)
            chosen, most = np.flatnonzero(code == kind), max(1, PIXELS_AT_ONCE // len(weights))
            pieces += [(edge, chosen[part]) for part in even_parts(len(chosen), most)]

        def means(piece: tuple[tuple[int, int], np.ndarray]) -> None:
            edge, chosen = piece
            x, y = (self._start[d].take(chosen) for d in range(2))
            within = np.arange(edge[1])[:, None] * width + np.arange(edge[0])
            at = within.reshape(-1, 1) + (y * width + x)
            grid = self._coefficients.take(chosen, axis=0).transpose(1, 0, 2).reshape(9, -1)
            # Not by ``@``, as `rules.weighted`.
            mean = np.einsum("pn,nr->pr", each[edge], grid)
            np.clip(mean, -LARGEST, LARGEST, out=mean)
            self._mean.reshape(-1, CHANNELS)[at] = mean.reshape(*at.shape, CHANNELS)
            self._region.reshape(-1)[at] = chosen

        map_(means, pieces)
        # One more for pixels of none.
        is_plain, has_outline = np.zeros((2, len(leaves) + 1), bool)
        is_plain[plain] = True
        has_outline[self._region[self._outline]] = True
        step = np.ptp(coefficients, axis=1).sum(axis=1)
        has_outline[:-1] &= step > STEP * CHANNELS * np.abs(coefficients).mean()
        has_outline[:-1] |= _hidden(leaves, self._wedges, self._corner)
        bright = np.abs(coefficients.sum(axis=2))
        has_outline[:-1] |= _contradicted(leaves, bright, self._region, STEP * bright.mean())
        if met is not None:
            crossed = np.unique(self._region.T[of_bodies(met)])
            has_outline[crossed] |= _overlooked(leaves[crossed], met)
        has_outline[-1] = False

        def classify(rows: slice) -> None:
            region, outline = self._region[rows], self._outline[rows]
            beside = has_outline.take(region, mode="wrap")
            outline |= is_plain.take(region, mode="wrap")
            self._beside[rows] = beside & ~outline
            outline |= beside

        map_(classify, self._rows())
        self._tree = None

    def allocate(
        self, map_: Map, around: np.ndarray, bright: float, of_surfaces: float | None = None
    ) -> None:
        """Sample a few pixels, which stay, and decide by them and the nodes how often all are sampled.

        around : (H, W) radiance of all layers as far as is known, channels summed. bright : its mean.
        of_surfaces : `ControlVariatePicture.deviation_a_sample`, None where there is none.
        """
        began = perf_counter()
        settings, (width, height) = self._settings, self._bins
        served = (self._region >= 0) & ~self._outline
        self._approximate = served
        alone = plain = np.flatnonzero(~served)
        if self._elsewhere is not None:
            elsewhere = self._elsewhere.T.reshape(-1)[plain]
            self._mean.reshape(-1, CHANNELS)[plain[elsewhere]] = 0
            alone = plain[~elsewhere]
        beside = self._beside.reshape(-1)[alone]
        self._points, self._alone_points = (
            staged_points("sobol", 2, f.rest_dimensions, 1, settings.seed + 1)
            for f in (self._whole, self._alone)
        )
        crossed = alone[~beside]
        of_one = max(float(width * height), FEWEST * self._cost)
        worth = WORTH * (of_one / self._total) ** 0.5 if self.built else WORTH_OF_F * of_one / self._total
        afforded = self._left * max(1.0, worth)
        due = LEAST_SHARE * afforded / (self._alone_cost * max(len(crossed), 1))
        at_outlines = 1 << int(np.log2(np.clip(due, 2, AT_OUTLINES if around.any() else 2)))
        self._prepare(at_outlines)
        # Dear samples are fewer.
        dear = float(np.clip(self._cost / DEAR, 1, MOST_DEAR))
        pilot = np.flatnonzero(evenly_spread((height, width), PILOT_ONE_IN * dear, settings.seed) & served)
        kinds = [(1, pilot), (at_outlines, crossed), (AT_BESIDE, alone[beside])]

        def few(chunk: tuple[int, np.ndarray]) -> np.ndarray:
            """(B,) squares, as float32 would not hold of what is brightest."""
            n, part = chunk
            y, x = np.divmod(part, width)
            residual = self._residuals(x, y, n)
            self._residual[y, x] = _finite(residual.mean(axis=1))
            self._count[y, x] = n
            if not self._is_served(y, x):
                # H stays on show until samples are there.
                self._mean[y, x] = 0
            # Of f itself, how much its samples differ tells what h would of f - h.
            if n > 1:
                residual = (residual[:, ::2] - residual[:, 1::2]) / np.sqrt(2)
            return np.square(np.abs(residual).sum(axis=2)).mean(axis=1)

        chunks = [(n, part) for n, which in kinds for part in self._chunks(which, n)]
        squares = np.concatenate([np.zeros(0), *map_(few, chunks)])
        squares = np.split(squares, np.cumsum([len(which) for _, which in kinds[:-1]]))
        deviation = self._expect([which for _, which in kinds], squares, PILOT_ONE_IN * dear, map_)
        wanted = deviation.copy()
        # Where a sample is cheaper, or brings more, more of them are worth it.
        weight = min(settings.samples**0.5, OUTLINE_WEIGHT) * np.sqrt(self._cost / self._alone_cost)
        budget = afforded
        of_alone = float(deviation.reshape(-1)[alone].sum(dtype=np.float64))
        of_served = float(deviation.sum(dtype=np.float64)) - of_alone
        if of_served + of_alone < np.finfo(np.float32).tiny:
            # Black, as far as is seen: what is spread evenly in any case is all.
            wanted[:], budget = 1, DEFENSIVE * self._left
            of_served, of_alone = float(wanted.size - alone.size), float(alone.size)
        mean_cost = (of_served * self._cost + weight * of_alone * self._alone_cost) / max(
            of_served + weight * of_alone, 1e-300
        )
        budget /= max(mean_cost, 1.0)
        if of_surfaces:
            # Variance falls as the square of that: beyond this a sample on surfaces is worth more.
            as_there = AS_SURFACES * (of_served + of_alone) / (of_surfaces * max(mean_cost, 1.0) ** 0.5)
            budget = min(budget, max(as_there, LEAST_OF_BUDGET * budget))
        lit = DARK * bright > np.finfo(np.float32).tiny

        def weigh(rows: slice) -> float:
            # In proportion to the deviation, specks of what is left to chance are of one height: that it is
            # low is all that is asked for. In the dark lower ones are seen.
            dim = bright / np.clip(around[rows], DARK * bright, bright) if lit else np.float32(1)
            factor = np.where(served[rows], np.sqrt(dim, dtype=np.float32), np.float32(weight))
            wanted[rows] *= factor
            return float(wanted[rows].sum(dtype=np.float64))

        in_all = sum(map_(weigh, self._rows()))
        budget = max(1.0, min(budget, in_all * settings.samples / max(SPECK * bright, 1e-300)))
        due, chance = sample_counts(wanted.ravel(), budget, DEFENSIVE, CHANCE / dear, map_)
        due, chance = due.reshape(height, width), chance.reshape(height, width)

        def draw(rows: slice) -> None:
            # What may have been missed is left to chance no more than what is known.
            wider = slice(max(0, rows.start - NEAR), rows.stop + NEAR)
            seen = np.where(served[wider], _summed(self._mean[wider]), _summed(self._residual[wider]))
            missed = _missed(~served[wider], seen)[rows.start - wider.start :][: rows.stop - rows.start]
            missed *= np.float32(budget / max(in_all, 1e-300))
            np.fmin(missed, 1, out=missed)
            here, have = chance[rows], self._count[rows]
            np.maximum(here, missed, out=here)
            here[(have > 0) | ~served[rows]] = 1
            taken = drawn(here.ravel(), settings.seed + 7, rows.start).reshape(here.shape)
            due[rows] = np.maximum(np.minimum(due[rows], MOST) * taken, have)
            if self._elsewhere is not None:
                due[rows][self._elsewhere.T[rows] & ~served[rows]] = 0

        def expect(rows: slice) -> float:
            points = np.maximum(due[rows], 1).astype(np.float32) * chance[rows]
            return float((deviation[rows] / np.sqrt(points)).sum(dtype=np.float64))

        map_(draw, self._rows())
        self._chance, self._due, self._deviation_learned = chance, due, deviation
        self.noise = sum(map_(expect, self._rows())) / (CHANNELS * deviation.size)
        self._prepare(int(due.max()))
        more = np.flatnonzero(due > self._count)
        amount, approximate = due.reshape(-1)[more], served.reshape(-1)[more]
        # Whole rays first: what is dearest must not come last, when other workers have nothing left to do.
        self._work = [
            (n, part)
            for which in (approximate, ~approximate)
            for n in np.unique(amount)[::-1]
            for part in self._chunks(more[(amount == n) & which], int(n))
        ]
        self.seconds["allocation"] = perf_counter() - began

    def _expect(
        self, kinds: list[np.ndarray], squares: list[np.ndarray], one_in: float, map_: Map
    ) -> np.ndarray:
        """(H, W) deviation of a sample, by ``squares`` of the first ones, of pixels of these kinds: see
        `allocate`. The first have an h, and are one in so many of these.
        """
        # Of each region, and of none.
        of_region, inside, crossed = (
            np.append(a, np.zeros(1, a.dtype)) for a in (self._deviation, self._inside, self._crossed)
        )
        region, pilot = self._region, kinds[0]
        said, deviation = np.empty((2, *region.shape), np.float32)

        def look_up(rows: slice) -> float:
            of_region.take(region[rows], mode="wrap", out=said[rows])
            return float(_summed(self._mean[rows]).sum(dtype=np.float64))

        bright = sum(map_(look_up, self._rows())) / region.size
        learned = Learned.of(squares[0], pilot, said, bright, one_in)

        def expect(rows: slice) -> None:
            # What a node says of its own noise is known: few samples would miss what is rare in it.
            own = np.square(inside.take(region[rows], mode="wrap"), dtype=np.float64)
            if crossed.any():
                wider = slice(max(0, rows.start - NEAR), rows.stop + NEAR)
                of_shadow = _within(crossed.take(region[wider], mode="wrap"), NEAR)
                lit = np.maximum(_summed(self._mean[rows]), 0)
                lit *= of_shadow[rows.start - wider.start :][: len(lit)]
                own += np.square(OUTLINE_OF_SHADOW * lit, dtype=np.float64)
            deviation[rows] = learned.deviation(said[rows], rows, own)
            deviation[rows] *= self._approximate[rows]

        map_(expect, self._rows())
        deviation.reshape(-1)[pilot] = learned.of_samples(inside.take(region.reshape(-1)[pilot], mode="wrap"))
        said[:] = 1
        for which, square in zip(kinds[1:], squares[1:], strict=True):
            if which.size:
                deviation.reshape(-1)[which] = Learned.of(square, which, said, 0.0).of_samples()
        return deviation

    def _chunks(self, rows: np.ndarray, n: int) -> list[np.ndarray]:
        most = max(1, self._settings.batch_size // (n * PIECES))
        return [rows[part] for part in even_parts(len(rows), most)]

    def __len__(self) -> int:
        """How many pieces of work there are."""
        return len(self._work)

    def work(self, number: int) -> int:
        """Samples that a piece takes."""
        n, part = self._work[number]
        return int(n) * len(part)

    def refine(self, number: int, done: Callable[[int], None]) -> None:
        """Sample the residual of a piece."""
        n, part = self._work[number]
        y, x = np.divmod(part, self._bins[0])
        mean = self._residuals(x, y, int(n)).mean(axis=1)
        self._residual[y, x] = _finite(mean / self._chance[y, x][:, None])
        self._count[y, x] = n
        done(int(n) * len(part))

    def _residuals(self, x: np.ndarray, y: np.ndarray, n: int) -> np.ndarray:
        """(B, n, C) samples of f - h in pixels (B,), or of f where h serves none of them."""
        self._check()
        pixels = self._pixels(np.stack([x, y]))
        keys = pixels.key()
        served = self._is_served(y, x)
        integrand, (first, rest) = (
            (self._whole, self._points) if served else (self._alone, self._alone_points)
        )
        screen, u = first.points(keys, 0, n), rest.points(keys, 0, n)
        stage = integrand.first(pixels, screen)
        f = values_at(integrand, stage, len(x) * n, None, u.reshape(len(u), len(x) * n))[:CHANNELS]
        f = f.reshape(CHANNELS, len(x), n).astype(np.float64).transpose(1, 2, 0)
        return f - self._variate(x, y, screen) if served else f

    def _is_served(self, y: np.ndarray, x: np.ndarray) -> bool:
        """Whether pixels (B,), all of them or none, have an h."""
        return len(x) > 0 and bool(self._approximate[y[0], x[0]])

    def _prepare(self, count: int) -> None:
        for group in (*self._points, *self._alone_points):
            group.prepare(count)

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

    def show(self, map_: Map) -> None:
        """Add the residual to the polynomials of all pixels, once."""

        def rows(some: slice) -> None:
            # Where f itself was sampled there is none any more.
            self._keep_variate(some)
            # The picture may have one channel more, and rows of three are slow.
            for c in range(CHANNELS):
                radiance = self._mean[some][..., c]
                radiance += self._residual[some][..., c]
                np.clip(radiance, -LARGEST, LARGEST, out=radiance)

        map_(rows, self._rows())

    def _keep_variate(self, rows: slice) -> None:
        if self._settings.terms:
            self._layer.control_variate[rows] = self._mean[rows]

    def _rows(self) -> list[slice]:
        """Of the picture, whole blocks at once."""
        height = self._bins[1]
        return [slice(low, min(low + ROWS, height)) for low in range(0, height, ROWS)]

    def finish(self) -> None:
        """What samples tell beside the radiance: their counts, and the error."""
        if self._settings.standard_error:
            # A mean of n points of a net, that is taken by chance.
            error = self._deviation_learned / np.sqrt(np.maximum(self._due, 1) * self._chance)
            self._layer.standard_error[:] = (error / CHANNELS)[..., None]


def _calm(tree: RegionTree, samples: int) -> bool:
    """Whether samples that all pixels have a chance of, and pilots, are as many as low specks ask for."""
    regions, middle = tree.leaves(), 3**2 // 2
    bright = sum(float(regions.volume @ v.take(regions.nodes[:, middle])) for v in tree.store.values)
    wanted = float(regions.volume @ regions.density) * samples
    return wanted <= CALM * SPECK * bright * (CHANCE + 1 / PILOT_ONE_IN)


def _hidden(regions: Regions, wedges: Sequence[Wedge], corner: tuple[int, int]) -> np.ndarray:
    """(R,) bool, regions that a wedge runs through between their nodes. corner : of the picture."""
    hidden = np.zeros(len(regions), bool)
    edge = np.ldexp(np.array([0, 0.5, 1]), regions.size[..., None].astype(np.int64) - BIN)
    places = np.ldexp(regions.start.astype(np.float64), -BIN)[..., None] + edge  # (2, R, 3)
    for wedge in wedges:
        x, y = places + (corner - wedge.centre)[:, None, None]
        first, second = (dx * y[:, None] - dy * x[:, :, None] for dx, dy in wedge.edges)
        seen = (first >= 0) & (second <= 0)
        aside = [((side * first > 0) & (side * second > 0)).any(axis=(1, 2)) for side in (1, -1)]
        hidden |= aside[0] & aside[1] & ~seen.any(axis=(1, 2))
    return hidden


def _contradicted(regions: Regions, bright: np.ndarray, region: np.ndarray, least: float) -> np.ndarray:
    """(R,) bool, regions whose nodes see nothing of what nodes of their neighbours see at their edges.

    bright : (R, 9) radiance that nodes see, channels summed. region : (H, W) which of them pixels are of, -1
    for none. least : radiance that is worth a look.
    """
    contradicted = np.zeros(len(regions), bool)
    own, node = np.nonzero(bright > least)
    if own.size == 0:
        return contradicted
    value, brightest = bright[own, node], bright.max(axis=1)
    height, width = region.shape
    x, y = (
        (regions.start[d].take(own) + (place << regions.size[d].take(own).astype(np.int64)) / 2) / (1 << BIN)
        for d, place in enumerate(np.divmod(node, 3))
    )
    # Pixels to either side of a node.
    for column, row in product(
        *((np.floor(a).astype(np.intp), np.ceil(a).astype(np.intp) - 1) for a in (x, y))
    ):
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        there = np.flatnonzero(inside)
        of = region[row.take(there), column.take(there)]
        seen = (of >= 0) & (brightest.take(of, mode="wrap") < NOTHING * value.take(there))
        contradicted[of[seen]] = True
    return contradicted


def _overlooked(regions: Regions, met: np.ndarray) -> np.ndarray:
    """(R,) bool, regions in which a body of fog is seen that none of their nodes sees.

    met : (W + 1, H + 1) uint64, what is seen at pixels' corners. Nodes lie there, but within a pixel.
    """
    overlooked = np.zeros(len(regions), bool)
    start, log = regions.start >> BIN, regions.size.astype(np.int64) - BIN
    code = log[0] * 64 + log[1]
    for kind in np.unique(code):
        chosen, edge = np.flatnonzero(code == kind), tuple(1 << int(n) for n in divmod(int(kind), 64))
        x, y = (start[d].take(chosen)[:, None] + np.arange(edge[d] + 1) for d in range(2))
        seen = met[x[:, :, None], y[:, None, :]]
        by_nodes = seen[:, :: max(1, edge[0] // 2), :: max(1, edge[1] // 2)]
        every, known = (np.bitwise_or.reduce(a, axis=(1, 2)) for a in (seen, by_nodes))
        overlooked[chosen] = every != known
    return overlooked


def _finite(radiance: np.ndarray) -> np.ndarray:
    return np.clip(radiance, -LARGEST, LARGEST)


def _summed(a: np.ndarray) -> np.ndarray:
    """(H, W) sums over the channels of a (H, W, 3)."""
    return a[..., 0] + a[..., 1] + a[..., 2]


def _missed(outlines: np.ndarray, bright: np.ndarray) -> np.ndarray:
    """(H, W) how far f may be off h beside outlines (H, W), where a bit of them was not found.

    Part of the most that is seen around, half as much with each pixel. bright : (H, W) radiance.
    """
    reach = NEAR - 1
    for axis in range(2):
        padded = np.pad(bright, [(reach, reach) if i == axis else (0, 0) for i in range(2)])
        windows = [padded.take(np.arange(k, k + bright.shape[axis]), axis=axis) for k in range(2 * reach + 1)]
        bright = np.maximum.reduce(windows)
    part = np.zeros(outlines.shape, np.float32)
    for distance in range(NEAR, 0, -1):
        part[_within(outlines, distance)] = 0.5**distance
    return part * bright


def _within(a: np.ndarray, distance: int) -> np.ndarray:
    """(H, W) whether there is a pixel of ``a`` (H, W) bool so near in rows and columns."""
    for _ in range(2):
        # To both sides of each column, then row, by steps that double.
        reach, wider = 0, a.copy("K")
        while reach < distance:
            step = min(reach + 1, distance - reach)
            before = wider.copy("K")
            wider[step:] |= before[:-step]
            wider[:-step] |= before[step:]
            reach += step
        a = wider.T
    return a
