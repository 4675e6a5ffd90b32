# SPDX-License-Identifier: GPL-3.0-or-later
"""A few lights of each cell of the picture that stand for all of many.

In the spirit of LightSlice: J. Ou and F. Pellacini, "LightSlice: Matrix Slice Sampling for the Many-Lights
Problem", 2011. Cells are aligned to the whole frame; pilot rays, whose points come from a cell alone and
which do not enter the picture, see what lights bring there. Each light goes with the one whose light falls
over the cell as its own does, or with those that are as good as constant there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.vectors import take
from ..integration.sobol import hash_combine, unit_float
from .highlights import Highlights
from .light_estimates import Lights

CELL = 32
"""Edge of a cell in pixels."""

PILOT_GRID = 8
"""Pilot rays a cell, along each edge."""

CANDIDATES = 64
"""How many lights of a cell are weighed at every point at most, where there are more."""

TOLERANCE = 0.05
"""The error of all lights' probabilities at the pilots that needs no further candidate."""

_ALIKE_OF_CLUSTER = 0.1
"""The part of the chances of a cluster that its lights have alike."""

_MISSED, _MISSED_WEIGHT = 4, 0.04
"""Every how many pilots a point is added for surfaces that they missed, and what it counts beside them."""

_AT_ONCE = 1 << 20
"""Lights x pilots evaluated at once."""


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
    step = max(1, _AT_ONCE // (len(lights) * pilots))
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
