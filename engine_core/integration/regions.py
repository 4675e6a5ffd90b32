# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes of primary space, halved where the integrand is not yet a quadratic.

A region is a box with 3^m nodes (Simpson's grid; thesis eq. 4.3-4.6). Boxes are dyadic and, along the
bins' dimensions, aligned to bins: they begin as 2^k bins and halve down to one bin and below. Places
are integers, so no edge is ever rounded; a node's place is its key in one store, so no node is
evaluated twice, whether a region, its child or its neighbour asks for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .mapping import Map, in_order
from .rules import face_weights, weighted

BIN = 20
"""log2 of how many lattice units a bin is long."""

WHOLE = 40
"""log2 of how many lattice units the unit interval of another dimension is long."""

SMALLEST = 2
"""log2 of the shortest edge that is halved: nodes of the halves are on the lattice too."""

TRUST = 0.25
"""Exponent of the surprise in the error, of the nested error the rest. The nested error is the error of
the trapezoid rule, far too much for what is smooth; the surprise is that of the parent's quadratic, but
misses an edge between nodes. 0 is 2 times worse on smooth integrands, 1/2 as good on shadows in the
mean but less even; see benchmarks/ablation.py."""

EXPLORE = 1 / 16
"""Of the splits, those of the largest regions whatever their error: the size term of eq. 4.8, but free of
the integrand's scale and of what is added to it."""

NODE_KEYS = np.array(
    [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0xD6E8FEB86659FD93, 0xFF51AFD7ED558CCD]
    + [0xC4CEB9FE1A85EC53, 0x94D049BB133111EB, 0xBF58476D1CE4E5B9, 0x27D4EB2F165667C5, 0x8CB92BA72F3D8DD7],
    np.uint64,
)
"""A node's key is its place times these, modulo 2^64: two nodes that share one would spoil a control
variate's value, never the estimate."""

_EMPTY = np.uint64(1)
"""The key at a free place of the store's table. A node of this key reads another's value: see above."""

PIECE = 1 << 16
"""Nodes of the regions that a worker takes at once: what fits the cache."""

MOST_EXPECTED = 1 << 21
"""Nodes that room is made for before there are any."""

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray | None]]
"""place (m, N) int64 -> values (C, N), and the spread (N,) of the dimensions inside the nodes."""


