# SPDX-License-Identifier: GPL-3.0-or-later
"""Which light a sample goes to.

A light is chosen in proportion to a quick estimate of the unshadowed irradiance that it gives the shaded
point itself, and of how much of that a glossy surface reflects (`light_estimates`, `highlights`). Where the
lights are too many for that, those that stand for all in a cell of the picture (`light_clusters`) are weighed
at every point, so that the cost of a sample hardly depends on the number of lights. A part of the chances is
the same for all lights, less for those that should give a point nothing, so that none is ever missed: the
estimate is unbiased whatever the estimates are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np

from ..geometry.vectors import take
from .highlights import Highlights
from .light_clusters import Clusters
from .light_estimates import Lights

WEIGHED = 32
"""How many lights are all weighed at every point."""

_ALIKE = np.float32(0.05)
"""The part of the chances that all lights have alike."""

_UNLIKELY = np.float32(0.1)
"""What a light has of that where its irradiance was weighed and is none."""

# Lights x points evaluated at once, so that the temporary arrays stay in the cache.
_CHUNK = 1 << 17
_BELOW_ONE = np.float32(1 - 2.0**-24)

Choice = tuple[np.ndarray, np.ndarray, np.ndarray]


class LightChoice(Protocol):
    """A discrete distribution over lights at every shaded point."""

    def choose(
        self,
        position: np.ndarray,
        normal: np.ndarray,
        cell: np.ndarray | None,
        w: np.ndarray,
        kind: np.ndarray | None = None,
        highlights: Highlights | None = None,
    ) -> Choice:
        """Lights (M * S,), their probabilities, and ``w`` stretched over the chosen interval.

        position, normal : (3, M). cell : (M,). w : (M, S) uniform in (0, 1).
        kind : (M,) of the points, by what lights are linked to them (`Links.kinds`); None if they all are.
        highlights : of the points; None if they are not glossy.
        """
        ...

    def pdf(
        self,
        light: np.ndarray,
        position: np.ndarray,
        normal: np.ndarray,
        cell: np.ndarray | None,
        kind: np.ndarray | None = None,
        highlights: Highlights | None = None,
    ) -> np.ndarray:
        """(N,) probabilities with which `choose` takes ``light`` (N,) at points (3, N) of ``cell`` (N,)."""
        ...


class EveryLight:
    """No choice: every light is sampled, all at the same point of primary space, and the sum is one value.

    What is summed is smooth where a choice would jump from light to light (thesis eq. 4.1).
    """


class OneLight:
    """One of several, the same everywhere."""

    def __init__(self, light: int) -> None:
        self._light = light

    def choose(self, position, normal, cell, w, kind=None, highlights=None) -> Choice:
        return np.full(w.size, self._light), np.ones(w.size, np.float32), w.reshape(-1)

    def pdf(self, light, position, normal, cell, kind=None, highlights=None) -> np.ndarray:
        return (light == self._light).astype(np.float32)


class WeighedLights:
    """Every light that is linked to a point weighed there."""

    def __init__(
        self, lights: Lights, kinds: np.ndarray | None = None, unlikely: np.float32 = _UNLIKELY
    ) -> None:
        """kinds : (L, C) bool, which lights are linked to points of a kind.

        unlikely : what lights whose irradiance is estimated as 0 have of what all have alike.
        """
        self._lights, self._kinds, self._unlikely = lights, kinds, unlikely
        self._number = np.ones(len(lights), np.float32)

    def choose(self, position, normal, cell, w, kind=None, highlights=None) -> Choice:
        parts = []
        for part in _chunks(0, len(w), len(self._lights)):
            slots = self._slots(position, normal, kind, highlights, part)
            parts.append(slots.pick(w[part])[:3])
        return _joined(parts)

    def pdf(self, light, position, normal, cell, kind=None, highlights=None) -> np.ndarray:
        result = np.empty(len(light), np.float32)
        for part in _chunks(0, len(light), len(self._lights)):
            slots = self._slots(position, normal, kind, highlights, part)
            result[part] = slots.chosen(slots.weight, light[part]) / slots.upper[-1]
        return result

    def _slots(
        self,
        position: np.ndarray,
        normal: np.ndarray,
        kind: np.ndarray | None,
        highlights: Highlights | None,
        part: slice,
    ) -> _Slots:
        irradiance = self._lights.irradiance(position[:, part], normal[:, part])
        if kind is not None:
            irradiance *= self._kinds.take(kind[part], axis=1)
        if highlights is not None:
            self._lights.prefer(irradiance, position[:, part], highlights.take(part))
        return _Slots(irradiance, self._number, self._unlikely)


class CandidateLights:
    """For each of K cells, candidates weighed at every point, and all other lights by these.

    Where lights are linked to some points and not to others, each kind of points has its own.
    """

    def __init__(self, lights: Lights, clusters: Sequence[Clusters], kinds: int = 1) -> None:
        """clusters : cell by cell; of a cell, one for each of the ``kinds`` of points that there are."""
        self._lights, self._kinds = lights, kinds
        self._clusters = clusters

    def choose(self, position, normal, cell, w, kind=None, highlights=None) -> Choice:
        if kind is not None:
            cell = cell * self._kinds + kind
        parts = [
            self._choose(position[:, part], normal[:, part], clusters, _some(highlights, part), w[part])
            for part, clusters in self._parts(cell)
        ]
        return _joined(parts)

    def pdf(self, light, position, normal, cell, kind=None, highlights=None) -> np.ndarray:
        if kind is not None:
            cell = cell * self._kinds + kind
        result = np.empty(len(light), np.float32)
        if (np.diff(cell) < 0).any():
            order = np.argsort(cell, kind="stable")
            position, normal = take(position, order), take(normal, order)
            result[order] = self.pdf(
                light.take(order), position, normal, cell.take(order), None, _some(highlights, order)
            )
            return result
        for part, clusters in self._parts(cell):
            slot, share = clusters.slot.take(light[part]), clusters.share.take(light[part])
            slots, own = self._slots(position[:, part], normal[:, part], clusters, _some(highlights, part))
            whole, first = slots.chosen(slots.weight, slot), slots.chosen(own, slot)
            result[part] = np.where(share > 0, (whole - first) * share, first) / slots.upper[-1]
        return result

    def _parts(self, cell: np.ndarray) -> Iterator[tuple[slice, Clusters]]:
        """Runs of one cell, not too long."""
        starts = np.flatnonzero(np.diff(cell, prepend=-1))
        for first, stop in zip(starts, np.append(starts[1:], len(cell)), strict=True):
            clusters = self._clusters[int(cell[first])]
            for part in _chunks(first, stop, len(clusters.number)):
                yield part, clusters

    def _slots(
        self, position: np.ndarray, normal: np.ndarray, c: Clusters, highlights: Highlights | None
    ) -> tuple[_Slots, np.ndarray]:
        """The slots, and of each (slots, M) the candidate's own part of its weight."""
        count = len(c.candidates)
        own = np.zeros((len(c.number), position.shape[1]), np.float32)
        own[:count] = self._lights.irradiance(position, normal, c.candidates)
        if highlights is not None:
            self._lights.prefer(own[:count], position, highlights, c.candidates)
        weight = np.empty_like(own)
        others = weight[:count]
        np.multiply(own[:count], c.inverse[:, None], out=others)
        np.minimum(others, c.most[:, None], out=others)
        others *= c.mass[:count, None]
        if c.lit is not None:
            own[:count] *= c.lit[:, None]
        others += own[:count]
        weight[count:] = c.mass[count:, None]
        number = c.number.copy()
        number[:count] += 1
        slots = _Slots(weight, number)
        own[:count] += slots.alike
        # With nothing beside it, a candidate has all of its slot, whatever was rounded.
        alone = np.flatnonzero(c.number == 0)
        own[alone] = weight[alone]
        return slots, own

    def _choose(
        self,
        position: np.ndarray,
        normal: np.ndarray,
        c: Clusters,
        highlights: Highlights | None,
        w: np.ndarray,
    ) -> Choice:
        slots, own = self._slots(position, normal, c, highlights)
        slot, chance, w, at = slots.pick(w)
        # The candidate comes first in its slot.
        first = own.reshape(-1).take(at)
        first /= slots.weight.reshape(-1).take(at)
        light = c.candidates.take(slot, mode="clip")
        other = np.flatnonzero(w >= first)
        part = first
        x = (w.take(other) - first.take(other)) / (1 - first.take(other))
        w /= np.maximum(first, np.float32(1e-37))
        if other.size:
            slot, x = slot.take(other), np.minimum(x, _BELOW_ONE).astype(np.float64)
            place = np.searchsorted(c.table, slot + x, side="right")
            place = np.clip(place, c.first.take(slot), c.first.take(slot + 1) - 1)
            light[other] = chosen = c.order.take(place)
            share = c.share.take(chosen)
            part[other] = (1 - first.take(other)) * share
            w[other] = (slot + x - c.table.take(place)) / share + 1
        np.clip(w, 0, _BELOW_ONE, out=w)
        return light, chance * part, w


