# SPDX-License-Identifier: GPL-3.0-or-later
"""Which light a sample goes to.

A light is chosen in proportion to a quick estimate of the unshadowed irradiance that it gives the
shaded point itself, and of how much of that a glossy surface reflects (`highlights`). Where the lights
are too many for that, the picture is parted into cells, aligned to the whole frame; pilot rays through
each cell, whose points come from the cell alone and which do not enter the picture, find a few lights
that stand for all (in the spirit of LightSlice: J. Ou and F. Pellacini, 2011). Those are weighed at
every point; each other light goes with the one whose light falls over the cell as its own does, or with
those that are as good as constant there. So the cost of a sample hardly depends on the number of lights.
A part of the chances is the same for all lights, less for those that should give a point nothing, so that
none is ever missed: the estimate is unbiased whatever the estimates are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..geometry.vectors import inverse_length, take
from ..integration.sobol import hash_combine, unit_float
from .emitters import Emitters, SunEmitters
from .highlights import Highlights

CELL = 32
"""Edge of a cell in pixels."""

PILOT_GRID = 8
"""Pilot rays a cell, along each edge."""

WEIGHED = 32
"""How many lights are all weighed at every point."""

CANDIDATES = 64
"""How many lights of a cell are weighed at every point at most, where there are more."""

TOLERANCE = 0.05
"""The error of all lights' probabilities at the pilots that needs no further candidate."""

_ALIKE = np.float32(0.05)
"""The part of the chances that all lights have alike."""

_UNLIKELY = np.float32(0.1)
"""What a light has of that where its irradiance was weighed and is none."""

_ALIKE_OF_CLUSTER = 0.1
"""The part of the chances of a cluster that its lights have alike."""

_MISSED, _MISSED_WEIGHT = 4, 0.04
"""Every how many pilots a point is added for surfaces that they missed, and what it counts beside them."""

_LARGEST = np.float32(1e30)
"""What no estimate exceeds, so that their sums are finite."""

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


