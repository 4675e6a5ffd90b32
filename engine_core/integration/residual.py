# SPDX-License-Identifier: GPL-3.0-or-later
"""Sampling what the control variate leaves over: the mean of f - h in every bin.

    I_b = H_b + 1/n sum_i (f(u_i) - h(u_i)) vol_p / q_p          (thesis eq. 2.14 with alpha = 1)

A sample's coordinate chooses the region among those that overlap the bin, with probability q, and is
stretched to serve again as that coordinate inside the overlap: the region is known, not searched for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .control_variate import TileOfRegions
from .integrand import StagedIntegrand, values_at
from .point_sets import PointSet
from .standard_error import SECOND, Spread

EVEN = 0.2
"""Part of a bin's samples that is spread over its regions evenly: no weight exceeds 1 / EVEN."""


SHORT = 64
"""Samples of a bin up to which they are summed without a care for how rounding grows."""

_NO_ERROR = 1e-300
"""Below it, a bin's samples are spread evenly."""


class Overlaps:
    """Regions that overlap each bin of a tile, and how samples are shared among them."""

    def __init__(
        self,
        tile: TileOfRegions,
        density: np.ndarray,
        error: np.ndarray,
        even: float = EVEN,
        wanted: np.ndarray | None = None,
    ):
        """density : (R,) predicted deviation in the tile's regions. error : (B,) in its bins.

        wanted : (B,) bool, bins that are to be sampled; None for all.
        """
        pairs = tile.pairs(wanted)
        self._first, self._next = pairs.first[:-1], pairs.first[1:]
        groups, none = tile.footprints, [np.zeros(0, np.int64)]
        self._region = np.concatenate(none + [group.regions for group in groups])
        sizes = [np.diff(group.begin, append=len(group.regions)) for group in groups]
        size = np.concatenate(none + sizes)
        self._footprint, self._lowest = pairs.footprint, np.cumsum(size) - size
        self.single = not (size > 1).any() and not (np.diff(pairs.first) > 1).any()
        if self.single:
            return
        # vol (even + (1 - even) density / error): of all footprints in each bin, one bin after the other,
        # about 1 in each; and in each footprint, where both terms are the same in all of its bins but for
        # the error, of one region after the other.
        volume = tile.overlap.take(self._region)
        self._even, self._led = volume * even, volume * density.take(self._region) * (1 - even)
        # One over what is next to nothing would be too much for single precision.
        error = error.astype(np.float64, copy=False)
        self._scale = np.divide(1, error, out=np.zeros(len(error)), where=error > _NO_ERROR)
        self._of_even, self._running_even = _shares(self._even, self._lowest, size)
        self._of_led, self._running_led = _shares(self._led, self._lowest, size)
        self._last, self._halvings = self._lowest + size - 1, int(size.max(initial=1) - 1).bit_length()
        self._volume = volume
        chance = self._of_led.take(pairs.footprint)
        chance *= np.repeat(self._scale, np.diff(pairs.first))
        chance += self._of_even.take(pairs.footprint)
        running = np.concatenate([[0.0], np.cumsum(chance)])
        self._begin, self._end = running[:-1], running[1:]
        self._low = running.take(self._first)
        self._length = running.take(self._next) - self._low
        # How many end before each of equal steps: where to begin to look.
        self._steps = len(chance) / running[-1]
        ends = np.bincount((self._end * self._steps).astype(np.int64))
        self._guide = np.cumsum(ends) - ends

    def choose(self, bin_: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """(N,) the regions that x (N,) in [0, 1) chooses in bins (N,), and weights (N,) vol / q, or None.

        x becomes uniform in [0, 1] once more.
        """
        first = self._first.take(bin_)
        if self.single:
            return self._region.take(self._lowest.take(self._footprint.take(first))), None
        length, scale = self._length.take(bin_), self._scale.take(bin_)
        x *= length
        x += self._low.take(bin_)
        pair = self._guide.take((x * self._steps).astype(np.int64))
        further = np.flatnonzero(self._end.take(pair) <= x)
        pair[further] += 1
        further = further[self._end.take(pair[further]) <= x[further]]
        pair[further] = np.searchsorted(self._end, x[further], side="right")
        # A rounding may lead out of the bin.
        np.minimum(pair, self._next.take(bin_) - 1, out=pair)
        footprint = self._footprint.take(pair)
        x -= self._begin.take(pair)
        even, led = self._of_even.take(footprint), self._of_led.take(footprint)
        led *= scale
        region, last = self._lowest.take(footprint), self._last.take(footprint)
        before = even * self._running_even.take(region)
        before += led * self._running_led.take(region)
        x += before
        for step in reversed(range(self._halvings)):
            higher = np.minimum(region + (1 << step), last)
            start = even * self._running_even.take(higher)
            start += led * self._running_led.take(higher)
            np.copyto(region, higher, where=start <= x)
            np.copyto(before, start, where=start <= x)
        width = scale
        width *= self._led.take(region)
        width += self._even.take(region)
        x -= before
        x /= width
        np.clip(x, 0.0, 1.0, out=x)
        length *= self._volume.take(region)
        length /= width
        return self._region.take(region), length


def _shares(part: np.ndarray, lowest: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums (F,) of ``part`` (R,) over footprints, and what fraction of its footprint's lies before each (R,).

    Each footprint's fractions are summed by themselves, or the large ones' rounding would be the small ones'.
    """
    total = np.add.reduceat(part, lowest) if len(part) else part
    fraction = part / np.repeat(np.where(total > 0, total, 1), size)
    running = np.cumsum(fraction) - fraction
    running -= np.repeat(running.take(lowest), size)
    return total, np.maximum(running, 0)


class ResidualSampler:
    """Residual samples of an integrand, tile by tile; safe to use from several threads.

    evaluations of the integrand are the caller's to count.
    """

    def __init__(
        self,
        points: tuple[PointSet, PointSet],
        covered: int,
        split: int = 1,
        batch: int = 16384,
        even: float = EVEN,
    ) -> None:
        """points : of the bins' dimensions and of the rest. covered : dimensions of the polynomial.

        split : points of the rest for each of the bins' dimensions, a power of two. batch : at once, about.
        """
        self._points = points
        self._covered = covered
        self._split = split
        self._batch = batch
        self._even = even

    def sample(
        self,
        integrand: StagedIntegrand,
        bins: Any,
        keys: np.ndarray,
        tile: TileOfRegions,
        density: np.ndarray,
        error: np.ndarray,
        count: np.ndarray,
        chance: np.ndarray,
        twice: np.ndarray,
        after_batch: Callable[[np.ndarray, np.ndarray, Any], None] | None = None,
        plain: np.ndarray | None = None,
        have: np.ndarray | None = None,
        before: tuple[np.ndarray, Spread | None] | None = None,
    ) -> tuple[np.ndarray, Spread | None]:
        """Mean residual (C, B) of a tile's bins, and its spread.

        bins : B of the integrand's, sliceable. keys : (B,) uint32. count : (B,) powers of two, or 0.
        chance : (B,) that a bin was to be sampled; its mean is divided by it.
        twice : (B,) whether a bin is sampled again, by another net: see `standard_error`.
        after_batch : called with (bins' numbers, samples of each, first stage) of every batch; the samples
            lie bin after bin.
        plain : (B,) bins that h does not serve: f itself is sampled there, as by any net.
        have : (B,) powers of two, or 0: samples of ``count`` that were taken before, in every bin for sure.
        before : what this function returned of those; the spread may be None, and stays so, if nobody wants
            to know it and no bin is sampled twice.
        """
        plain = np.zeros(len(count), bool) if plain is None else plain
        have = np.zeros(len(count), np.int64) if have is None else have
        wanted = count > have
        overlaps = Overlaps(tile, density, error, self._even, wanted & ~plain)
        if before is None:
            total = np.zeros((len(tile.channels), len(count)))
            spread = Spread.empty(*total.shape)
        else:
            total, spread = np.array(before[0], np.float64), before[1]
            if spread is not None:
                spread = Spread(spread.half.copy(), spread.twice.copy())
        means = total[None]
        if spread is not None:
            # The means of both nets, of bins that are sampled twice.
            apart = np.where(twice & (have > 0), spread.twice, 0) / np.sqrt(2)
            means = np.stack([total + apart, total - apart])
        for of, plainly in ((overlaps, ~plain), (None, plain)):
            chunks = [
                Chunk(chosen, keys_, net, int(have[chosen[0]]), int(count[chosen[0]]))
                for net, which, keys_ in ((0, wanted, keys), (1, wanted & twice, keys ^ SECOND))
                for chosen in _alike(np.flatnonzero(which & plainly), count, have)
            ]
            for batch in _batches(chunks, max(1, self._batch // self._split)):
                residual, stage = self._residual(integrand, bins, tile, of, batch)
                low = 0
                for chunk in batch:
                    new, old, n, net, part = chunk.new, chunk.old, chunk.count, chunk.net, chunk.bins
                    high = low + len(part) * new * self._split
                    values = residual[:, low:high].reshape(len(residual), len(part), -1)
                    first, second = _halves(values, means[net][:, part], old, n, self._split)
                    means[net][:, part] = (first + second) / 2 / chance[part]
                    if n > 1 and net == 0 and spread is not None:
                        spread.half[:, part] = (first - second) / 2
                    low = high
                if after_batch is not None:
                    after_batch(
                        np.concatenate([chunk.bins for chunk in batch]),
                        np.concatenate([np.full(len(chunk.bins), chunk.new) for chunk in batch]),
                        stage,
                    )
        if spread is None:
            return total, None
        again = wanted & twice
        total[:, wanted] = means[0][:, wanted]
        total[:, again] = (means[0][:, again] + means[1][:, again]) / 2
        spread.twice[:, again] = (means[0][:, again] - means[1][:, again]) / np.sqrt(2)
        by_chance = chance < 1
        spread.twice[:, by_chance] = total[:, by_chance]
        return total, spread

    def _residual(
        self,
        integrand: StagedIntegrand,
        bins: Any,
        tile: TileOfRegions,
        overlaps: Overlaps | None,
        batch: list[Chunk],
    ) -> tuple[np.ndarray, Any]:
        """Weighted f - h (C, N * split) of a batch, and the first stage, of N points.

        overlaps : None for f alone.
        """
        bin_ = np.concatenate([np.repeat(chunk.bins, chunk.new) for chunk in batch])
        screen, rest = (
            np.concatenate([chunk.points(points, each) for chunk in batch], axis=1)
            for points, each in zip(self._points, (1, self._split), strict=True)
        )
        points = len(bin_)
        if overlaps is None:
            stage = integrand.first(bins[bin_], screen[:, :, None])
            f = values_at(integrand, stage, points, None, rest)
            return f[: len(tile.channels)], stage
        of_samples, first = bin_, screen
        if self._split > 1:
            of_samples, first = np.repeat(bin_, self._split), np.repeat(screen, self._split, axis=1)
        inside = self._covered - len(first)
        u = np.concatenate([first, rest[:inside]]).astype(np.float64, copy=False)
        region, weight = overlaps.choose(of_samples, u[len(first) if inside else 0])
        h = tile.values(region, of_samples, u)
        place = tile.place(region, u)
        if self._split == 1:
            screen = place[: len(screen)]
        stage = integrand.first(bins[bin_], screen[:, :, None])
        at = place[len(screen) :]
        if inside < len(rest):
            at = np.concatenate([at, rest[inside:]])
        f = values_at(integrand, stage, points, None, at)
        residual = f - h if len(f) == len(h) else f[: len(h)] - h
        if weight is not None:
            residual *= weight
        return residual, stage


@dataclass(frozen=True, eq=False)
class Chunk:
    """Bins that go from equally many samples to equally many.

    bins : (B',) numbers. keys : (B,) of all bins. net : 0, or 1 of bins that are sampled again.
    old, count : samples before and after.
    """

    bins: np.ndarray
    keys: np.ndarray
    net: int
    old: int
    count: int

    @property
    def new(self) -> int:
        """Samples to take in each bin."""
        return self.count - self.old

    def points(self, points: PointSet, each: int) -> np.ndarray:
        """(D, B' * new * each) of a group that takes ``each`` points a sample."""
        count = self.new * each
        found = points.points(self.keys[self.bins], self.old * each, count)
        return found.reshape(len(found), len(self.bins) * count)


def _batches(chunks: list[Chunk], most: int) -> Iterator[list[Chunk]]:
    """The chunks cut and joined, so that each list has about ``most`` new samples in all."""
    batch, room = [], most
    for chunk in chunks:
        low = 0
        while low < len(chunk.bins):
            high = low + max(1, room // chunk.new)
            part = replace(chunk, bins=chunk.bins[low:high])
            batch.append(part)
            room -= len(part.bins) * chunk.new
            low = high
            if room <= chunk.new // 2:
                yield batch
                batch, room = [], most
    if batch:
        yield batch


def _alike(bins: np.ndarray, count: np.ndarray, have: np.ndarray) -> list[np.ndarray]:
    """``bins`` (B',), parted into those that go from equally many samples to equally many."""
    if not bins.size:
        return []
    # Both are powers of two or 0; of so few bits a stable sort goes through them digit by digit.
    count, have = (np.frexp(a.take(bins))[1].astype(np.uint16) for a in (count, have))
    code = count << np.uint16(8) | have
    order = np.argsort(code, kind="stable")
    return np.split(bins.take(order), np.flatnonzero(np.diff(code.take(order))) + 1)


def _halves(
    new: np.ndarray, before: np.ndarray, old: int, count: int, split: int
) -> tuple[np.ndarray, np.ndarray]:
    """Means (C, B) over both halves of ``count`` samples, the first ``old`` of which had the mean ``before``.

    new : (C, B, (count - old) * split) the others.
    """
    if count == 1:
        mean = _mean(new)
        return mean, mean
    half = count // 2
    if old == half:
        return before, _mean(new)
    cut = (half - old) * split
    first = _mean(new[:, :, :cut]) * (half - old)
    return (first + old * before) / half, _mean(new[:, :, cut:])


def _mean(values: np.ndarray) -> np.ndarray:
    """(C, B) means over the last axis."""
    count = values.shape[2]
    if count == 1:
        return values[:, :, 0]
    # Not reduced along a short axis: that costs a call each.
    return np.einsum("cbn->cb", values) / count if count <= SHORT else values.mean(axis=2)
