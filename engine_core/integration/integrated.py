# SPDX-License-Identifier: GPL-3.0-or-later
"""An integrand over its bins' dimensions alone: the rest of it integrated by one net, the same everywhere.

The net is random, another for every seed, so the estimate is unbiased; and what it is wrong by varies as
slowly over the bins as the integrand does. Nodes of a polynomial and samples of its residual see the same
net, so their difference is as small as the polynomial is good, whatever noise a few points would have.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from .integrand import StagedIntegrand
from .point_sets import SobolPoints

BATCH = 32768
"""Points of the rest at once, about."""


@dataclass(frozen=True, eq=False)
class _Values:
    """A first stage that leaves nothing to the rest."""

    values: np.ndarray
    lane: None = None


class Integrated:
    """A `StagedIntegrand` without rest."""

    rest_dimensions = 0
    staged = True

    def __init__(
        self, integrand: StagedIntegrand, points: int, seed: int, channels: int = 3, fixed: bool = True
    ) -> None:
        """points : of the net. channels : of the integrand. fixed : False for another net in each bin."""
        self._integrand, self._channels, self._fixed = integrand, channels, fixed
        self._points = SobolPoints(range(integrand.rest_dimensions), seed, 101 if fixed else 102)
        self._points.prepare(points)
        self._count = points
        self._net = self._points.points(np.zeros(1, np.uint32), 0, points)

    @property
    def counts(self) -> Counter[str]:
        return self._integrand.counts

    def first(self, bins: Any, u: np.ndarray) -> _Values:
        each = u.shape[2]
        step = max(1, BATCH // (each * self._net.shape[2]))
        parts = [
            self._means(bins[low : low + step], u[:, low : low + step]) for low in range(0, len(bins), step)
        ]
        return _Values(np.concatenate(parts, axis=1) if parts else np.zeros((self._channels, 0)))

    def _means(self, bins: Any, u: np.ndarray) -> np.ndarray:
        """(C, B * S) values at u (D, B, S)."""
        count, points = u[0].size, self._count
        stage = self._integrand.first(bins, u)
        out = np.zeros((self._channels, count))
        if stage.values is not None:
            out += stage.values[: self._channels]
        lane = np.arange(count) if stage.lane is None else stage.lane
        if len(lane) == 0:
            return out
        if self._fixed:
            net = np.repeat(self._net, len(lane), axis=1)
        else:
            keys = np.repeat(bins.key(), u.shape[2]) if u.shape[2] > 1 else bins.key()
            net = self._points.points(keys.take(lane), 0, points)
        which, values = self._integrand.rest(stage, None, net)
        if which is None:
            means = values.reshape(len(values), len(lane), points).mean(axis=2, dtype=np.float64)
        else:
            row = which // points
            means = np.stack([np.bincount(row, channel, len(lane)) for channel in values]) / points
        out[: len(means), lane] += means
        return out

    def rest(self, stage: Any, lane: Any, u: np.ndarray) -> Any:
        raise NotImplementedError("there is no rest")