class NodeStore:
    """Values of all nodes so far, found by their keys in a hash table.

    values : (C, N). spread : (N,), or more of what a rule tells of a node (..., N), or None.
    """

    def __init__(self, evaluate: Evaluate, expected: int = 0) -> None:
        """expected : nodes that there will be, about: to make room for them at once."""
        self._evaluate = evaluate
        self._expected = min(expected, MOST_EXPECTED)
        # At each of the table's places, with linear probing.
        self._keys, self._slots = np.zeros(0, np.uint64), np.zeros(0, np.int32)
        self._reserve(max(self._expected, 1 << 11))
        self._values: np.ndarray | None = None
        self._spread: np.ndarray | None = None
        self.count = 0

    def slots(self, place: np.ndarray, keys: np.ndarray) -> np.ndarray:
        """(N,) int32 slots of the nodes at place (m, N) int64 with ``keys`` (N,); new ones are evaluated."""
        self._reserve(self.count + len(keys))
        at, unseen = self._find(keys)
        if unseen.size:
            # Of equal keys the one whose number is left is evaluated, in the order they were asked for.
            self._slots[at[unseen]] = number = np.arange(unseen.size, dtype=np.int32)
            new = unseen[self._slots.take(at[unseen]) == number]
            values, spread = self._evaluate(place.take(new, axis=1))
            self._slots[at[new]] = np.arange(self.count, self.count + new.size, dtype=np.int32)
            self._append(values, spread)
        return self._slots.take(at)

    def _find(self, keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Where in the table ``keys`` (N,) are, and which, ascending, were not but now have a place."""
        at = keys ^ (keys >> np.uint64(32))
        at *= NODE_KEYS[0]
        at >>= np.uint64(65 - len(self._keys).bit_length())
        at = at.view(np.int64)
        unseen = np.zeros(len(keys), bool)
        left, here, key = np.arange(len(keys)), at, keys
        while left.size:
            found = self._keys.take(here)
            free = np.flatnonzero(found == _EMPTY)
            if free.size:
                # All write, and read who has got the place.
                self._keys[here[free]] = key[free]
                free = free[self._keys.take(here[free]) == key[free]]
                found[free] = key[free]
                unseen[left[free]] = True
            further = np.flatnonzero(found != key)
            left, key = left[further], key[further]
            here = (here[further] + 1) & (len(self._keys) - 1)
            at[left] = here
        return at, np.flatnonzero(unseen)

    def _reserve(self, count: int) -> None:
        """A table no more than half full of ``count`` nodes."""
        if 2 * count <= len(self._keys):
            return
        used = np.flatnonzero(self._keys != _EMPTY)
        keys, slots = self._keys[used], self._slots[used]
        room = 1 << (2 * count - 1).bit_length()
        self._keys, self._slots = np.full(room, _EMPTY), np.zeros(room, np.int32)
        at, _ = self._find(keys)
        self._slots[at] = slots

    @property
    def values(self) -> np.ndarray:
        return self._values[:, : self.count]

    @property
    def spread(self) -> np.ndarray | None:
        return None if self._spread is None else self._spread[..., : self.count]

    def _append(self, values: np.ndarray, spread: np.ndarray | None) -> None:
        end = self.count + values.shape[1]
        self._values = _grown(self._values, values, self.count, end, self._expected)
        if spread is not None:
            self._spread = _grown(self._spread, spread, self.count, end, self._expected)
        self.count = end


def _grown(array: np.ndarray | None, new: np.ndarray, begin: int, end: int, expected: int) -> np.ndarray:
    """``array`` with ``new`` at [begin:end] of its last axis, in place while there is room.

    expected : to make room for at first.
    """
    if array is None:
        array = np.empty((*new.shape[:-1], max(1024, end, expected)), new.dtype)
    elif array.shape[-1] < end:
        larger = np.empty((*array.shape[:-1], max(2 * array.shape[-1], end)), array.dtype)
        larger[..., :begin] = array[..., :begin]
        array = larger
    array[..., begin:end] = new
    return array


def _largest(values: np.ndarray, count: int) -> np.ndarray:
    """Where the ``count`` largest of the positive values are, in no order."""
    if count <= 0:
        return np.zeros(0, np.intp)
    if count < len(values):
        where = np.argpartition(values, len(values) - count)[len(values) - count :]
        return where[values[where] > 0]
    return np.flatnonzero(values > 0)


@dataclass(eq=False)
class Regions:
    """R boxes in m dimensions.

    start : (m, R) int64, lattice units. size : (m, R) int8, log2 of the edges in lattice units.
    nodes : (R, 3^m) int32, slots of the node store, the last dimension fastest.
    volume : (R,) fraction of the domain.
    density : (R,) nested error, |Simpson - trapezoid|, as a mean over the region (thesis eq. 4.8).
    axis : (R,) the dimension to halve: that of the largest error among those that may be halved.
    gain : (R,) the error in that dimension, 0 if none may.
    longest : (R,) the dimension of the longest edge, as a part of the domain; of several, the worst.
    surprise : (m, R) how far new nodes were from what the region that was halved in that dimension had
        said of them; inf where none was. Of a smooth integrand it is far less than the nested error.
    """

    start: np.ndarray
    size: np.ndarray
    nodes: np.ndarray
    volume: np.ndarray
    density: np.ndarray
    axis: np.ndarray
    gain: np.ndarray
    longest: np.ndarray
    surprise: np.ndarray

    def __len__(self) -> int:
        return len(self.volume)

    def __getitem__(self, part: np.ndarray | slice) -> Regions:
        return Regions(
            self.start[:, part],
            self.size[:, part],
            self.nodes[part],
            self.volume[part],
            self.density[part],
            self.axis[part],
            self.gain[part],
            self.longest[part],
            self.surprise[:, part],
        )


def neighbourly(density: np.ndarray, regions: Regions, nodes: int, map_: Map) -> np.ndarray:
    """(R,) half of each region's own error, half the mean over its nodes of those of all who share them.

    An edge that crosses a region between its nodes is seen by its neighbours.
    map_ : runs a function over items on workers.
    """
    # In two parts however many workers there are, so that sums are the same to the last bit.
    middle = (len(density) + 1) // 2  # of nothing bincount would count in integers
    parts = [slice(0, middle), slice(middle, None)]

    def summed(part: slice) -> tuple[np.ndarray, np.ndarray]:
        slots = regions.nodes[part].ravel()
        each = np.repeat(density[part], regions.nodes.shape[1])
        return np.bincount(slots, each, nodes), np.bincount(slots, minlength=nodes)

    (total, count), (more, also) = map_(summed, parts)
    total = total + more  # of no region bincount makes integers
    count += also
    total /= np.maximum(count, 1)
    around = np.concatenate(map_(lambda part: total.take(regions.nodes[part]).mean(axis=1), parts))
    return 0.5 * (density + around)


def root_edges(bins: int, log_edge: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and log2 sizes, in bins, of dyadic intervals that tile ``bins`` bins, none above 2^log_edge."""
    whole, remainder = bins >> log_edge, bins & ((1 << log_edge) - 1)
    tail = [bit for bit in reversed(range(log_edge)) if remainder >> bit & 1]
    sizes = np.array([log_edge] * whole + tail, np.int64)
    starts = np.concatenate([[0], np.cumsum(1 << sizes)[:-1]])
    return starts, sizes


def _roots(bins: tuple[int, ...], log_edge: int, without: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Starts and log2 sizes (K, R), in bins, of the boxes that tile all bins but those of ``without``."""
    edges = [root_edges(n, log_edge) for n in bins]
    start, size = (
        np.stack([a.ravel() for a in np.meshgrid(*[e[i] for e in edges], indexing="ij")]) for i in (0, 1)
    )
    if without is None or not without.any():
        return start, size
    table = np.pad(without.astype(np.int64), [(1, 0)] * len(bins))
    for axis in range(len(bins)):
        table = table.cumsum(axis)
    done = []
    while start.size:
        # How many of its bins are left out, from the sums at a box's corners.
        marked = np.zeros(start.shape[1], np.int64)
        for corner in np.ndindex((2,) * len(bins)):
            at = start + (1 << size) * np.array(corner)[:, None]
            marked += (-1) ** (len(bins) - sum(corner)) * table[tuple(at)]
        done.append((start[:, marked == 0], size[:, marked == 0]))
        mixed = (marked > 0) & (marked < 1 << size.sum(axis=0))
        start, size = start[:, mixed], size[:, mixed]
        longest = size.argmax(axis=0)[None], np.arange(start.shape[1])
        size[longest] -= 1
        upper = start.copy()
        upper[longest] += 1 << size[longest]
        start, size = np.concatenate([start, upper], axis=1), np.concatenate([size, size], axis=1)
    return tuple(np.concatenate(parts, axis=1) for parts in zip(*done, strict=True))


class RegionTree:
    """Regions that tile the domain, and the worst of them halved until a budget is spent.

    splits : how many regions were halved. sweeps : in how many batches.
    """

    def __init__(
        self,
        bins: tuple[int, ...],
        dimensions: int,
        log_edge: int,
        evaluate: Evaluate,
        within_bins: bool = True,
        without: np.ndarray | None = None,
        map_: Map = in_order,
        expected: int = 0,
    ) -> None:
        """dimensions : m, the bins' and those after them. log_edge : roots are 2^log_edge bins long.

        within_bins : whether regions may be shorter than a bin. without : (*bins) bool, bins of no region.
        map_ : runs a function over items on workers, and returns the results in order.
        expected : nodes that there will be, about.
        """
        self.bins = bins
        self.dimensions = m = dimensions
        self.store = NodeStore(evaluate, expected)
        self._map = map_
        self.splits = self.sweeps = 0
        self._keys = NODE_KEYS[:m]
        self._smallest = np.full(m, SMALLEST)
        if not within_bins:
            self._smallest[: len(bins)] = BIN
        low, log = _roots(bins, log_edge, without)
        count = low.shape[1]
        start, size = np.zeros((m, count), np.int64), np.full((m, count), WHOLE, np.int8)
        start[: len(bins)] = low << BIN
        size[: len(bins)] = log + BIN
        self._full = np.array([n << BIN for n in bins] + [1 << WHOLE] * (m - len(bins)), np.float64)
        self.regions = Regions(
            start,
            size,
            np.empty((count, 3**m), np.int32),
            np.ldexp(1.0, size.astype(np.int64)).prod(axis=0) / self._full.prod(),
            np.empty(count),
            np.empty(count, np.int8),
            np.empty(count),
            np.empty(count, np.int8),
            np.full((m, count), np.inf),
        )
        self._count = count
        offset = np.indices((3,) * m).reshape(m, 3**m)
        place = start[:, :, None] + (offset[:, None, :] << (size.astype(np.int64)[:, :, None] - 1))
        place = place.reshape(m, -1)
        self.regions.nodes[:] = self.store.slots(place, self._key(place)).reshape(count, -1)
        self._map(self._judge, self._pieces(np.arange(count)))

    def _pieces(self, numbers: np.ndarray) -> list[np.ndarray]:
        """Regions (n,) cut into pieces for the workers; none of none."""
        step = max(1, PIECE // 3**self.dimensions)
        return [numbers[low : low + step] for low in range(0, len(numbers), step)]

    def _key(self, place: np.ndarray) -> np.ndarray:
        return np.einsum("dn,d->n", place.astype(np.uint64), self._keys)

    def __len__(self) -> int:
        return self._count

    def leaves(self) -> Regions:
        """The regions as they are now (views)."""
        return self.regions[: self._count]

    @property
    def cost_of_split(self) -> int:
        """New nodes of a split at most: 2 * 3^(m - 1)."""
        return 2 * 3 ** (self.dimensions - 1)

    def sweep(self, splits: int, smallest_volume: float) -> int:
        """Halve at most ``splits`` regions, the worst in their worst dimension; returns how many.

        smallest_volume : no region below it is halved.
        """
        chosen, axis = self._choose(splits, smallest_volume)
        if chosen.size == 0:
            return 0
        self._reserve(self._count + chosen.size)
        parts = [(d, some) for d in range(self.dimensions) for some in self._pieces(chosen[axis == d])]
        wanted = self._map(self._between, parts)
        place = np.concatenate([place for place, _ in wanted], axis=1)
        slots = self.store.slots(place, np.concatenate([keys for _, keys in wanted]))
        sizes = [len(some) for _, some in parts]
        ends = np.cumsum(sizes)
        nodes = np.split(slots.reshape(chosen.size, -1), ends[:-1])
        self._map(self._halve, list(zip(parts, nodes, self._count + ends - sizes, strict=True)))
        self._count += chosen.size
        self.splits += chosen.size
        self.sweeps += 1
        return int(chosen.size)

    def _choose(self, splits: int, smallest_volume: float) -> tuple[np.ndarray, np.ndarray]:
        """At most ``splits`` regions, ascending, and the dimension in which to halve each."""
        regions = self.leaves()
        large = regions.volume >= smallest_volume
        error = np.where(large, regions.gain * regions.volume, 0)
        worst = _largest(error, splits - int(splits * EXPLORE))
        # What no node has seen has no error: the largest regions are halved too, in their longest edge.
        # Of those equally large, and there are many, the worst.
        unseen = regions.volume * (1 + 0.25 * error / max(error.max(), 1e-300))
        unseen[~large | (regions.longest < 0)] = 0
        unseen[worst] = 0
        unseen = _largest(unseen, int(splits * EXPLORE) if worst.size else splits)
        chosen = np.concatenate([worst, unseen])
        axis = np.concatenate([regions.axis[worst], regions.longest[unseen]])
        order = np.argsort(chosen)
        return chosen[order], axis[order]

    def _reserve(self, count: int) -> None:
        """Room for so many regions."""
        r = self.regions
        if len(r) >= count:
            return
        room = max(2 * len(r), count, 256)

        def grown(array: np.ndarray, axis: int) -> np.ndarray:
            shape = list(array.shape)
            shape[axis] = room
            out = np.empty(shape, array.dtype)
            out[(slice(None),) * axis + (slice(0, array.shape[axis]),)] = array
            return out

        self.regions = Regions(
            grown(r.start, 1),
            grown(r.size, 1),
            grown(r.nodes, 0),
            grown(r.volume, 0),
            grown(r.density, 0),
            grown(r.axis, 0),
            grown(r.gain, 0),
            grown(r.longest, 0),
            grown(r.surprise, 1),
        )

    def _between(self, part: tuple[int, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Where halving regions (n,) in dimension d wants nodes, 3 along d becoming 5; and their keys.

        part : d and the regions. Returns (m, n * 2 * faces) and (n * 2 * faces,).
        """
        d, chosen = part
        r, m = self.regions, self.dimensions
        count, faces = len(chosen), 3 ** (m - 1)
        offset = np.indices((3,) * (m - 1)).reshape(m - 1, faces)
        start, log = r.start[:, chosen], r.size[:, chosen].astype(np.int64)
        place = np.empty((m, count, 2, faces), np.int64)
        others = [i for i in range(m) if i != d]
        for row, i in enumerate(others):
            place[i] = (start[i][:, None] + (offset[row] << (log[i][:, None] - 1)))[:, None, :]
        quarters = np.array([1, 3]) << (log[d][:, None] - 2)
        place[d] = (start[d][:, None] + quarters)[:, :, None]
        place = place.reshape(m, -1)
        return place, self._key(place)

    def _halve(self, work: tuple[tuple[int, np.ndarray], np.ndarray, int]) -> None:
        """Halve n regions in dimension d: the lower halves take their place, the upper ones go elsewhere.

        work : d and the regions, (n, 2 * faces) slots of the nodes in `_between`, and where the upper halves
            begin.
        """
        (d, chosen), new, above = work
        r, m = self.regions, self.dimensions
        count, faces = len(chosen), 3 ** (m - 1)
        new = new.reshape(count, 2, faces)
        old = np.moveaxis(r.nodes[chosen].reshape(count, *(3,) * m), 1 + d, 1).reshape(count, 3, faces)
        line = np.stack([old[:, 0], new[:, 0], old[:, 1], new[:, 1], old[:, 2]], axis=1)

        def back(nodes: np.ndarray) -> np.ndarray:
            return np.moveaxis(nodes.reshape(count, 3, *(3,) * (m - 1)), 1, 1 + d).reshape(count, 3**m)

        upper = slice(above, above + count)
        r.surprise[:, upper] = r.surprise[:, chosen]
        r.surprise[d, chosen], r.surprise[d, upper] = self._surprises(old, new)
        r.size[d, chosen] -= 1
        r.volume[chosen] *= 0.5
        r.nodes[chosen] = back(line[:, :3])
        r.start[:, upper] = r.start[:, chosen]
        r.start[d, upper] += np.left_shift(1, r.size[d, chosen], dtype=np.int64)
        r.size[:, upper] = r.size[:, chosen]
        r.volume[upper] = r.volume[chosen]
        r.nodes[upper] = back(line[:, 2:])
        self._judge(chosen)
        self._judge(np.arange(above, above + count))

    def _surprises(self, old: np.ndarray, new: np.ndarray) -> np.ndarray:
        """(2, n) mean distance of new nodes (n, 2, faces) from the quadratics through (n, 3, faces)."""
        out = np.zeros((2, len(old)))
        weights = face_weights(self.dimensions - 1)
        for channel in self.store.values:
            low, middle, high = (channel.take(old[:, i]) for i in range(3))
            for side, (near, far) in enumerate(((low, high), (high, low))):
                said = 0.375 * near + 0.75 * middle - 0.125 * far
                out[side] += weighted(np.abs(channel.take(new[:, side]) - said), weights)
        return out

    def _judge(self, some: np.ndarray) -> None:
        """Nested errors of some regions (n,), few enough for the memory."""
        r = self.regions
        errors = nested_errors(self.store.values, r.nodes[some], self.dimensions)
        surprise = r.surprise[:, some]
        # A ratio, so that a power of two in the integrand is the same one here, to the last bit.
        less = surprise < errors
        errors[less] *= (surprise[less] / errors[less]) ** TRUST
        r.density[some] = errors.max(axis=0)
        final = r.size[:, some] <= self._smallest[:, None]
        errors[final] = 0
        r.axis[some] = errors.argmax(axis=0)
        r.gain[some] = errors.max(axis=0)
        edge = np.ldexp(1.0, r.size[:, some].astype(np.int64)) / self._full[:, None]
        edge[final] = 0
        longest = edge.max(axis=0)
        worst = np.where(edge == longest, errors, -1).argmax(axis=0)
        r.longest[some] = np.where(longest > 0, worst, -1)


def nested_errors(values: np.ndarray, nodes: np.ndarray, m: int) -> np.ndarray:
    """(m, R) |Simpson - trapezoid| in each dimension, as means over regions, summed over channels.

    Magnitudes are taken before the other dimensions are integrated, so that what has a changing sign
    does not cancel.
    """
    out = np.zeros((m, len(nodes)))
    weights = face_weights(m - 1)
    nodes = np.ascontiguousarray(nodes.T)
    for channel in values:
        v = channel.take(nodes)
        for d in range(m):
            low, middle, high = np.moveaxis(v.reshape(3**d, 3, -1, nodes.shape[1]), 1, 0)
            bend = middle + middle
            bend -= low
            bend -= high
            np.abs(bend, out=bend)
            out[d] += np.einsum("f,fr->r", weights, bend.reshape(len(weights), -1))
    return out / 3
