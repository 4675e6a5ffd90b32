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
        total = self.index.shape[1]
        h, error = np.zeros((len(self._values), total)), np.zeros(total)
        weights = face_weights(self._dimensions - self._bins)
        density = self.density(spread)
        left, deviation = np.zeros(total), np.zeros(total)
        moments = self._moments().reshape(-1, len(self.regions))
        in_bins = np.zeros((len(moments), total))
        for chosen, logs, slots in self._groups():
            flat, times = slots.ravel(), slots.shape[1]
            share = self.overlap[chosen]
            error += np.bincount(flat, np.repeat(share * density[chosen], times), total)
            left += np.bincount(flat, np.repeat(share * self.regions.density[chosen] ** 2, times), total)
            for out, of in zip(
                in_bins.reshape(-1, total), moments.reshape(-1, len(self.regions)), strict=True
            ):
                out += np.bincount(flat, np.repeat(share * of[chosen], times), total)
            for out, values in zip(h, self._values, strict=True):
                v = values.take(self.regions.nodes[chosen]).reshape(len(chosen), -1, self._face) @ weights
                v = (v * share[:, None]).reshape(len(chosen), *(3,) * self._bins)
                for log in logs:
                    v = np.moveaxis(v, 1, -1) @ bin_means(1 << log).T
                out += np.bincount(flat, v.ravel(), total)
        for mean, square in in_bins.reshape(-1, 2, total):
            variance = square - mean * mean
            deviation += np.sqrt(np.where(variance > 1e-12 * square, variance, 0))
        known = deviation > 0
        return h, error, np.divide(left, deviation**2, out=np.zeros(total), where=known)

    def _moments(self) -> np.ndarray:
        """(C, 2, R) means of the nodes' values, and of their squares."""
        weights = face_weights(self._dimensions)
        rows = (v.take(self.regions.nodes).astype(np.float64, copy=False) for v in self._values)
        return np.stack([(v @ weights, np.square(v) @ weights) for v in rows])

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
        coefficients_of = self._coefficients()
        outer, inner = (_tensor(b, n, coefficients_of.dtype) for b in (basis[:half], basis[half:]))
        out = np.empty((len(self._values), n), coefficients_of.dtype)
        for row, coefficients in zip(out, coefficients_of, strict=True):
            v = coefficients.take(region, axis=0).reshape(n, outer.shape[1], -1)
            np.einsum("nk,nk->n", np.matmul(outer[:, None, :], v)[:, 0], inner, out=row)
        return out

    def _coefficients(self) -> np.ndarray:
        """(C, R, 3^m) node values, gathered once."""
        if self._rows is None:
            self._rows = np.stack([v.take(self.regions.nodes) for v in self._values])
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
