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

PATCHES = 8
"""Of a light, at most."""

BACK = 0.05
"""What is expected of the back of a closed body, over what its front sends: a point may be inside after all,
and has half as much noise again then where something else shines there."""

_BY_AREA = np.float32(0.05)
"""Part of the chances that go by the area alone."""

# Points whose chances are found at once, so that the temporary arrays stay in the cache.
_CHUNK = 1 << 12

_BELOW_ONE = np.float32(1 - 2.0**-24)


class Facing:
    """What patches (...) show of themselves to points.

    centre : (3, ...) float32.
    """

    def __init__(self, centre: np.ndarray, reach: np.ndarray, normal: np.ndarray, back: np.ndarray) -> None:
        """reach : (...) how far from their centres they extend. normal : (3, ...) the mean, of length 1 where
        it does not turn. back : (...) what is expected of the back, over what the front sends.
        """
        turning = np.maximum(1 - dot(normal, normal), 0) / 4
        self.centre, self._normal, self._reach, self._turning, self._back = (
            np.asarray(x).astype(np.float32) for x in (centre, normal, reach * reach, turning, back)
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
            take(x, which) for x in (self._normal, self._reach, self._turning, self._back)
        )
        square = dot(vector, vector)
        square += np.maximum(reach, np.float32(1e-30))
        inverse = 1 / square
        cosine = dot(normal, vector)
        cosine *= np.sqrt(inverse)
        # What is near is seen under many angles.
        turning = turning + np.float32(0.25) * reach * inverse
        if along is not None:
            turning += dot(normal, along) ** 2
        both = np.sqrt(cosine * cosine + turning)
        front = np.float32(0.5) * (cosine + both)
        return front + back * (both - front), square


class Patches:
    """The patches of L lights, to choose among those of one.

    start : (L * PATCHES + 1,) where each begins among the pieces that they are made of; light after light.
    """

    def __init__(
        self, middle: np.ndarray, normal: np.ndarray, area: np.ndarray, reach: np.ndarray,
        back: np.ndarray, first: np.ndarray,
    ) -> None:  # fmt: skip
        """Of E pieces, light after light: middle, normal (3, E), area, reach, back (E,); first (L + 1,)."""
        count = np.diff(first)
        edges = first[:-1, None] + count[:, None] * np.arange(PATCHES + 1) // PATCHES
        # The first ones are those that there are.
        few = count[:, None] < PATCHES
        edges = np.where(few, first[:-1, None] + np.minimum(np.arange(PATCHES + 1), count[:, None]), edges)
        self.start = np.append(edges[:, :-1].ravel(), first[-1])
        self._count = np.minimum(count, PATCHES)
        shape = len(count), PATCHES
        facing, total = facing_of(middle, normal, area, reach, back, self.start)
        share = (total.reshape(shape) / np.maximum(total.reshape(shape).sum(axis=1, keepdims=True), 1e-300)).T
        # However small, none is without a chance.
        self._share = np.where(share > 0, np.maximum(share, 1e-30), 0).astype(np.float32)
        self._facing = Facing(*(np.moveaxis(x.reshape(*x.shape[:-1], *shape), -1, -2) for x in facing))

    def choose(
        self, light: np.ndarray, position: np.ndarray, w: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of lights (M,), for points (3, M), by w (M,): patches, numbered light after light; by how much
        their shares of the area exceed their chances (M,); and what that left of w.
        """
        patch, gain, left = np.empty(len(w), np.intp), *np.empty((2, len(w)), np.float32)
        for part in _chunks(len(w)):
            some = light[part]
            share, chance = self._chances(some, position[:, part])
            upper, slot = chance.copy(), np.zeros(len(some), np.uint8)
            for k in range(1, PATCHES):
                slot += w[part] >= upper[k - 1]
                upper[k] += upper[k - 1]
            slot = np.minimum(slot.astype(np.intp), self._count.take(some) - 1)
            upper, chance, share = (_of_slot(x, slot) for x in (upper, chance, share))
            patch[part] = some * PATCHES + slot
            gain[part] = share / chance
            left[part] = np.clip(1 - (upper - w[part]) / chance, 0, _BELOW_ONE)
        return patch, gain, left

    def gain(self, patch: np.ndarray, position: np.ndarray) -> np.ndarray:
        """(M,) as `choose` finds it for patches (M,)."""
        gain = np.empty(len(patch), np.float32)
        for part in _chunks(len(patch)):
            light, slot = np.divmod(patch[part], PATCHES)
            share, chance = (_of_slot(x, slot) for x in self._chances(light, position[:, part]))
            gain[part] = share / chance
        return gain

    def _chances(self, light: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(PATCHES, M) shares of the area, and chances."""
        share = take(self._share, light)
        vector = position.astype(np.float32)[:, None] - take(self._facing.centre, light)
        shown, square = self._facing.shown(light, vector)
        chance = shown * share
        chance /= square
        # Not by ``sum``, which adds those of a single point in another order.
        total = chance[0].copy()
        for row in chance[1:]:
            total += row
        usable = (total > np.float32(1e-30)) & (total < np.float32(1e30))
        chance *= np.where(usable, (1 - _BY_AREA) / np.where(usable, total, 1), 0)
        chance += np.where(usable, _BY_AREA, 1) * share
        return share, chance


def facing_of(
    middle: np.ndarray, normal: np.ndarray, area: np.ndarray, reach: np.ndarray, back: np.ndarray,
    start: np.ndarray,
) -> tuple[tuple[np.ndarray, ...], np.ndarray]:  # fmt: skip
    """What `Facing` wants of patches that begin at pieces ``start`` (K + 1,), and their areas (K,).

    Of E pieces: middle, normal (3, E), area, reach, back (E,). Patches without pieces have area 0.
    """
    patch = np.repeat(np.arange(len(start) - 1), np.diff(start))
    many = len(start) - 1
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
