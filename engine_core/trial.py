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
from .integration.control_variate import ControlVariate
from .integration.integrand import StagedIntegrand
from .integration.mapping import Map
from .integration.point_sets import staged_points
from .integration.regions import RegionTree
from .integration.residual import ResidualSampler
from .settings import Settings

TRIED_AT = 0.25
"""The part of the nodes' budget after which it is tried."""

OF_ALL, PIXELS = 1 / 64, 2048
"""Of all samples, for the trial, at most; and pixels, at most."""

TILES = 8
"""Of the picture, in which these pixels lie, at most: to make one ready takes more than to sample it."""

LONGEST = 8
"""Points of a net: nets of f - h and of f may get better at different speeds."""

BETTER, SURE = 0.9, 1.0
"""Part of the deviation of f - h that f may have, and by how many standard errors it must be below that: in a
few pixels either may seem better by chance."""


class Trial:
    """Two nets of f - h, and two of f, in each of a few pixels.

    beaten : whether f itself is better. spent : samples.
    """

    def __init__(
        self,
        integrand: StagedIntegrand,
        pixels: Callable[[np.ndarray], Any],
        settings: Settings,
        variate: Callable[[], ControlVariate],
        tree: RegionTree,
        budget: float,
        map_: Map,
    ) -> None:
        """pixels : of index (2, N). variate : makes one of the ``tree`` as it is. budget : of nodes.

        map_ : runs a function over items on the workers.
        """
        self._integrand, self._pixels, self._settings = integrand, pixels, settings
        self._variate, self._tree, self._budget, self._map = variate, tree, budget, map_
        self._total = float(settings.samples) * float(np.prod(tree.bins))
        self._tried = self.beaten = False
        self.spent = 0

    def lost(self, evaluations: int) -> bool:
        """Whether no more nodes are worth it; to be asked before every batch. evaluations : so far."""
        if not self._tried and evaluations >= TRIED_AT * self._budget:
            self._tried = True
            of_h, of_f = self._deviations()
            gain = BETTER * of_h - of_f
            self.beaten = gain.sum() > SURE * np.sqrt(len(gain)) * gain.std()
        return self.beaten

    def _deviations(self) -> np.ndarray:
        """(2, P) of nets of f - h, and of f, in each of the pixels."""
        seed, bins = self._settings.seed + 9, self._tree.bins
        kinds, nets = (False, True), 2
        count = 1 << int(np.log2(np.clip(self._settings.samples / 2, 1, LONGEST)))
        each = len(kinds) * nets * count
        wanted = min(OF_ALL * self._total / each, PIXELS)
        points = staged_points("sobol", 2, self._integrand.rest_dimensions, 1, seed)
        for group in points:
            group.prepare(count)
        # A control variate directs samples by errors shared with neighbours, regions grow by their own.
        own = self._tree.leaves().density.copy()
        variate = self._variate()
        numbers = np.flatnonzero(evenly_spread((len(variate),), max(len(variate) / TILES, 1), seed))
        share = len(numbers) / len(variate)
        tried = evenly_spread(bins, max(np.prod(bins) * share / wanted, 1), seed)

        def sample(number: int) -> np.ndarray:
            tile = variate.tile(number)
            x, y = tile.index
            which = tried[x, y]
            found = np.zeros((len(kinds), np.count_nonzero(which)))
            if not which.any():
                return found
            pixels, total = self._pixels(tile.index), len(which)
            _, error, _ = tile.means(variate.spread)
            for kind, plain in enumerate(kinds):
                _, spread = ResidualSampler(points, self._tree.dimensions).sample(
                    self._integrand,
                    pixels,
                    pixels.key(),
                    tile,
                    tile.density(variate.spread),
                    error,
                    np.where(which, count, 0),
                    np.ones(total),
                    which,
                    plain=np.full(total, plain),
                )
                # Samples go where the deviation is: its mean counts, not that of its square.
                found[kind] = np.abs(spread.twice[:, which]).sum(axis=0)
            return found

        found = np.concatenate(self._map(sample, [int(n) for n in numbers]), axis=1)
        self._tree.leaves().density[:] = own
        self.spent += int(each * share * np.count_nonzero(tried))
        return found
