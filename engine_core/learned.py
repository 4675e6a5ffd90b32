# SPDX-License-Identifier: GPL-3.0-or-later
"""What samples deviate by: as nodes predicted it, corrected by first samples nearby."""

from __future__ import annotations

import numpy as np

from .integration.standard_error import box_sums

LOG_BLOCK, MOST_LOG_BLOCK = 3, 5
"""log2 of the edge in pixels of the blocks that pilot samples speak for, with the blocks around, and of where
these are few."""

IN_BLOCK = 4 / 3
"""Pilot samples of a block: of one or two in all of its neighbourhood, one may be right by chance."""

PLACE = 1 / 64
"""Part of what the neighbours' samples show that is believed of a pixel whatever the nodes say of it."""

FAITH = 0.5
"""How many samples' worth the whole picture weighs beside what the blocks around a pixel show."""

FLOOR = 0.002
"""Deviation of a sample, of the picture's mean radiance, below which no node is believed."""


class Learned:
    """Deviation of a sample: what the nodes predicted, as right as it was in the blocks around.

    A pixel's own sample has no say in its own deviation, so that it may be kept.
    """

    def __init__(
        self, floor: float, of_blocks: tuple[np.ndarray, np.ndarray], log_block: int, own: np.ndarray
    ) -> None:
        self._floor, self._of_blocks, self._log_block, self._own = floor, of_blocks, log_block, own

    @classmethod
    def of(
        cls, found: np.ndarray, rows: np.ndarray, said: np.ndarray, bright: float, one_in: float = 1.0
    ) -> Learned:
        """found : (R,) f - h squared in pixels ``rows`` (R,). said : (H, W) the nodes' deviation.

        bright : the picture's mean radiance, channels summed. one_in : of how many pixels one is of these.
        """
        width = said.shape[1]
        log = int(np.ceil(np.clip(np.log2(IN_BLOCK * one_in) / 2, LOG_BLOCK, MOST_LOG_BLOCK)))
        floor = (
            (FLOOR * bright) ** 2
            + 1e-4 * float(np.einsum("yx,yx->", said, said, dtype=np.float64)) / said.size
            + 1e-300
        )
        own = np.square(said.reshape(-1)[rows], dtype=np.float64) + floor
        shape = tuple(-(-n >> log) for n in said.shape)
        block = (rows // width >> log) * shape[1] + (rows % width >> log)
        sums = [
            box_sums(np.bincount(block, weights, shape[0] * shape[1]).reshape(1, *shape), 1)[0]
            for weights in (found, own, np.ones(len(rows)))
        ]
        # Of the whole picture what is typical: a few outliers are no reason to sample it all.
        some = sums[2] > 0
        typical = np.median(sums[0][some] / np.maximum(sums[1][some], 1e-300)) if some.any() else 1.0
        typical_mean = np.median(sums[0][some] / sums[2][some]) if some.any() else 0.0

        def ratio_and_mean(seen, hoped, count):
            prior = FAITH * np.where(count > 0, hoped / np.maximum(count, 1), 1e-300)
            ratio = np.where(count > 0, (seen + prior * typical) / np.maximum(hoped + prior, 1e-300), typical)
            return ratio, PLACE * (seen + FAITH * typical_mean) / (count + FAITH)

        less = [s.reshape(-1)[block] for s in sums]
        less = (np.maximum(a - b, 0) for a, b in zip(less, (found, own, 1), strict=True))
        own_ratio, own_mean = ratio_and_mean(*less)
        return cls(floor, ratio_and_mean(*sums), log, own * own_ratio + own_mean)

    def deviation(self, said: np.ndarray, rows: slice, further: np.ndarray) -> np.ndarray:
        """(h, W) float64 of pixels in some rows, the first of a block's.

        said : (h, W) the nodes'. further : (h, W) variance that is known for sure.
        """
        ratio, mean = (_of_pixels(a, self._log_block, rows, said.shape[1]) for a in self._of_blocks)
        square = np.square(said, dtype=np.float64)
        square += self._floor
        square *= ratio
        square += mean
        square += further
        return np.sqrt(square, out=square)

    def of_samples(self, further: float | np.ndarray = 0.0) -> np.ndarray:
        """(R,) of the pixels that it was learned from, by the others."""
        return np.sqrt(self._own + np.square(further, dtype=np.float64))


def _of_pixels(of_blocks: np.ndarray, log: int, rows: slice, width: int) -> np.ndarray:
    """(h, W) of pixels in ``rows``, the first of a block's, values of their blocks of edge 2^log."""
    edge = 1 << log
    values = of_blocks[rows.start >> log : -(-rows.stop >> log)]
    return np.repeat(np.repeat(values, edge, axis=1)[:, :width], edge, axis=0)[: rows.stop - rows.start]