class _Slots:
    """A distribution over K slots at M points.

    weight : (K, M), ascending sums of which are kept in ``upper``. alike : (M,) what each light has besides,
        all of it or a part.
    """

    def __init__(self, weight: np.ndarray, number: np.ndarray, unlikely: float = 1.0) -> None:
        """weight : (K, M), is overwritten. number : (K,) float32, lights in each slot.

        unlikely : how much of ``alike`` slots of no weight have.
        """
        # Row by row, as a single column would be summed otherwise.
        total = weight[0].copy()
        for row in weight[1:]:
            total += row
        alike = total * (_ALIKE / ((1 - _ALIKE) * number.sum()))
        self.alike = np.where(total > np.float32(1e-30), alike, np.float32(1))
        self.weight, self.upper = weight, np.empty_like(weight)
        part = np.empty_like(total)
        for k, many in enumerate(number):
            np.multiply(self.alike, many, out=part)
            if unlikely < 1:
                part *= np.maximum(weight[k] > 0, np.float32(unlikely))
            weight[k] += part
            np.add(self.upper[k - 1] if k else np.float32(0), weight[k], out=self.upper[k])

    def pick(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Slots (M * S,), their chances, ``w`` (M, S) stretched, and where they are in ``weight``."""
        total = self.upper[-1]
        x = w * total[:, None]
        slot = np.zeros(w.shape, np.uint8)
        for bound in self.upper[:-1]:
            slot += x >= bound[:, None]
        slot = slot.reshape(-1).astype(np.intp)
        lanes = np.repeat(np.arange(len(total)), w.shape[1])
        at = slot * len(total)
        at += lanes
        chosen = self.weight.reshape(-1).take(at)
        stretched = x.reshape(-1) - self.upper.reshape(-1).take(at)
        stretched /= chosen
        stretched += 1
        np.clip(stretched, 0, _BELOW_ONE, out=stretched)
        chosen /= total.take(lanes)
        return slot, chosen, stretched, at

    @staticmethod
    def chosen(weight: np.ndarray, slot: np.ndarray) -> np.ndarray:
        """(M,) of ``weight`` (K, M) what is in one slot (M,) at each point."""
        return weight.reshape(-1).take(slot * len(slot) + np.arange(len(slot)))


def _some(highlights: Highlights | None, rows: np.ndarray | slice) -> Highlights | None:
    return None if highlights is None else highlights.take(rows)


def _chunks(start: int, stop: int, rows: int) -> Iterator[slice]:
    """Parts of so many points that ``rows`` times as many numbers stay in the cache."""
    step = max(1, _CHUNK // rows)
    return (slice(first, min(first + step, stop)) for first in range(start, stop, step))


def _joined(parts: list[Choice]) -> Choice:
    return (
        parts[0] if len(parts) == 1 else tuple(np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    )
