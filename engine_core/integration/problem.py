# SPDX-License-Identifier: GPL-3.0-or-later
"""What every method is handed: an integrand, its bins, a budget and a pool of workers."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from .integrand import FunctionOnGrid, GridCells
from .result import Result
from .sobol import hash_combine


class Pool:
    """Runs a function over items on threads; results come back in the items' order."""

    def __init__(self, threads: int) -> None:
        """threads : 0 for one a processor."""
        threads = threads or os.cpu_count() or 1
        self._executor = ThreadPoolExecutor(threads) if threads > 1 else None

    def map(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        if self._executor is None:
            return [function(item) for item in items]
        return list(self._executor.map(function, items))

    def close(self) -> None:
        if self._executor is not None:
            self._executor.shutdown()


@dataclass(frozen=True, eq=False)
class Problem:
    """An integrand over a grid of bins.

    samples : evaluations of the integrand for each bin, on average and in all.
    """

    integrand: FunctionOnGrid
    ndim: int
    bins: tuple[int, ...]
    samples: float
    seed: int
    pool: Pool

    def cells(self, index: np.ndarray) -> GridCells:
        """The integrand's bins at index (K, B)."""
        return GridCells(index, self.bins)

    def keys(self, index: np.ndarray) -> np.ndarray:
        """(B,) uint32, what point sets know the bins at index (K, B) by."""
        return hash_combine(*index)

    def all_bins(self) -> np.ndarray:
        """(K, B) the index of every bin, the last dimension fastest."""
        return np.indices(self.bins).reshape(len(self.bins), -1)


class Method(Protocol):
    """A way to integrate."""

    def estimate(self, problem: Problem) -> Result: ...
