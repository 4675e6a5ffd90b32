# SPDX-License-Identifier: GPL-3.0-or-later
"""The piecewise polynomial, ready for use: its exact mean in every bin, and its value at samples.

The picture is cut into tiles whose edges are multiples of the roots' edges, so that every region lies
in one tile, and what is listed (pairs of region and bin) is listed for a tile at a time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .mapping import Map, in_order
from .regions import BIN, WHOLE, Regions, RegionTree, neighbourly
from .rules import bin_means, face_weights, lagrange, weighted

LOG_BINS = 14
"""log2 of a tile's bins, about: enough for full batches of samples, few enough for the cache."""

ROWS = 4096
"""Samples whose regions' node values are gathered at once: what fits the cache."""


@dataclass(eq=False)
class Pairs:
    """P overlaps of footprints and bins, bin after bin.

    footprint : (P,) numbered through the tile's groups. first : (B + 1,) where each bin's pairs begin.
    """

    footprint: np.ndarray
    first: np.ndarray


KEPT_REGIONS, KEPT_BINS = 50_000, 1 << 21
"""Up to which a picture's tiles are kept: about 1 kB a region and 40 bytes a bin."""

TOGETHER = 8
"""Samples of a region whose polynomials are evaluated together."""


class Footprints(NamedTuple):
    """F sets of bins, equally many along each dimension, and the regions over each.

    regions : (R,) footprint after footprint. begin : (F,) where each one's regions begin.
    logs : log2 of the bins along each dimension. slots : (F, S) the bins, the last dimension fastest.
    """

    regions: np.ndarray
    begin: np.ndarray
    logs: tuple[int, ...]
    slots: np.ndarray


