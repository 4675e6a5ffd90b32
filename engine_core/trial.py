# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether samples of f - h are better than samples of f, tried in a few pixels.

Thin occluders, or a bright bit of sky that few see, are smaller than regions can be: h then follows chance,
and f alone has less variance within a pixel, however much it has over the picture. Nodes cannot tell, which
never lie twice in one pixel. What is sampled here is thrown away, so the estimate stays unbiased.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from .integration.allocation import evenly_spread
from .integration.build import unexplained
from .integration.control_variate import ControlVariate
from .integration.integrand import StagedIntegrand
from .integration.mapping import Map
from .integration.point_sets import staged_points
from .integration.regions import RegionTree
from .integration.residual import ResidualSampler
from .integration.sample_mean import sum_samples
from .integration.standard_error import SECOND
from .settings import Settings

TRIED_AT = 0.25
"""The part of the nodes' budget after which it is tried."""

DOUBTFUL, DOUBTFUL_OF_ONE = 0.01, 0.03
"""Part of f's variance that h leaves over, as the nodes see it, up to which it is not: of 640 x 360 pixels
soft shadows and smooth lights leave .0003 to .005 then, sun through blinds .02 to .03, thin occluders .06 to
.3; few nodes, in smaller pictures, leave more. And in a picture of one sample a pixel, where all do."""

OF_ALL, PIXELS, FEWEST = 1 / 64, 2048, 32
"""Of all samples, for a round of the trial, at most; pixels, at most, and so many that fewer tell nothing."""

TILES, LOG_BINS = 12, 12
"""Of the picture, in which these pixels lie, at most: to make one ready takes more than to sample it. And
log2 of a tile's pixels, if regions are no larger."""

PARTS = 4
"""Into which they are split for workers."""

KINDS, NETS = 2, 2
"""Of samples in each pixel, and nets of each kind."""

LONGEST = 8
"""Points of a net: nets of f - h and of f may get better at different speeds."""

BETTER, BETTER_OF_ONE = 1.1, 1.5
"""Times the deviation of f - h that f may have; and in a picture of one sample a pixel, which has up to twice
as many for the same time if h is given up. There soft lamps, which want h, show 1.5 and more."""

SURE = (-1.5, 2.5), (-1.0, 1.5), (0.5, 0.5)
"""Of each round of the trial: by how many standard errors f must be below that, no more than the first for
h to be kept, more than the second for it to be given up, in the mean or in that of squares; between them
comes the next round, of more pixels. In a few either may seem better by chance."""


class Trial:
    """Two nets of f - h, and two of f, in each of a few pixels.

    doubtful : whether it was asked for. beaten : whether f itself is better. spent : samples.
    """

    def __init__(
        self,
        integrand: StagedIntegrand,
        pixels: Callable[[np.ndarray], Any],
        settings: Settings,
        variate: Callable[[int], ControlVariate],
        tree: RegionTree,
        budget: float,
        map_: Map,
    ) -> None:
        """pixels : of index (2, N). variate : makes one of the ``tree`` as it is, of tiles of so
        many pixels by their log2. budget : of nodes.

        map_ : runs a function over items on the workers.
        """
        self._integrand, self._pixels, self._settings = integrand, pixels, settings
        self._variate, self._tree, self._budget, self._map = variate, tree, budget, map_
        one = settings.samples == 1
        self._up_to, self._better = (DOUBTFUL_OF_ONE, BETTER_OF_ONE) if one else (DOUBTFUL, BETTER)
        self._count = 1 << int(np.log2(np.clip(settings.samples / 2, 1, LONGEST)))
        total = float(settings.samples) * float(np.prod(tree.bins))
        self._wanted = min(OF_ALL * total / (KINDS * NETS * self._count), PIXELS)
        self._tried = self._wanted < FEWEST
        self.doubtful = self.beaten = False
        self.spent = 0

    def lost(self, evaluations: int) -> bool:
        """Whether no more nodes are worth it; to be asked before every batch. evaluations : so far."""
        if not self._tried and evaluations >= TRIED_AT * self._budget:
            self._tried = True
            self.doubtful = unexplained(self._tree)[0] > self._up_to
            if self.doubtful:
                self.beaten = self._is_beaten()
        return self.beaten

    def _is_beaten(self) -> bool:
        # A control variate directs samples by errors shared with neighbours, regions grow by their own.
        own = self._tree.leaves().density.copy()
        variate = self._variate(LOG_BINS)
        # In the mean, as samples go where the deviation is; and of squares, as rare specks are what is seen.
        gain, beaten = np.zeros((2, 0)), False
        for number, (low, high) in enumerate(SURE):
            of_h, of_f = self._deviations(variate, number)
            of_h = self._better * of_h
            gain = np.concatenate([gain, [of_h - of_f, of_h**2 - of_f**2]], axis=1)
            total, noise = gain.sum(axis=1), np.sqrt(gain.shape[1]) * gain.std(axis=1) if gain.size else 0.0
            beaten = (total > high * noise).any()
            if beaten or (total <= low * noise).all():
                break
        self._tree.leaves().density[:] = own
        return bool(beaten)

    def _deviations(self, variate: ControlVariate, number: int) -> tuple[np.ndarray, np.ndarray]:
        """(P,) of nets of f - h, and of f, in each of a round's pixels."""
        seed, bins = self._settings.seed + 9 + 101 * number, self._tree.bins
        count = self._count
        points = staged_points("sobol", 2, self._integrand.rest_dimensions, 1, seed)
        for group in points:
            group.prepare(count)
        tiles = np.flatnonzero(evenly_spread((len(variate),), max(len(variate) / TILES, 1), seed))
        share = len(tiles) / len(variate)
        tried = evenly_spread(bins, max(np.prod(bins) * share / self._wanted, 1), seed)

        def of_h(number: int) -> tuple[np.ndarray, np.ndarray]:
            tile = variate.tile(number)
            x, y = tile.index
            which = tried[x, y]
            index = tile.index[:, which]
            if not which.any():
                return index, np.zeros(0)
            pixels = self._pixels(tile.index)
            _, spread = ResidualSampler(points, self._tree.dimensions).sample(
                self._integrand,
                pixels,
                pixels.key(),
                tile,
                tile.density(variate.spread),
                tile.error(variate.spread),
                np.where(which, count, 0),
                np.ones(len(which)),
                which,
            )
            return index, np.abs(spread.twice[:, which]).sum(axis=0)

        def of_f(index: np.ndarray) -> np.ndarray:
            if not index.size:
                return np.zeros(0)
            pixels = self._pixels(np.tile(index, NETS))
            keys = pixels.key()
            keys[index.shape[1] :] ^= SECOND
            sums = sum_samples(self._integrand, pixels, keys, points, 0, count).values[
                : len(self._tree.store.values)
            ]
            one, other = np.split(sums / count, NETS, axis=1)
            return np.abs(one - other).sum(axis=0) / np.sqrt(2)

        found = self._map(of_h, [int(n) for n in tiles])
        index = np.concatenate([places for places, _ in found], axis=1)
        self.spent += KINDS * NETS * count * index.shape[1]
        plain = self._map(of_f, np.array_split(index, PARTS, axis=1))
        return np.concatenate([deviation for _, deviation in found]), np.concatenate(plain)
