# SPDX-License-Identifier: GPL-3.0-or-later
"""Patches of a surface that emits: what they show of themselves, and which one of a light a sample goes to.

What a point gets of a patch, unshadowed, goes about as the area that the patch shows it over the square of
their distance. A patch whose normals turn shows some of its area to all sides; one of a closed body shows
nothing to points behind it, unless they are inside. The choice goes by that, and a part of the chances is by
the area alone, so that none is ever missed.
"""

from __future__ import annotations

import numpy as np

from ...geometry.vectors import dot, take
from .mesh_pieces import highest_bit

PATCHES = 8
"""Into which a light, and each of them, is parted at most: octants."""

NEAR = 2.0
"""How far off a patch is near, over how far it extends: its parts' distances are alike beyond."""

BACK = 0.05
"""What is expected of the back of a closed body, over what its front sends: a point may be inside after all,
and has half as much noise again then where something else shines there."""

_BY_AREA = np.float32(0.05)
"""Part of the chances that go by the area alone."""

_LEAST_SHARE = 1e-8
"""Of a light's area, of patches within which pieces are chosen by a table of the whole light."""

# Points whose chances are found at once, so that the temporary arrays stay in the cache.
_CHUNK = 1 << 12

_BELOW_ONE = np.float32(1 - 2.0**-24)
_NEVER = np.float32(1e-37)