class TileOfRegions:
    """The regions of one tile, and the tile's B bins.

    index : (K, B) the bins' index in the picture, the last dimension fastest.
    overlap : (R,) the fraction of any bin it overlaps that a region takes up.
    """

    def __init__(self, regions: Regions, values: np.ndarray, low: tuple[int, ...], high: tuple[int, ...]):
        self._bins = bins = len(low)
        self._dimensions = m = len(regions.start)
        if m > bins:
            regions = regions[np.lexsort(regions.start[: bins - 1 : -1])]
        self.regions = regions
        self._values = values
        self.channels = range(len(values))
        self.shape = tuple(h - lo for lo, h in zip(low, high, strict=True))
        self.index = np.indices(self.shape, np.int32).reshape(bins, -1) + np.array(low, np.int32)[:, None]
        self._local = self.index - self.index[:, :1]
        size = self.regions.size.astype(np.int64)
        self.start_bin = (self.regions.start[:bins] >> BIN) - np.array(low)[:, None]
        self._log_bins = np.maximum(size[:bins] - BIN, 0)
        self._per_bin = np.ldexp(1.0, -self._log_bins)
        self._part = np.ldexp(1.0, np.minimum(size[:bins] - BIN, 0))
        self._begin = np.ldexp((self.regions.start[:bins] & ((1 << BIN) - 1)).astype(np.float64), -BIN)
        self._edge = np.ldexp(1.0, size[bins:] - WHOLE)
        self._origin = np.ldexp(self.regions.start[bins:].astype(np.float64), -WHOLE)
        self.overlap = self._edge.prod(axis=0) * self._part.prod(axis=0)
        self._face = 3 ** (m - bins)
        # Whether regions are at least a bin long, and not longer, in each of the bins' dimensions.
        self._whole = (size[:bins] >= BIN).all(axis=1)
        self._within = (size[:bins] <= BIN).all(axis=1)
        self._rows: np.ndarray | None = None

    @cached_property
    def footprints(self) -> list[Footprints]:
        """Regions that cover equally many bins along each dimension, gathered by the bins that they cover."""
        code = np.zeros(len(self.regions), np.int64)
        for logs in self._log_bins:
            code = code * 64 + logs
        strides = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        corner = self.start_bin.T @ strides
        groups = []
        for value in np.unique(code):
            chosen = np.flatnonzero(code == value)
            logs = tuple(int(n) for n in self._log_bins[:, chosen[0]])
            # Different in the rest alone, they lie over the same bins.
            chosen = chosen[np.argsort(corner.take(chosen), kind="stable")]
            begin = np.flatnonzero(np.diff(corner.take(chosen), prepend=-1))
            slots = corner.take(chosen.take(begin)).astype(np.int32)[:, None]
            for log, stride in zip(logs, strides, strict=True):
                along = np.arange(0, stride << log, stride, dtype=np.int32)
                slots = (slots[:, :, None] + along).reshape(len(begin), -1)
            groups.append(Footprints(chosen, begin, logs, slots))
        return groups

    def means(self, spread: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """H (C, B), exact means of the polynomials; E (B,), the predicted deviation of f - h; and the part
        (B,) of the variance of f in the bin, as the nodes see it, that h leaves over.

        spread : of the node store, where nodes integrate more dimensions inside.
        """
        total, channels = self.index.shape[1], len(self._values)
        over_bins, over_rest = 3**self._bins, face_weights(self._dimensions - self._bins)
        # Of each region, as parts of its bins: error, its square, f and its square; and h without the rest.
        constant = np.empty((2 + 2 * channels, len(self.regions)))
        constant[0], constant[1] = self.density(spread), np.square(self.regions.density)
        nodes = np.empty((channels, len(self.regions), over_bins))
        weights = face_weights(self._dimensions)
        for c, values in enumerate(self._values):
            v = values.take(self.regions.nodes).astype(np.float64, copy=False)
            constant[2 + c] = weighted(v, weights)
            constant[2 + channels + c] = weighted(np.square(v), weights)
            nodes[c] = weighted(v.reshape(len(v), over_bins, -1), over_rest)
        constant *= self.overlap
        nodes *= self.overlap[:, None]
        h, sums = np.zeros((channels, total)), np.zeros((len(constant), total))
        for group in self.footprints:
            flat, each = group.slots.ravel().astype(np.intp), group.slots.shape[1]
            once = np.add.reduceat(constant.take(group.regions, axis=1), group.begin, axis=1)
            v = np.add.reduceat(nodes.take(group.regions, axis=1), group.begin, axis=1)
            behind = 1
            for log in reversed(group.logs):
                v = bin_means(1 << log) @ v.reshape(-1, 3, behind)
                behind <<= log
            for row, values in zip(h, v.reshape(channels, -1), strict=True):
                row[flat] += values
            for row, values in zip(sums, once, strict=True):
                row[flat] += np.repeat(values, each)
        error, left = sums[:2]
        mean, square = sums[2:].reshape(2, channels, total)
        variance = square - mean * mean
        deviation = np.sqrt(np.where(variance > 1e-12 * square, variance, 0)).sum(axis=0)
        return h, error, np.divide(left, deviation**2, out=np.zeros(total), where=deviation > 0)

    def error(self, spread: np.ndarray | None = None) -> np.ndarray:
        """(B,) E alone, as in `means`."""
        density, out = self.density(spread) * self.overlap, np.zeros(self.index.shape[1])
        for group in self.footprints:
            once = np.add.reduceat(density.take(group.regions), group.begin)
            out[group.slots] += once[:, None]
        return out

    def density(self, spread: np.ndarray | None) -> np.ndarray:
        """(R,) the predicted deviation of a sample of f - h."""
        if spread is None:
            return self.regions.density
        inside = weighted(spread.take(self.regions.nodes), face_weights(self._dimensions))
        return np.hypot(self.regions.density, inside)

    def pairs(self, wanted: np.ndarray | None = None) -> Pairs:
        """The footprints over this tile's bins, or over those ``wanted`` (B,) bool: the others have none."""
        total = self.index.shape[1]
        shift = sum(len(group.begin) for group in self.footprints).bit_length()
        key_type = np.uint32 if total << shift < 1 << 32 else np.uint64
        parts, low = [np.zeros(0, key_type)], 0
        for group in self.footprints:
            key = group.slots.astype(key_type)
            key <<= key_type(shift)
            key |= np.arange(low, low + len(key), dtype=key_type)[:, None]
            parts.append(key.ravel() if wanted is None else key[wanted.take(group.slots)])
            low += len(key)
        key = np.concatenate(parts)
        key.sort()
        first = np.searchsorted(key, np.arange(total + 1, dtype=key_type) << key_type(shift))
        key &= key_type((1 << shift) - 1)
        return Pairs(key.astype(np.int64), first)

    # -- at samples --------------------------------------------------------------------------------

    def place(self, region: np.ndarray, u: np.ndarray) -> np.ndarray:
        """u (m, N) uniform in the overlaps with bins -> (m, N) bins' own coordinates and primary space.

        A region below a bin's size takes its part of the bin; a larger one all of it.
        """
        out = np.empty((len(u), u.shape[1]))
        bins = self._bins
        for d in range(bins):
            if self._whole[d]:
                out[d] = u[d]
                continue
            np.multiply(u[d], self._part[d].take(region), out=out[d])
            out[d] += self._begin[d].take(region)
        for d in range(bins, len(u)):
            np.multiply(u[d], self._edge[d - bins].take(region), out=out[d])
            out[d] += self._origin[d - bins].take(region)
        return out

    def values(self, region: np.ndarray, bin_: np.ndarray, u: np.ndarray) -> np.ndarray:
        """h (C, N) at u (m, N) uniform in the overlaps of ``region`` and ``bin_`` (N,), both the tile's."""
        coefficients = self._coefficients()
        basis = []
        for d, t in enumerate(u):
            if d < self._bins and not self._within[d]:
                t = t + (self._local[d].take(bin_) - self.start_bin[d].take(region))
                t *= self._per_bin[d].take(region)
            basis.append(lagrange(t.astype(coefficients.dtype, copy=False)))
        if len(region) < 4 * len(self.regions):
            return _apart(coefficients, region, basis)
        return _together(coefficients, region, basis)

    def _coefficients(self) -> np.ndarray:
        """(R, C, 3^m) node values, gathered once."""
        if self._rows is None:
            self._rows = np.stack([v.take(self.regions.nodes) for v in self._values], axis=1)
        return self._rows


def _apart(coefficients: np.ndarray, region: np.ndarray, basis: list[np.ndarray]) -> np.ndarray:
    """Polynomials (R, C, 3^m) of regions (N,) at bases, m of (3, N) -> (C, N); each sample by itself."""
    count, half = len(region), len(basis) // 2
    outer, inner = (np.ascontiguousarray(_tensor(b, count).T) for b in (basis[:half], basis[half:]))
    out = np.empty((coefficients.shape[1], count), coefficients.dtype)
    for low in range(0, count, ROWS):
        part = slice(low, low + ROWS)
        v = coefficients.take(region[part], axis=0)
        v = np.matmul(v.reshape(len(v), -1, inner.shape[1]), inner[part, :, None])
        v = np.matmul(v.reshape(len(v), len(out), -1), outer[part, :, None])
        out[:, part] = v[:, :, 0].T
    return out


def _together(coefficients: np.ndarray, region: np.ndarray, basis: list[np.ndarray]) -> np.ndarray:
    """As `_apart`, a few samples of a region at a time, whose node values are read once."""
    order = np.argsort(region.astype(np.min_scalar_type(len(coefficients))), kind="stable")
    ordered = region.take(order)
    begin = np.flatnonzero(np.diff(ordered, prepend=-1))
    rows = -(-np.diff(begin, append=len(region)) // TOGETHER)
    which = np.repeat(ordered.take(begin), rows)
    # Where each sample is among rows of equal length; what a row lacks repeats the first sample.
    start = (np.cumsum(rows) - rows) * TOGETHER - begin
    at = np.arange(len(region)) + np.repeat(start, np.diff(begin, append=len(region)))
    sample = np.zeros(len(which) * TOGETHER, np.intp)
    sample[at] = order
    rowwise = [b.take(sample, axis=1).reshape(3, -1, TOGETHER).swapaxes(0, 1) for b in basis]
    found = np.empty((len(which), coefficients.shape[1], TOGETHER), coefficients.dtype)
    step = ROWS // TOGETHER // 2
    for low in range(0, len(which), step):
        part = slice(low, low + step)
        t = rowwise[0][part]
        for b in rowwise[1:]:
            t = (t[:, :, None] * b[part, None]).reshape(len(t), -1, TOGETHER)
        np.matmul(coefficients.take(which[part], axis=0), t, out=found[part])
    out = np.empty((found.shape[1], len(region)), found.dtype)
    for row, values in zip(out, found.swapaxes(0, 1), strict=True):
        row[order] = values.ravel().take(at)
    return out


def _tensor(basis: list[np.ndarray], count: int) -> np.ndarray:
    """(3^k, N) products of k bases (3, N)."""
    out = np.ones((1, count), basis[0].dtype if basis else np.float32)
    for b in basis:
        out = (out[:, None] * b).reshape(-1, count)
    return out


class ControlVariate:
    """A region tree cut into tiles."""

    def __init__(
        self,
        tree: RegionTree,
        log_edge: int,
        max_overlaps: int,
        map_: Map = in_order,
        log_bins: int = LOG_BINS,
    ) -> None:
        """log_edge : of the tree's roots. max_overlaps : of regions and bins, in any one tile.

        map_ : runs a function over items on workers. log_bins : of a tile, about, if roots are not larger.
        """
        self._tree = tree
        self.bins = tree.bins
        regions = tree.leaves()
        # The nodes' errors have done their part in the tree: from here on they direct samples.
        regions.density[:] = neighbourly(regions.density, regions, tree.store.count, map_)
        covered = np.maximum(regions.size[: len(tree.bins)].astype(np.int64) - BIN, 0).sum(axis=0)
        overlaps = np.ldexp(1.0, covered)
        self._log = max(log_bins // len(tree.bins), log_edge)
        while True:
            self._counts = tuple(-(-n >> self._log) for n in tree.bins)
            tile = np.zeros(len(regions), np.int64)
            for d, n in enumerate(self._counts):
                tile = tile * n + (regions.start[d] >> (BIN + self._log))
            most = np.bincount(tile, overlaps).max()
            if most <= max_overlaps or self._log == log_edge:
                break
            self._log -= 1
        self._order = np.argsort(tile, kind="stable")
        self._first = np.searchsorted(tile[self._order], np.arange(np.prod(self._counts) + 1))
        self.spread = tree.store.spread
        keep = len(regions) <= KEPT_REGIONS and np.prod(tree.bins) <= KEPT_BINS
        self._kept: dict[int, TileOfRegions] | None = {} if keep else None

    def __len__(self) -> int:
        """How many tiles there are."""
        return len(self._first) - 1

    def box(self, number: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """First bin of a tile in each dimension, and the one after its last."""
        at = np.unravel_index(number, self._counts)
        low = tuple(int(i) << self._log for i in at)
        return low, tuple(min(lo + (1 << self._log), n) for lo, n in zip(low, self.bins, strict=True))

    def tile(self, number: int) -> TileOfRegions:
        """Of large pictures and many regions made anew each time: to keep all would take too much memory."""
        if self._kept is not None and number in self._kept:
            return self._kept[number]
        part = self._order[self._first[number] : self._first[number + 1]]
        tile = TileOfRegions(self._tree.leaves()[part], self._tree.store.values, *self.box(number))
        if self._kept is not None:
            self._kept[number] = tile
        return tile
