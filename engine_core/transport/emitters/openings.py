# SPDX-License-Identifier: GPL-3.0-or-later
"""The world as it is seen out of a box, through openings in its sides: where most directions to it go.

Who is in a room sees the sky by its windows. A direction leaves the box through one opening, or through none,
so its density is known: that of any direction to the world, and that of the opening that it goes through.
As portals (B. Bitterli, J. Novak, W. Jarosz, "Portal-Masked Environment Map Sampling", 2015), but of
rectangles that are found, need not be right, and share directions with the world by the balance heuristic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...geometry.frame import Frame
from ...geometry.vectors import take
from ...scene import AreaLight
from .area import AreaEmitters
from .base import Sample

OTHERS = np.array([[1, 2], [0, 2], [0, 1]])
"""Of each axis the two others."""

_LEAST, _BELOW_ONE = np.float32(2.0**-24), np.float32(1 - 2.0**-24)

_RARELY = 1e-3
"""Of the largest weight, the least."""

_GRAZING = np.float32(0.05)
"""Cosine that an opening is seen under at least, as far as its chance goes: it is not a point."""


class Everywhere(Protocol):
    """A world that shines from all sides, as points in space see it."""

    def in_space(self, u: np.ndarray) -> Sample:
        """Directions (3, M) to it, of any length, and measures (M,), at u (2, M)."""
        ...

    def pdf_in_space(self, direction: np.ndarray) -> np.ndarray:
        """(M,) densities of directions (3, M)."""
        ...


@dataclass(frozen=True, eq=False)
class Rectangles:
    """K rectangles in the sides of a box, none of which overlap.

    low, high : (3,) float32 corners of the box, in the frame's units.
    side : (K,) of each the axis that it is across, and 3 more if it is in the higher of the two sides.
    first, last : (2, K) float32 of each its corners, along the two other axes in their order.
    """

    low: np.ndarray
    high: np.ndarray
    side: np.ndarray
    first: np.ndarray
    last: np.ndarray

    def __len__(self) -> int:
        return len(self.side)

    def planes(self) -> np.ndarray:
        """(K,) where they are along the axes that they are across."""
        return np.where(self.side >= 3, self.high.take(self.side % 3), self.low.take(self.side % 3))

    def hold(self, position: np.ndarray) -> np.ndarray:
        """(M,) bool, whether points (3, M) are inside of the box."""
        inside = np.ones(position.shape[1], bool)
        for x, low, high in zip(position, self.low, self.high, strict=True):
            inside &= (x > low) & (x < high)
        return inside

    def leaving(
        self, position: np.ndarray, direction: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of directions (3, M) from points (3, M) inside: the side (M,) through which they leave the box,
        where (2, M) along its two axes, and after how many of their lengths (M,).
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = np.where(direction > 0, self.high[:, None], self.low[:, None])
            far = np.where(direction == 0, np.inf, (plane - position) / direction)
        axis, lane = far.argmin(axis=0), np.arange(far.shape[1])
        far, upper = far[axis, lane], direction[axis, lane] > 0
        place = position + direction * far
        return axis + 3 * upper, place[OTHERS.take(axis, axis=0).T, lane], far

    def through(self, position: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(M,) through which of them directions (3, M) leave the box from points (3, M) inside, -1 for none;
        and after how many of their lengths.
        """
        side, place, far = self.leaving(position, direction)
        found = np.full(len(side), -1)
        for k, of_side in enumerate(self.side):
            within = side == of_side
            for at, first, last in zip(place, self.first[:, k], self.last[:, k], strict=True):
                within &= (at >= first) & (at <= last)
            found[within] = k
        return found, far


