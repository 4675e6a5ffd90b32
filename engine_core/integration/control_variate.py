# SPDX-License-Identifier: GPL-3.0-or-later
"""The piecewise polynomial, ready for use: its exact mean in every bin, and its value at samples.

The picture is cut into tiles whose edges are multiples of the roots' edges, so that every region lies
in one tile, and what is listed (pairs of region and bin) is listed for a tile at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .regions import BIN, WHOLE, Regions, RegionTree, neighbourly
from .rules import bin_means, face_weights, lagrange

_LOG_BINS = 14
"""log2 of a tile's bins, about: enough for full batches of samples, few enough for the cache."""

ROWS = 4096
"""Samples whose regions' node values are gathered at once: what fits the cache."""


@dataclass(eq=False)
class Pairs:
    """P overlaps of regions and bins, bin after bin, in each bin ordered by the inner dimensions.

    region : (P,) of the tile's. first : (B + 1,) where each bin's pairs begin.
    """

    region: np.ndarray
    first: np.ndarray


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

    def _groups(self) -> list[tuple[np.ndarray, tuple[int, ...], np.ndarray]]:
        """Regions that cover equally many bins along each dimension: (regions, logs, bins (n, s...))."""
        code = np.zeros(len(self.regions), np.int64)
        for logs in self._log_bins:
            code = code * 64 + logs
        strides = np.cumprod((1, *self.shape[:0:-1]))[::-1]
        groups = []
        for value in np.unique(code):
            chosen = np.flatnonzero(code == value)
            logs = tuple(int(n) for n in self._log_bins[:, chosen[0]])
            slots = np.zeros((len(chosen),) + (1,) * self._bins, np.int64)
            for d, (log, stride) in enumerate(zip(logs, strides, strict=True)):
                along = (self.start_bin[d, chosen][:, None] + np.arange(1 << log)) * stride
                slots = slots + along.reshape(
                    len(chosen), *(1 << log if i == d else 1 for i in range(self._bins))
                )
            groups.append((chosen, logs, slots.reshape(len(chosen), -1)))
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
        nodes = np.empty((channels, over_bins, len(self.regions)))
        weights = face_weights(self._dimensions)
        for c, values in enumerate(self._values):
            v = values.take(self.regions.nodes).astype(np.float64, copy=False)
            constant[2 + c], constant[2 + channels + c] = v @ weights, np.square(v) @ weights
            nodes[c] = (v.reshape(len(v), over_bins, -1) @ over_rest).T
        constant *= self.overlap
        nodes *= self.overlap
        h, sums = np.zeros((channels, total)), np.zeros((len(constant), total))
        for chosen, logs, slots in self._groups():
            # Regions of one size lie beside each other or, different in the rest alone, over the same bins.
            order = np.argsort(slots[:, 0], kind="stable")
            begin = np.flatnonzero(np.diff(slots[order, 0], prepend=-1))
            chosen, flat = chosen[order], slots[order[begin]].ravel()
            once = np.add.reduceat(constant.take(chosen, axis=1), begin, axis=1)
            sums[:, flat] += np.repeat(once, slots.shape[1], axis=1)
            v = np.add.reduceat(nodes.take(chosen, axis=2), begin, axis=2)
            v = v.reshape(channels, *(3,) * self._bins, len(begin))
            for log in logs:
                v = np.moveaxis(v, 1, -1) @ bin_means(1 << log).T
            h[:, flat] += v.reshape(channels, -1)
        error, left = sums[:2]
        mean, square = sums[2:].reshape(2, channels, total)
        variance = square - mean * mean
        deviation = np.sqrt(np.where(variance > 1e-12 * square, variance, 0)).sum(axis=0)
        return h, error, np.divide(left, deviation**2, out=np.zeros(total), where=deviation > 0)

    def density(self, spread: np.ndarray | None) -> np.ndarray:
        """(R,) the predicted deviation of a sample of f - h."""
        if spread is None:
            return self.regions.density
        inside = spread.take(self.regions.nodes) @ face_weights(self._dimensions)
        return np.hypot(self.regions.density, inside)

    def pairs(self, wanted: np.ndarray | None = None) -> Pairs:
        """The overlaps of this tile's bins, or of those ``wanted`` (B,) bool: the others have none."""
        total, shift = self.index.shape[1], len(self.regions).bit_length()
        key_type = np.uint32 if total << shift < 1 << 32 else np.uint64
        parts = []
        for chosen, _, slots in self._groups():
            key = slots.astype(key_type)
            key <<= key_type(shift)
            key |= chosen.astype(key_type)[:, None]
            parts.append(key.ravel() if wanted is None else key[wanted.take(slots)])
        key = np.concatenate([np.zeros(0, key_type), *parts])
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
        m, n = u.shape
        half = (m + 1) // 2
        basis = []
        for d in range(m):
            t = u[d]
            if d < self._bins and not self._within[d]:
                t = t + (self._local[d].take(bin_) - self.start_bin[d].take(region))
                t *= self._per_bin[d].take(region)
            basis.append(lagrange(t))
        coefficients = self._coefficients()
        outer, inner = (_tensor(b, n, coefficients.dtype) for b in (basis[:half], basis[half:]))
        out = np.empty((len(self._values), n), coefficients.dtype)
        for low in range(0, n, ROWS):
            part = slice(low, low + ROWS)
            v = coefficients.take(region[part], axis=0)
            v = v.reshape(len(v), outer.shape[1], -1)
            v = np.matmul(outer[part, None, :], v).reshape(len(v), len(out), -1)
            out[:, part] = np.matmul(v, inner[part, :, None])[:, :, 0].T
        return out

    def _coefficients(self) -> np.ndarray:
        """(R, 3^m C) node values, gathered once; channels before the last half of the dimensions."""
        if self._rows is None:
            rows = np.stack([v.take(self.regions.nodes) for v in self._values], axis=1)
            rows = rows.reshape(len(rows), len(self._values), 3 ** ((self._dimensions + 1) // 2), -1)
            self._rows = np.ascontiguousarray(rows.transpose(0, 2, 1, 3)).reshape(len(rows), -1)
        return self._rows


def _tensor(basis: list[np.ndarray], count: int, dtype: np.dtype) -> np.ndarray:
    """(N, 3^k) products of k bases (3, N)."""
    out = np.ones((1, count))
    for b in basis:
        out = (out[:, None] * b).reshape(-1, count)
    return np.ascontiguousarray(out.T, dtype)


class ControlVariate:
    """A region tree cut into tiles."""

    def __init__(self, tree: RegionTree, log_edge: int, max_overlaps: int) -> None:
        """log_edge : of the tree's roots. max_overlaps : of regions and bins, in any one tile."""
        self._tree = tree
        self.bins = tree.bins
        regions = tree.leaves()
        # The nodes' errors have done their part in the tree: from here on they direct samples.
        regions.density[:] = neighbourly(regions.density, regions, tree.store.count)
        covered = np.maximum(regions.size[: len(tree.bins)].astype(np.int64) - BIN, 0).sum(axis=0)
        overlaps = np.ldexp(1.0, covered)
        self._log = max(_LOG_BINS // len(tree.bins), log_edge)
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

    def __len__(self) -> int:
        """How many tiles there are."""
        return len(self._first) - 1

    def box(self, number: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """First bin of a tile in each dimension, and the one after its last."""
        at = np.unravel_index(number, self._counts)
        low = tuple(int(i) << self._log for i in at)
        return low, tuple(min(lo + (1 << self._log), n) for lo, n in zip(low, self.bins, strict=True))

    def tile(self, number: int) -> TileOfRegions:
        """Made anew each time: to keep all would take more memory than the picture."""
        part = self._order[self._first[number] : self._first[number + 1]]
        return TileOfRegions(self._tree.leaves()[part], self._tree.store.values, *self.box(number))
