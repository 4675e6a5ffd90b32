# SPDX-License-Identifier: GPL-3.0-or-later
"""What is integrated: a function on the unit cube, in one stage or in two.

A bin (a pixel) is a cell of a regular grid over the first dimensions. The first stage sees only
those (where does this ray hit?), the rest all others (how much light arrives there?), so that one
expensive first stage may serve many points of the rest. A plain function is the simplest case.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock
from typing import Any, Protocol

import numpy as np


class FirstStage(Protocol):
    """What an integrand keeps of N points of its first dimensions.

    values : (C, N) what needs no further dimension, a term of the integrand; None for 0.
    lane : (M,) ascending, the points at which the rest is not 0; None for all.
    """

    values: np.ndarray | None
    lane: np.ndarray | None


class StagedIntegrand(Protocol):
    """A function with C channels on the unit cube, split into a first stage and the rest.

    rest_dimensions : how many the rest takes; with 0 it is never called.
    staged : whether a first stage is expensive enough to be looked up rather than repeated.
    """

    rest_dimensions: int
    staged: bool

    def first(self, bins: Any, u: np.ndarray) -> FirstStage:
        """The first stage at u (D1, B, S), S points in the unit square of each of B bins."""
        ...

    def rest(
        self, stage: FirstStage, lane: np.ndarray | None, u: np.ndarray
    ) -> tuple[np.ndarray | None, np.ndarray]:
        """The rest at u (D2, M, S), S points for each of the stage's M lanes; N = M S in all.

        lane : (N,) chooses lanes instead, and u is (D2, N).
        Returns (K,) which of the N have a value, None for all in order, and the values (C', K), C' <= C.
        Of several values of one, the sum is meant.
        """
        ...


def values_at(
    integrand: StagedIntegrand, stage: FirstStage, points: int, lane: np.ndarray | None, u: np.ndarray
) -> np.ndarray:
    """The integrand (C, N), densely, at u (D2, N) for points ``lane`` (N,) of a first stage of ``points``.

    lane : None for N / points of u for each point, in order.
    """
    count = u.shape[1]
    if lane is None and stage.lane is None and integrand.rest_dimensions:
        u = u.reshape(len(u), points, -1)
    elif lane is None and count != points:
        lane = np.repeat(np.arange(points), count // points)
    at, which = lane, None
    if stage.lane is not None:
        number = np.full(points, -1, np.int64)
        number[stage.lane] = np.arange(len(stage.lane))
        at = number if lane is None else number.take(lane)
        which = np.flatnonzero(at >= 0)
        at = None if lane is None else at.take(which)
        u = u.take(which, axis=1)
        if lane is None:
            u = u[:, :, None]
    first = stage.values
    if first is not None and lane is not None:
        first = first.take(lane, axis=1)
    if not integrand.rest_dimensions:
        return first
    found, values = integrand.rest(stage, at, u)
    if found is None and which is None and first is None:
        return values
    if found is not None:
        which = found if which is None else which.take(found)
    out = np.zeros((len(values) if first is None else len(first), count), values.dtype)
    if first is not None:
        out[:] = first
    if which is None:
        out[: len(values)] += values
    else:
        for row, value in zip(out, values, strict=False):
            row += np.bincount(which, value, count)
    return out


@dataclass(frozen=True)
class GridCells:
    """B cells of a regular grid: index (K, B) int, and how many there are in each dimension."""

    index: np.ndarray
    shape: tuple[int, ...]

    def __len__(self) -> int:
        return self.index.shape[1]

    def __getitem__(self, part: slice | np.ndarray) -> GridCells:
        return GridCells(self.index[:, part], self.shape)


@dataclass(frozen=True)
class Staged:
    """A function given in two stages, for `integrate`.

    first : u (K, N) of the bins' dimensions -> any object, N points' worth.
    rest : (that object, lane (N',) int, u (D - K, N')) -> (N',) or (C, N') values at those points.
    """

    first: Callable[[np.ndarray], Any]
    rest: Callable[[Any, np.ndarray, np.ndarray], np.ndarray]


@dataclass
class _Points:
    state: Any
    count: int
    values: np.ndarray | None = None
    lane: np.ndarray | None = None


class FunctionOnGrid:
    """`integrate`'s integrand as a `StagedIntegrand` over `GridCells`; what is not finite becomes 0.

    evaluations, non_finite : counts so far.
    """

    def __init__(
        self,
        f: Callable[[np.ndarray], np.ndarray] | Staged,
        ndim: int,
        grid_dimensions: int,
        dtype: np.dtype,
    ) -> None:
        self._f = f
        self.staged = isinstance(f, Staged)
        self._dtype = dtype
        self._counting = Lock()
        self.rest_dimensions = ndim - grid_dimensions
        self.evaluations = self.non_finite = 0

    def first(self, bins: GridCells, u: np.ndarray) -> _Points:
        u = u.reshape(len(u), len(bins), -1)
        at = np.empty(u.shape)
        for d, n in enumerate(bins.shape):
            np.add(u[d], bins.index[d][:, None], out=at[d])
            at[d] /= n
        at = at.reshape(len(at), -1).astype(self._dtype, copy=False)
        if self.staged:
            return _Points(self._f.first(at), at.shape[1])
        if self.rest_dimensions:
            return _Points(at, at.shape[1])
        return _Points(None, at.shape[1], self._checked(self._f(at), at.shape[1]))

    def rest(self, stage: _Points, lane: np.ndarray | None, u: np.ndarray) -> tuple[None, np.ndarray]:
        if lane is None and (self.staged or u.shape[2] > 1):
            lane = np.repeat(np.arange(u.shape[1]), u.shape[2])
        u = u.reshape(len(u), -1)
        count = u.shape[1]
        if self.staged:
            values = self._f.rest(stage.state, lane, u.astype(self._dtype, copy=False))
            return None, self._checked(values, count)
        at = np.empty((len(stage.state) + len(u), count), self._dtype)
        if lane is None:
            at[: len(stage.state)] = stage.state
        else:
            stage.state.take(lane, axis=1, out=at[: len(stage.state)], mode="clip")
        at[len(stage.state) :] = u
        return None, self._checked(self._f(at), count)

    def _checked(self, values: np.ndarray, count: int) -> np.ndarray:
        values = np.asarray(values)
        if values.shape != (count,) and (values.ndim != 2 or values.shape[1] != count):
            raise ValueError(
                f"the integrand returned an array of shape {values.shape} for {count} points, "
                f"wanted ({count},) or (channels, {count})"
            )
        values = values.reshape(-1, count)
        bad = 0
        if not np.isfinite(values.sum()):
            finite = np.isfinite(values).all(axis=0)
            bad = count - int(finite.sum())
            values = np.where(finite, values, 0)
        with self._counting:
            self.evaluations += count
            self.non_finite += bad
        return values