class Openings:
    """Directions through rectangles, by their solid angles, and others."""

    def __init__(self, rectangles: Rectangles, weight: np.ndarray, share: float) -> None:
        """weight : (K,) how often directions go through each, over what it fills of all of them.
        share : of those from inside of the box, what goes through any.
        """
        self._rectangles, self._share = rectangles, np.float32(share)
        lights = []
        for k, (side, plane) in enumerate(zip(rectangles.side, rectangles.planes(), strict=True)):
            across, size = OTHERS[side % 3], rectangles.last[:, k] - rectangles.first[:, k]
            matrix = np.zeros((4, 4))
            # They shine along -Z, into the box.
            matrix[across, [0, 1]], matrix[side % 3, 2], matrix[3, 3] = 1, 1 if side >= 3 else -1, 1
            matrix[across, 3], matrix[side % 3, 3] = rectangles.first[:, k] + size / 2, plane
            lights.append(AreaLight(power=np.ones(3), light_to_world=matrix, size=size))
        self._figures = AreaEmitters(lights, Frame(np.zeros(3), 1.0))
        self._area = self._figures.size.astype(np.float32)
        self._half = np.sqrt(self._area / np.float32(np.pi))
        self._weight = (self._area * np.maximum(weight, _RARELY * np.max(weight))).astype(np.float32)

    def seen(self, position: np.ndarray) -> np.ndarray:
        """(K, M) float32 weights of rectangles from points (3, M) inside: about solid angles; never 0."""
        found = np.empty((len(self._area), position.shape[1]), np.float32)
        r, planes = self._rectangles, self._rectangles.planes()
        for k, weight in enumerate(found):
            axis, half = int(r.side[k]) % 3, self._half[k]
            height = np.abs(position[axis] - planes[k])
            square = height * height
            for x, first, last in zip(position[OTHERS[axis]], r.first[:, k], r.last[:, k], strict=True):
                beside = x - (first + last) / 2
                beside *= beside
                square += beside
            square += half * half
            # Area, over the squared distance, times the cosine that it is seen under.
            height += np.float32(0.2) * half
            np.sqrt(square, out=weight)
            np.divide(height, weight, out=weight)
            weight += _GRAZING
            weight *= self._weight[k]
            weight /= square
        return found

    def sample(self, world: Everywhere, position: np.ndarray, u: np.ndarray) -> Sample:
        """Directions (3, M), of any length, from points (3, M) in space at u (2, M), and densities (M,)."""
        position = position.astype(np.float32, copy=False)
        inside = self._rectangles.hold(position)
        through = inside & (u[0] < self._share)
        direction, density = np.empty((3, u.shape[1]), np.float32), np.empty(u.shape[1], np.float32)
        rows = np.flatnonzero(~through)
        if rows.size:
            at, v, inside = take(position, rows), take(u, rows), inside.take(rows)
            v[0] = np.where(inside, (v[0] - self._share) / (1 - self._share), v[0])
            np.clip(v[0], _LEAST, _BELOW_ONE, out=v[0])
            to, _ = world.in_space(v)
            direction[:, rows], density[rows] = to, self._pdf(world, at, to, inside)
        rows = np.flatnonzero(through)
        if rows.size:
            at, v = take(position, rows), take(u, rows)
            v[0] /= self._share
            which, chance, v[0] = self._chosen(at, v[0])
            to, measure = self._figures.sample(which, at, None, v[0], v)
            direction[:, rows] = to
            # What is seen edge-on is no direction.
            measure *= self._area.take(which)
            some = measure > 0
            of_rectangle = np.where(some, chance / np.where(some, measure, 1), 0)
            density[rows] = self._mixed(of_rectangle, world.pdf_in_space(to)) * some
        return direction, density

    def pdf(self, world: Everywhere, position: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(M,) with which `sample` returns directions (3, M), of any length."""
        position = position.astype(np.float32, copy=False)
        return self._pdf(world, position, direction, self._rectangles.hold(position))

    def _chosen(self, position: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rectangles (M,) by u (M,), their chances, and what that leaves of u."""
        below = np.cumsum(self.seen(position), axis=0)
        total = below[-1]
        u = u * total
        which, start, end = np.zeros(len(u), np.intp), np.zeros(len(u), np.float32), below[0].copy()
        for low, high in zip(below[:-1], below[1:], strict=True):
            beyond = u >= low
            which += beyond
            np.copyto(start, low, where=beyond)
            np.copyto(end, high, where=beyond)
        end -= start
        u -= start
        u /= end
        return which, end / total, np.clip(u, _LEAST, _BELOW_ONE, out=u)

    def _mixed(self, of_rectangle: np.ndarray, of_all: np.ndarray) -> np.ndarray:
        return self._share * of_rectangle + (1 - self._share) * of_all

    def _pdf(
        self, world: Everywhere, position: np.ndarray, direction: np.ndarray, inside: np.ndarray
    ) -> np.ndarray:
        density = world.pdf_in_space(direction)
        rows = np.flatnonzero(inside)
        if rows.size == 0:
            return density
        at, to = take(position, rows), take(direction, rows)
        which, far = self._rectangles.through(at, to)
        of_rectangle, some = np.zeros(len(rows), np.float32), np.flatnonzero(which >= 0)
        if some.size:
            which, at = which.take(some), take(at, some)
            weight = self.seen(at)
            chance = weight[which, np.arange(len(some))] / weight.sum(axis=0)
            of_rectangle[some] = chance * self._figures.pdf(which, at, None, take(to, some) * far.take(some))
        density[rows] = self._mixed(of_rectangle, density.take(rows))
        return density
