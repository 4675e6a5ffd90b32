# SPDX-License-Identifier: GPL-3.0-or-later
"""More samples where neighbours see different things.

Lights without size, all of them sampled, leave the pixel alone to be integrated; and near such a light, or
across its shadow's edge, a pixel in a hundred holds all of the error.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .directly_seen import contrast_beside
from .image.film import LARGEST, Film
from .integration.allocation import black_of_chessboard, sample_counts
from .integration.mapping import even_parts
from .integration.point_sets import PointSet
from .integration.sample_mean import sum_samples
from .transport.direct_light import DirectLight, DirectLightOverTile, Pixels

MORE, MOST = 1 / 4, 4096
"""Samples for edges between pixels, of all others; and of a pixel at most."""


class EdgeSamples:
    """Which pixels of a film are sampled how much more, and doing so.

    work : (have, times, rows (N,)) what `add` takes. samples : of all work.
    """

    def __init__(
        self,
        integrand: DirectLight,
        film: Film,
        corner: tuple[int, int],
        points: tuple[PointSet, PointSet],
        have: tuple[int, int],
        batch: int,
        check: Callable[[], None],
        leave: np.ndarray | None = None,
    ) -> None:
        """film : of means of ``points``. have : samples of a chessboard's white pixels, and of black ones.

        corner : x0, y0 in the frame. batch : samples at once, about. check : called before every batch; may
        raise. leave : (H, W) bool, pixels that are to stay as they are.
        """
        self._integrand, self._film, self._corner, self._points = integrand, film, corner, points
        self._batch, self._check = batch, check
        contrast = contrast_beside(film.combined[..., :3].transpose(2, 0, 1)).sum(axis=0, dtype=np.float64)
        if leave is not None:
            contrast[leave] = 0
        self.work: list[tuple[int, int, np.ndarray]] = []
        black = black_of_chessboard(contrast.shape)
        for which, samples in zip((~black, black), have, strict=True):
            if contrast[which].any():
                # An edge across a pixel is integrated by n points of a net with an error of n^-3/4.
                budget = (1 + MORE) * np.count_nonzero(which)
                times = sample_counts(contrast[which] ** 0.8, budget, 0.0, 1.0)[0]
                times = np.minimum(times, max(1, MOST // samples))
                for many in np.unique(times[times > 1]).tolist():
                    rows = np.flatnonzero(which)[times == many]
                    most = max(1, batch // (samples * many))
                    self.work += [(samples, many, rows[part]) for part in even_parts(len(rows), most)]
        self.work.sort(key=lambda work: -work[0] * work[1])
        self.samples = sum(have * (many - 1) * len(rows) for have, many, rows in self.work)
        for group in points:
            group.prepare(max((have * many for have, many, _ in self.work), default=1))

    def add(self, have: int, many: int, rows: np.ndarray) -> DirectLightOverTile:
        """Sample pixels ``rows`` (N,) of the film, which ``have`` samples, until they have so ``many`` times
        these.

        Returns what was sampled, which has counted its rays.
        """
        self._check()
        film, integrand = self._film, self._integrand
        row, column = np.divmod(rows, film.depth.shape[1])
        x, y = column + self._corner[0], row + self._corner[1]
        pixels = Pixels(x.astype(np.int32), y.astype(np.int32), np.zeros(len(rows), np.int32))
        choice = integrand.choice_of_cells(*np.zeros((2, 1), np.intp), self._check)
        over = DirectLightOverTile(integrand, choice, self._check)
        new = have * (many - 1)
        sums = sum_samples(over, pixels, pixels.key(), self._points, have, new, 1, self._batch)
        mean = np.minimum(sums.values / new, LARGEST)
        for kept, values in ((film.combined, mean[:4]), (film.normal, mean[4:7])):
            if len(values):
                old = kept[row, column]
                kept[row, column] = old + (values.T - old) * ((many - 1) / many)
        film.sample_count[row, column] = have + new
        return over
