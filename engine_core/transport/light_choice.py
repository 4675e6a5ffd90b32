# SPDX-License-Identifier: GPL-3.0-or-later
"""Which light a sample goes to.

A light is chosen in proportion to a quick estimate of the unshadowed irradiance that it gives the
shaded point itself. Where the lights are too many for that, the picture is parted into cells, aligned
to the whole frame; pilot rays through each cell, whose points come from the cell alone and which do
not enter the picture, find the lights that matter there. Those are weighed at every point, all the
others together by their mean in the cell. A part of the chances is the same for all lights, so that
none is ever missed: the estimate is unbiased whatever the estimates are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

import numpy as np

from .emitters import Emitters

CELL = 32
"""Edge of a cell in pixels."""

PILOT_GRID = 8
"""Pilot rays a cell, along each edge."""

WEIGHED = 64
"""How many lights are weighed at every point."""

_ALIKE = 0.05
"""The part of the chances that all lights have alike."""

# Lights x points evaluated at once, so that the temporary arrays stay in the cache.
_CHUNK = 1 << 17

Choice = tuple[np.ndarray, np.ndarray, np.ndarray]


class LightChoice(Protocol):
    """A discrete distribution over lights at every shaded point."""

    def choose(
        self, position: np.ndarray, normal: np.ndarray, cell: np.ndarray | None, w: np.ndarray
    ) -> Choice:
        """Lights (M * S,), their probabilities, and ``w`` stretched over the chosen interval.

        position, normal : (3, M). cell : (M,) ascending. w : (M, S) uniform in (0, 1).
        """
        ...

    def pdf(
        self, light: np.ndarray, position: np.ndarray, normal: np.ndarray, cell: np.ndarray | None
    ) -> np.ndarray:
        """(N,) probabilities with which `choose` takes ``light`` (N,) at points (3, N) of ``cell`` (N,)."""
        ...


class Lights:
    """All lights of a scene, numbered group after group."""

    def __init__(self, groups: Sequence[Emitters]) -> None:
        self.groups = tuple(groups)
        self.first = np.cumsum([0] + [len(group) for group in groups])

    def __len__(self) -> int:
        return int(self.first[-1])

    def irradiance(
        self, position: np.ndarray, normal: np.ndarray, which: np.ndarray | None = None
    ) -> np.ndarray:
        """(L', M) estimates at points (3, M) of all lights, or of ``which`` (L',), ascending."""
        if which is None:
            parts = [group.irradiance(position, normal) for group in self.groups]
        else:
            cuts = np.searchsorted(which, self.first)
            parts = [
                group.irradiance(position, normal, which[low:high] - start)
                for group, start, low, high in zip(
                    self.groups, self.first[:-1], cuts[:-1], cuts[1:], strict=True
                )
                if low < high
            ]
        estimate = np.concatenate(parts, axis=0)
        if not np.isfinite(estimate.sum()):
            np.nan_to_num(estimate, copy=False, posinf=0)
        return estimate


class WeighedLights:
    """Every light weighed at every point."""

    def __init__(self, lights: Lights) -> None:
        self._lights = lights

        self._chances = np.full(len(lights), 1 / max(len(lights), 1))

    def choose(self, position, normal, cell, w) -> Choice:
        parts = []
        for part in self._parts(len(w)):
            weight = self._lights.irradiance(position[:, part], normal[:, part])
            parts.append(_choose(weight, self._chances, w[part]))
        return _joined(parts)

    def pdf(self, light, position, normal, cell) -> np.ndarray:
        result = np.empty(len(light), np.float32)
        for part in self._parts(len(light)):
            weight = self._lights.irradiance(position[:, part], normal[:, part])
            result[part] = _pdf(weight, self._chances, light[part])
        return result

    def _parts(self, count: int) -> Iterator[slice]:
        step = max(1, _CHUNK // len(self._lights))
        return (slice(start, min(start + step, count)) for start in range(0, count, step))


class EveryLight:
    """No choice: every light is sampled, all at the same point of primary space, and the sum is one value.

    What is summed is smooth where a choice would jump from light to light (thesis eq. 4.1).
    """


class CandidateLights:
    """For each of K cells, the lights that matter there weighed at every point, the others by their mean."""

    def __init__(self, lights: Lights, mean: np.ndarray) -> None:
        """mean : (K, L) irradiance of every light over the cell, in some mean."""
        count = len(lights)
        self._lights = lights
        self._candidates = np.sort(np.argpartition(-mean, WEIGHED, axis=1)[:, :WEIGHED], axis=1)
        rest = mean.copy()
        np.put_along_axis(rest, self._candidates, 0, axis=1)
        self._rest = rest.sum(axis=1)
        alike = np.ones_like(rest)
        np.put_along_axis(alike, self._candidates, 0, axis=1)
        alike /= count - WEIGHED
        total = self._rest[:, None]
        pdf = np.where(total > 0, 0.5 * rest / np.where(total > 0, total, 1) + 0.5 * alike, alike)
        self._pdf = pdf.astype(np.float32)
        cdf = np.cumsum(pdf, axis=1, dtype=np.float64)
        self._cdf = cdf / cdf[:, -1:]
        self._chances = np.append(np.full(WEIGHED, 1 / count), 1 - WEIGHED / count)

    def choose(self, position, normal, cell, w) -> Choice:
        parts = [
            self._choose(position[:, part], normal[:, part], row, w[part]) for part, row in self._parts(cell)
        ]
        return _joined(parts)

    def pdf(self, light, position, normal, cell) -> np.ndarray:
        result = np.empty(len(light), np.float32)
        for part, row in self._parts(cell):
            candidates, chosen = self._candidates[row], light[part]
            slot = np.searchsorted(candidates, chosen)
            slot[candidates.take(slot, mode="clip") != chosen] = WEIGHED
            weight = self._weight(position[:, part], normal[:, part], row)
            # What is no candidate's chance is the rest's, and the light's share of it.
            share = np.where(slot == WEIGHED, self._pdf[row].take(chosen), np.float32(1))
            result[part] = _pdf(weight, self._chances, slot) * share
        return result

    def _parts(self, cell: np.ndarray) -> Iterator[tuple[slice, int]]:
        """Runs of one cell, not too long."""
        starts = np.flatnonzero(np.diff(cell, prepend=-1))
        step = _CHUNK // WEIGHED
        for first, stop in zip(starts, np.append(starts[1:], len(cell)), strict=True):
            for start in range(first, stop, step):
                yield slice(start, min(start + step, stop)), int(cell[first])

    def _weight(self, position: np.ndarray, normal: np.ndarray, cell: int) -> np.ndarray:
        weight = np.empty((WEIGHED + 1, position.shape[1]), np.float32)
        weight[:-1] = self._lights.irradiance(position, normal, self._candidates[cell])
        weight[-1] = self._rest[cell]
        return weight

    def _choose(self, position: np.ndarray, normal: np.ndarray, cell: int, w: np.ndarray) -> Choice:
        slot, pdf, w = _choose(self._weight(position, normal, cell), self._chances, w)
        light = np.append(self._candidates[cell], 0).take(slot)
        others = np.flatnonzero(slot == WEIGHED)
        if others.size:
            cdf, x = self._cdf[cell], w[others].astype(np.float64)
            chosen = np.searchsorted(cdf, x, side="right")
            # Rounding may point at the table's end, or at a candidate, which has no part in it.
            chosen = np.minimum(chosen, int(np.flatnonzero(self._pdf[cell])[-1]))
            light[others] = chosen
            share = self._pdf[cell].take(chosen)
            stretched = (x - cdf.take(chosen)) / share + 1
            pdf[others] *= share
            w[others] = np.clip(stretched, 0, np.float32(1 - 2.0**-24))
        return light, pdf, w


def _choose(weight: np.ndarray, chances: np.ndarray, w: np.ndarray) -> Choice:
    """Slots (M * S,) in proportion to ``weight`` (L, M), ``_ALIKE`` of the time to ``chances`` (L,).

    Overwrites ``weight``.
    """
    _mix(weight, chances)
    upper = np.empty_like(weight)
    upper[0] = weight[0]
    for before, here, out in zip(upper[:-1], weight[1:], upper[1:], strict=True):
        np.add(before, here, out=out)
    total = upper[-1]
    x = w * total[:, None]
    slot = np.zeros(w.shape, np.uint8)
    for bound in upper[:-1]:
        slot += x >= bound[:, None]
    slot = slot.reshape(-1).astype(np.intp)
    flat = slot * len(total) + np.repeat(np.arange(len(total)), w.shape[1])
    chosen = weight.reshape(-1).take(flat)
    stretched = x.reshape(-1) - upper.reshape(-1).take(flat)
    stretched /= chosen
    stretched += 1
    np.clip(stretched, 0, np.float32(1 - 2.0**-24), out=stretched)
    return slot, chosen / np.repeat(total, w.shape[1]), stretched


def _pdf(weight: np.ndarray, chances: np.ndarray, slot: np.ndarray) -> np.ndarray:
    """(M,) probabilities with which `_choose` takes ``slot`` (M,). Overwrites ``weight``."""
    _mix(weight, chances)
    chosen = weight.reshape(-1).take(slot * len(slot) + np.arange(len(slot)))
    return chosen / weight.sum(axis=0)


def _mix(weight: np.ndarray, chances: np.ndarray) -> None:
    """Adds to ``weight`` (L, M) what all lights have alike."""
    total = weight.sum(axis=0)
    dark = total <= np.float32(1e-37)
    if dark.any():
        weight[:, dark] = chances.astype(np.float32)[:, None]
        total = np.where(dark, np.float32(1), total)
    weight += np.outer(chances, total * (_ALIKE / (1 - _ALIKE))).astype(np.float32)


def _joined(parts: list[Choice]) -> Choice:
    return (
        parts[0] if len(parts) == 1 else tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    )


def mean_irradiance(
    lights: Lights,
    position: np.ndarray,
    normal: np.ndarray,
    found: np.ndarray,
    between: Callable[[], None] = lambda: None,
) -> np.ndarray:
    """(K, L) irradiance of every light over the pilots of each cell, 0 without any.

    The mean and the largest value in equal parts: a light that only a corner of the cell sees counts.

    position, normal : (3, K, P) float32, P pilots a cell. found : (K, P) bool, which of them hit.
    between : called now and then; may raise, to give up.
    """
    cells, pilots = found.shape
    result = np.zeros((cells, len(lights)), np.float32)
    step = max(1, 8 * _CHUNK // (len(lights) * pilots))
    # Each cell is summed over its own pilots alone, in one order, so that its distribution is the same
    # whatever other cells it is computed with.
    for start in range(0, cells, step):
        between()
        part = slice(start, start + step)
        where = (position[:, part].reshape(3, -1), normal[:, part].reshape(3, -1))
        estimate = lights.irradiance(*where).reshape(len(lights), -1, pilots) * found[part]
        count = np.maximum(found[part].sum(axis=1), 1).astype(np.float32)
        result[part] = (0.5 * estimate.sum(axis=2) / count + 0.5 * estimate.max(axis=2)).T
    return result