class Facing:
    """What patches (...) show of themselves to points.

    centre : (3, ...) float32. reach_squared : (...) float32, of how far from there they extend.
    """

    def __init__(self, centre: np.ndarray, reach: np.ndarray, normal: np.ndarray, back: np.ndarray) -> None:
        """reach : (...) how far from their centres they extend. normal : (3, ...) the mean, of length 1 where
        it does not turn. back : (...) what is expected of the back, over what the front sends.
        """
        turning = np.maximum(1 - dot(normal, normal), 0) / 4
        self.centre, self._normal, self.reach_squared, self._turning, self._back = (
            np.asarray(x).astype(np.float32, order="C")
            for x in (centre, normal, reach * reach, turning, back)
        )

    def shown(
        self, which: np.ndarray, vector: np.ndarray, along: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """What part of their area patches show, and the square of a distance by which that falls off.

        which : indices along the patches' last axis. vector : (3, ...) from them to points.
        along : (3, ...) unit directions of lines of which these are the nearest points, None for the points
            alone. The mean of a cosine over all angles under which a line is seen is as if that part of the
            normal came to the root alone, but for a factor alike for all.
        """
        normal, reach, turning, back = (
            take(x, which) for x in (self._normal, self.reach_squared, self._turning, self._back)
        )
        square = dot(vector, vector)
        height = dot(normal, vector)
        # What is above a patch sees it under many angles, from beside it a flat one is an edge.
        reach = np.maximum(reach, np.float32(1e-30))
        # Far off it is the difference of two infinities, and neither.
        above = np.fmin(np.fmax(2 - (square - height * height) / reach, 0), 1)
        square += reach
        inverse = 1 / square
        cosine = height * np.sqrt(inverse)
        turning = turning + np.float32(0.25) * reach * inverse * above
        if along is not None:
            turning += dot(normal, along) ** 2
        both = np.sqrt(cosine * cosine + turning)
        front = np.float32(0.5) * (cosine + both)
        return front + back * (both - front), square


class Patches:
    """The pieces of L lights, in a tree of patches for each, to choose among those of one.

    A light is parted into patches, and so is each of them, until it is one piece: points that are near it
    choose on among its parts, others take any of its pieces by their area.
    """

    def __init__(
        self, middle: np.ndarray, normal: np.ndarray, area: np.ndarray, reach: np.ndarray,
        back: np.ndarray, first: np.ndarray, code: np.ndarray,
    ) -> None:  # fmt: skip
        """Of E pieces, light after light: middle, normal (3, E), area, reach, back (E,); first (L + 1,);
        code (E,) as `mesh_pieces.Pieces`."""
        of_pieces = middle, normal, area, reach, back
        light = np.repeat(np.arange(len(first) - 1), np.diff(first))
        self._light_of = light
        # One ascending table of all pieces: the number of their light + the share of its area up to them.
        whole = np.bincount(light, area, len(first) - 1)
        share = np.append(0, np.cumsum(area / np.maximum(whole[light], 1e-300)))
        self._up_to = np.append(light + np.clip(share[:-1] - share[first[light]], 0, 1), len(first) - 1)
        self._levels = []
        start, stop = first[:-1], first[1:]
        while len(start):
            level = _Level(of_pieces, code, start, stop, whole.take(light.take(start)))
            self._levels.append(level)
            start, stop = level.start.take(level.parted), level.stop.take(level.parted)

    def choose(self, light: np.ndarray, position: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of lights (M,), for points (3, M), by w (M,): pieces, and by how much their shares of the light's
        area exceed their chances (M,).
        """
        piece, gain = np.empty(len(w), np.intp), np.empty(len(w), np.float32)
        for part in _chunks(len(w)):
            piece[part], gain[part] = self._chosen(light[part], position[:, part], w[part])
        return piece, gain

    def _chosen(
        self, light: np.ndarray, position: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        lanes, row, gain = None, light, np.ones(len(w), np.float32)
        start, stop, left = *np.empty((2, len(w)), np.intp), np.empty(len(w), np.float32)
        for level in self._levels:
            share, chance, near = level.chances(row, position)
            upper, slot = chance.copy(), np.zeros(len(row), np.uint8)
            for k in range(1, PATCHES):
                slot += w >= upper[k - 1]
                upper[k] += upper[k - 1]
            slot = np.minimum(slot.astype(np.intp), level.count.take(row) - 1)
            upper, chance, share = (_of_slot(x, slot) for x in (upper, chance, share))
            w = np.clip(1 - (upper - w) / np.maximum(chance, _NEVER), 0, _BELOW_ONE)
            patch = row * PATCHES + slot
            here = slice(None) if lanes is None else lanes
            gain[here] *= share / np.maximum(chance, _NEVER)
            start[here], stop[here], left[here] = level.start.take(patch), level.stop.take(patch), w
            deeper = level.deeper.take(patch)
            on = np.flatnonzero((deeper >= 0) & _of_slot(near, slot))
            if on.size == 0:
                break
            lanes = on if lanes is None else lanes.take(on)
            row, position, w = deeper.take(on), take(position, on), w.take(on)
        piece = start
        several = np.flatnonzero(stop - start > 1)
        if several.size:
            low, high = start.take(several), stop.take(several) - 1
            bounds = self._up_to.take(low), self._up_to.take(high + 1)
            # What ends a light begins the next.
            at = bounds[0] + left.take(several) * (bounds[1] - bounds[0])
            piece[several] = np.clip(np.searchsorted(self._up_to, at, side="right") - 1, low, high)
        return piece, gain

    def gain(self, piece: np.ndarray, position: np.ndarray) -> np.ndarray:
        """(M,) as `choose` finds it for pieces (M,)."""
        gain = np.empty(len(piece), np.float32)
        for part in _chunks(len(piece)):
            gain[part] = self._gain(piece[part], position[:, part])
        return gain

    def _gain(self, piece: np.ndarray, position: np.ndarray) -> np.ndarray:
        lanes, row, gain = None, self._light_of.take(piece), np.ones(len(piece), np.float32)
        for level in self._levels:
            slot = level.slot.take(piece).astype(np.intp)
            share, chance, near = (_of_slot(x, slot) for x in level.chances(row, position))
            gain[slice(None) if lanes is None else lanes] *= share / np.maximum(chance, _NEVER)
            deeper = level.deeper.take(row * PATCHES + slot)
            on = np.flatnonzero((deeper >= 0) & near)
            if on.size == 0:
                break
            lanes = on if lanes is None else lanes.take(on)
            row, position, piece = deeper.take(on), take(position, on), piece.take(on)
        return gain


class _Level:
    """K patches that are parted into up to `PATCHES` each: row k's have numbers from k * `PATCHES` on.

    start, stop : (K * PATCHES,) their pieces. count : (K,) how many patches there are of each.
    slot : (E,) uint8, which of its row's a piece is in; anything if in none.
    parted : those of several pieces, and deeper : (K * PATCHES,) their rows in the next level, -1 of others.
    """

    def __init__(
        self,
        of_pieces: tuple[np.ndarray, ...],
        code: np.ndarray,
        start: np.ndarray,
        stop: np.ndarray,
        whole: np.ndarray,
    ) -> None:
        """Of E pieces, as `Patches`; start, stop : (K,) ascending, those of the K patches; whole : (K,) areas
        of their lights."""
        many = stop - start
        within = np.arange(many.sum()) - np.repeat(np.cumsum(many) - many, many)
        row, number = np.repeat(np.arange(len(many)), many), within + np.repeat(start, many)
        # By the first octants that they are not all in, or one after another.
        few = many <= PATCHES
        apart = highest_bit(code[start] ^ code[stop - 1])
        shift = 3 * ((np.log2(np.maximum(apart, 1)) + 0.5).astype(np.int64) // 3)
        octant = (code[number] >> shift[row]) & (PATCHES - 1)
        even = np.where(few[row], within, within * PATCHES // many[row])
        own = np.where((few | (apart == 0))[row], even, octant)
        # The first ones are those that there are.
        there = np.bincount(row * PATCHES + own, minlength=len(many) * PATCHES).reshape(-1, PATCHES) > 0
        place = np.cumsum(there, axis=1) - 1
        self.count = there.sum(axis=1)
        self.slot = np.zeros(of_pieces[0].shape[1], np.uint8)
        self.slot[number] = place[row, own]
        patch = row * PATCHES + place[row, own]
        many = np.bincount(patch, minlength=len(start) * PATCHES)
        self.stop = np.repeat(start, PATCHES) + np.cumsum(many.reshape(-1, PATCHES), axis=1).ravel()
        self.start = self.stop - many
        self.parted = np.flatnonzero(many > 1)
        self.deeper = np.full(len(many), -1)
        self.deeper[self.parted] = np.arange(len(self.parted))
        middle, normal, area, reach, back = (x[..., number] for x in of_pieces)
        # A single one extends about half as far in the mean as it does at most.
        reach = np.where(many.take(patch) == 1, 0.5, 1) * reach
        facing, total = facing_of(middle, normal, area, reach, back, patch, len(many))
        shape = len(start), PATCHES
        share = (total.reshape(shape) / np.maximum(total.reshape(shape).sum(axis=1, keepdims=True), 1e-300)).T
        # However small, none is without a chance.
        self._share = np.where(share > 0, np.maximum(share, 1e-30), 0).astype(np.float32, order="C")
        self._facing = Facing(*(np.moveaxis(x.reshape(*x.shape[:-1], *shape), -1, -2) for x in facing))
        self._near = np.float32(1 + NEAR * NEAR) * self._facing.reach_squared
        # Of so small a part of its light the table has no digits left.
        self._near[_LEAST_SHARE * whole > total.reshape(shape).T] = np.inf

    def chances(self, row: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(PATCHES, M) shares of the area, chances, and what is near, of rows (M,) for points (3, M)."""
        share = take(self._share, row)
        vector = position.astype(np.float32)[:, None] - take(self._facing.centre, row)
        shown, square = self._facing.shown(row, vector)
        chance = shown * share
        chance /= square
        # Not by ``sum``, which adds those of a single point in another order.
        total = chance[0].copy()
        for one in chance[1:]:
            total += one
        usable = (total > np.float32(1e-30)) & (total < np.float32(1e30))
        chance *= np.where(usable, (1 - _BY_AREA) / np.where(usable, total, 1), 0)
        chance += np.where(usable, _BY_AREA, 1) * share
        return share, chance, square < take(self._near, row)


def facing_of(
    middle: np.ndarray, normal: np.ndarray, area: np.ndarray, reach: np.ndarray, back: np.ndarray,
    patch: np.ndarray, many: int,
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:  # fmt: skip
    """What `Facing` wants of ``many`` patches (K,), and their areas (K,).

    Of E pieces: middle, normal (3, E), area, reach, back (E,), and which patch (E,) they are of. Patches
    without pieces have area 0.
    """
    total = np.bincount(patch, area, many)

    def mean(x: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(patch, area * row, many) for row in x]) / np.maximum(total, 1e-300)

    centre, turned = mean(middle), mean(normal)
    apart = middle - centre[:, patch]
    far, most = np.zeros((2, many))
    np.maximum.at(far, patch, np.sqrt(dot(apart, apart)) + reach)
    np.maximum.at(most, patch, back)
    return (centre, far, turned, most), total


def _of_slot(a: np.ndarray, slot: np.ndarray) -> np.ndarray:
    """(M,) of ``a`` (K, M), in one slot (M,) each."""
    return a.reshape(-1).take(slot * a.shape[1] + np.arange(a.shape[1]))


def _chunks(count: int):
    return (slice(low, low + _CHUNK) for low in range(0, count, _CHUNK))