class Lights:
    """All lights of a scene, numbered group after group.

    centre, reach : (3, L) and (L,) float64, the spheres that hold the lights; 0 and inf of one at infinity.
    """

    def __init__(self, groups: Sequence[Emitters]) -> None:
        self.groups = tuple(groups)
        self.first = np.cumsum([0] + [len(group) for group in groups])
        self.centre, self.reach = np.zeros((3, len(self))), np.full(len(self), np.inf)
        for group, start, stop in zip(self.groups, self.first[:-1], self.first[1:], strict=True):
            if not group.at_infinity:
                self.centre[:, start:stop], self.reach[start:stop] = group.centre, group.reach

        # Where they are, and as seen from points: of those at infinity, in which direction and how wide.
        finite = np.isfinite(self.reach)
        self._middle, self._width = self.centre.astype(np.float32), np.where(finite, self.reach, 1)
        around = ~finite
        for group, start, stop in zip(self.groups, self.first[:-1], self.first[1:], strict=True):
            if isinstance(group, SunEmitters):
                self._middle[:, start:stop], self._width[start:stop] = group.axis, group.sine
                around[start:stop] = False
        self._width = self._width.astype(np.float32)
        self._finite, self._around = finite.astype(np.float32), around

    def __len__(self) -> int:
        return int(self.first[-1])

    def prefer(
        self,
        irradiance: np.ndarray,
        position: np.ndarray,
        highlights: Highlights,
        which: np.ndarray | None = None,
    ) -> None:
        """Weighs irradiance (L', M), as `irradiance` estimates it, by what points (3, M) reflect of it."""
        # Where one light reaches a point, or none, there is no choice. Cones leave few lights to a place.
        rows = np.flatnonzero(irradiance.any(axis=1))
        lanes = np.flatnonzero(((irradiance > 0).sum(axis=0) > 1) & highlights.shiny)
        if lanes.size == 0:
            return
        if lanes.size < irradiance.shape[1]:
            position, highlights = take(position, lanes), highlights.take(lanes)
        some = irradiance
        if (len(rows), len(lanes)) != irradiance.shape:
            some = irradiance[rows[:, None], lanes]
        which = rows if which is None else which.take(rows)
        some *= highlights.preference(some, *self._directions(position, which))
        if some is not irradiance:
            irradiance[rows[:, None], lanes] = some

    def _directions(
        self, position: np.ndarray, which: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `Highlights.preference` takes them: of lights ``which`` (L',) at points (3, M)."""
        finite = self._finite[which, None]
        direction = self._middle[:, which, None] - finite * position[:, None, :]
        inverse = inverse_length(direction.reshape(3, -1)).reshape(direction.shape[1:])
        direction *= inverse
        spread = self._width[which, None] * np.where(finite > 0, inverse, 1)
        return direction, np.float32(0.5) * np.minimum(spread, 1), np.flatnonzero(self._around[which])

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
        estimate = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=0)
        if not estimate.max(initial=0) <= _LARGEST:
            np.nan_to_num(estimate, copy=False, posinf=_LARGEST)
            np.minimum(estimate, _LARGEST, out=estimate)
        return estimate


class EveryLight:
    """No choice: every light is sampled, all at the same point of primary space, and the sum is one value.

    What is summed is smooth where a choice would jump from light to light (thesis eq. 4.1).
    """


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


@dataclass(frozen=True, eq=False)
class Clusters:
    """How the L lights are grouped in a cell: C candidates, each with the lights like it, and a rest.

    A *slot* is a candidate with what goes with it; the rest is the last slot, if there is any.

    candidates : (C,) ascending light numbers.
    slot : (L,) of each light.
    number : (slots,) float32, how many lights each has, candidates not counted.
    mass : (slots,) float32, irradiance of those in the mean over the cell.
    inverse : (C,) float32, 1 / irradiance of a candidate in that mean; most : (C,) their largest ratio.
    share : (L,) float32, a light's part of what goes with its candidate; 0 for candidates.
    order : (L - C,) lights that are no candidates, by their slot; table : (L - C,) float64, slot + share
        of all up to this one. first : (slots + 1,) where each slot begins in these.
    lit : (C,) bool, whether candidates are linked to the points that this is for; None if all are.
    """

    candidates: np.ndarray
    slot: np.ndarray
    number: np.ndarray
    mass: np.ndarray
    inverse: np.ndarray
    most: np.ndarray
    share: np.ndarray
    order: np.ndarray
    table: np.ndarray
    first: np.ndarray
    lit: np.ndarray | None = None

    @staticmethod
    def of(candidates: np.ndarray, slot: np.ndarray, mean: np.ndarray, largest: np.ndarray) -> Clusters:
        """slot : (L,) places in ``candidates`` (C,), C for the rest. mean, largest : (L,) irradiance."""
        lights, count = len(slot), len(candidates)
        own = mean.take(candidates).astype(np.float64)
        inverse = np.where(own > 1e-30, 1 / np.maximum(own, 1e-30), 0)
        other = np.ones(lights, bool)
        other[candidates] = False
        slots = count + int((slot == count).any())
        number = np.bincount(slot[other], minlength=slots)
        mass = np.bincount(slot[other], mean[other], minlength=slots)
        even = 1 / np.maximum(number, 1).take(slot)
        total = mass.take(slot)
        share = np.where(total > 0, mean / np.where(total > 0, total, 1), even)
        share = np.where(other, (1 - _ALIKE_OF_CLUSTER) * share + _ALIKE_OF_CLUSTER * even, 0)
        order = np.flatnonzero(other)
        order = order[np.argsort(slot[order], kind="stable")]
        first = np.append(0, np.cumsum(number))
        here = slot[order]
        up_to = np.append(0, np.cumsum(share[order]))
        return Clusters(
            candidates,
            slot,
            number.astype(np.float32),
            mass.astype(np.float32),
            inverse.astype(np.float32),
            (largest.take(candidates) * inverse).astype(np.float32),
            share.astype(np.float32),
            order,
            here + np.clip(up_to[1:] - up_to.take(first.take(here)), 0, 1),
            first,
        )


def _clusters(irradiance: np.ndarray, weight: np.ndarray) -> list[Clusters]:
    """From pilots: irradiance (K, L, P) of every light at P points of each cell; weight (K, P) of these.

    The mean and the largest value in equal parts are what is called mean here: a light that only a
    corner of the cell sees counts.
    """
    largest = (irradiance * (weight > 0)[:, None, :]).max(axis=2)
    weighed = irradiance * weight[:, None, :]
    total = np.maximum(weight.sum(axis=1, keepdims=True), np.float32(1e-30))
    mean = 0.5 * weighed.sum(axis=2) / total + 0.5 * weighed.max(axis=2)
    chosen, slot, count = _candidates(irradiance, weight / total)
    result = []
    for row in range(len(count)):
        # In ascending order, as `Lights.irradiance` takes them.
        order = np.argsort(chosen[row, : count[row]])
        place = np.empty(count[row] + 1, np.intp)
        place[order] = np.arange(count[row])
        place[-1] = count[row]
        candidates = chosen[row].take(order)
        here = place.take(np.minimum(slot[row], count[row]))
        result.append(Clusters.of(candidates, here, mean[row], largest[row]))
    return result


def _candidates(irradiance: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Candidates (K, C) by falling need, of which light (K, L) each one goes with, and how many (K,) suffice.

    A light goes with the candidate whose irradiance over the pilots is most nearly a multiple of its own,
    or with the rest if it is most nearly constant. The next candidate is always the light that is
    worst served in terms of its probability, until the error of all probabilities is `TOLERANCE`.
    """
    cells, lights, _ = irradiance.shape
    total = irradiance.sum(axis=1, keepdims=True)
    root = np.sqrt(weight)
    profile = irradiance * (root[:, None, :] / np.where(total > 0, total, 1))
    square = np.einsum("klp,klp->kl", profile, profile)
    served = np.einsum("klp,kp->kl", profile, root) ** 2
    most = min(CANDIDATES, lights)
    row = np.arange(cells)
    slot = np.full((cells, lights), most)
    chosen = np.empty((cells, most), np.intp)
    count = np.full(cells, most)
    for number in range(most):
        error = np.maximum(square - served, 0)
        enough = np.sqrt(error).sum(axis=1) <= TOLERANCE
        count[enough & (count > number) & (number > 0)] = number
        if (count <= number).all():
            break
        going = count > number
        error[row[:, None], chosen[:, :number]] = -1
        worst = error.argmax(axis=1)
        chosen[:, number] = worst
        direction = profile[row, worst]
        norm = np.sqrt((direction * direction).sum(axis=1, keepdims=True))
        direction /= np.maximum(norm, np.float32(1e-30))
        fit = np.einsum("klp,kp->kl", profile, direction) ** 2
        better = (fit > served) & going[:, None]
        slot[better] = number
        served[better] = fit[better]
        slot[row[going], worst[going]] = number
        # A candidate needs no service any more, and goes with no other.
        served[row[going], worst[going]] = np.inf
    return chosen, np.where(slot == most, lights, slot), count


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
        total = weight.sum(axis=0)
        alike = total * (_ALIKE / ((1 - _ALIKE) * number.sum()))
        self.alike = np.where(total > np.float32(1e-30), alike, np.float32(1))
        self.weight, self.upper = weight, np.empty_like(weight)
        part = np.empty_like(total)
        for k, many in enumerate(number):
            np.multiply(self.alike, many, out=part)
            if unlikely < 1:
                part[weight[k] == 0] *= unlikely
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


def pilot_points(cell_x: np.ndarray, cell_y: np.ndarray) -> np.ndarray:
    """(2, K, P) float32 jittered points of K cells, in pixels from their corners, for pilot rays."""
    pilot = np.arange(PILOT_GRID**2)
    row, column = np.divmod(pilot, PILOT_GRID)
    step = np.float32(CELL / PILOT_GRID)
    across, up = (hash_combine(cell_x[:, None], cell_y[:, None], pilot, axis) for axis in (71, 72))
    u = np.stack([(column + unit_float(across)) * step, (row + unit_float(up)) * step])
    return u.astype(np.float32)


def clusters_of_cells(
    lights: Lights,
    position: np.ndarray,
    normal: np.ndarray,
    found: np.ndarray,
    between: Callable[[], None] = lambda: None,
    kind: np.ndarray | None = None,
    kinds: np.ndarray | None = None,
    highlights: Highlights | None = None,
) -> list[Clusters]:
    """The clusters of lights in K cells, from what pilots see there.

    position, normal : (3, K, P) float32, P pilots a cell. found : (K, P) bool, which of them hit.
    between : called now and then; may raise, to give up.
    kind : (K, P) of pilots by what is linked to them, kinds : (L, C) as of `Links`: for each cell there are
        clusters for each of the C kinds then; None if all lights are linked to all.
    highlights : of the K * P pilots; None if they are not glossy.
    """
    position, normal, weight = _with_missed(position, normal, found)
    if kind is None:
        return weighed_clusters(lights, position, normal, weight, between, None, highlights)
    parts = []
    for number, lit in enumerate(kinds.T):
        own = weight.copy()
        own[:, : kind.shape[1]] *= np.where(kind == number, 1, np.float32(_MISSED_WEIGHT))
        parts.append(weighed_clusters(lights, position, normal, own, between, lit, highlights))
    return [clusters for of_cell in zip(*parts, strict=True) for clusters in of_cell]


def weighed_clusters(
    lights: Lights,
    position: np.ndarray,
    normal: np.ndarray,
    weight: np.ndarray,
    between: Callable[[], None] = lambda: None,
    lit: np.ndarray | None = None,
    highlights: Highlights | None = None,
) -> list[Clusters]:
    """The clusters of lights in K cells, from pilots (3, K, P) of some weight (K, P) each.

    lit : (L,) bool, which lights are linked to the points that these are for; None if all are.
    highlights : of the first pilots of each cell, in the order of cells; None if they are not glossy.
    """
    cells, pilots = weight.shape
    glossy = 0 if highlights is None else len(highlights.diffuse) // cells
    step = max(1, 8 * _CHUNK // (len(lights) * pilots))
    result = []
    # Nothing is summed over more than one cell, so that a cell's distribution is the same whatever other
    # cells it is computed with.
    for start in range(0, cells, step):
        between()
        part = slice(start, start + step)
        where = (x[:, part].reshape(len(x), -1) for x in (position, normal))
        estimate = lights.irradiance(*where).reshape(len(lights), -1, pilots)
        if lit is not None:
            estimate *= lit[:, None, None]
        if glossy:
            some = estimate[:, :, :glossy].reshape(len(lights), -1)
            here = highlights.take(slice(start * glossy, start * glossy + some.shape[1]))
            lights.prefer(some, position[:, part, :glossy].reshape(3, -1), here)
            estimate[:, :, :glossy] = some.reshape(len(lights), -1, glossy)
        result += _clusters(np.ascontiguousarray(estimate.swapaxes(0, 1)), weight[part])
    return result if lit is None else [replace(c, lit=lit.take(c.candidates)) for c in result]


def _with_missed(
    position: np.ndarray, normal: np.ndarray, found: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pilots and their weights (K, P'), with some of little weight added for surfaces that they missed.

    These lie between two pilots, where something may be whose surface turns any way.
    """
    some = np.arange(0, found.shape[1], _MISSED)
    other = (some + found.shape[1] // 2 + _MISSED // 2) % found.shape[1]
    along = ((np.arange(len(some)) % 4 + np.float32(0.5)) / 4).astype(np.float32)
    here, there = take(position, some), take(position, other)
    between = here + along * (there - here)
    anyhow = np.broadcast_to(_all_ways(len(some)).T[:, None, :], between.shape)
    weight = _MISSED_WEIGHT * (take(found, some) & take(found, other))
    return (
        np.concatenate([position, between], axis=2),
        np.concatenate([normal, anyhow], axis=2),
        np.concatenate([found, weight], axis=1).astype(np.float32),
    )


def _all_ways(count: int) -> np.ndarray:
    """(count, 3) float32 unit vectors, evenly over the sphere (a spiral of golden angles)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1).astype(np.float32)
