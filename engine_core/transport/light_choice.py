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

from collections.abc import Callable, Sequence
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

    def choose(self, position, normal, cell, w) -> Choice:
        step = max(1, _CHUNK // len(self._lights))
        chances = np.full(len(self._lights), 1 / len(self._lights))
        parts = []
        for start in range(0, len(w), step):
            part = slice(start, start + step)
            weight = self._lights.irradiance(position[:, part], normal[:, part])
            parts.append(_choose(weight, chances, w[part]))
        return _joined(parts)


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
        starts = np.flatnonzero(np.diff(cell, prepend=-1))
        step = _CHUNK // WEIGHED
        parts = []
        for first, stop in zip(starts, np.append(starts[1:], len(w)), strict=True):
            for start in range(first, stop, step):
                part = slice(start, min(start + step, stop))
                parts.append(self._choose(position[:, part], normal[:, part], int(cell[first]), w[part]))
        return _joined(parts)

    def _choose(self, position: np.ndarray, normal: np.ndarray, cell: int, w: np.ndarray) -> Choice:
        weight = np.empty((WEIGHED + 1, len(w)), np.float32)
        weight[:-1] = self._lights.irradiance(position, normal, self._candidates[cell])
        weight[-1] = self._rest[cell]
        slot, pdf, w = _choose(weight, self._chances, w)
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
    total = weight.sum(axis=0)
    dark = total <= np.float32(1e-37)
    if dark.any():
        weight[:, dark] = chances.astype(np.float32)[:, None]
        total = np.where(dark, np.float32(1), total)
    weight += np.outer(chances, total * (_ALIKE / (1 - _ALIKE))).astype(np.float32)
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
