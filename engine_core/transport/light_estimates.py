# SPDX-License-Identifier: GPL-3.0-or-later
"""What lights bring to shaded points, by quick estimates: irradiance, and what is mirrored of it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.vectors import inverse_length, take
from .emitters import Emitters, SunEmitters
from .highlights import Highlights

_LARGEST = np.float32(1e30)
"""What no estimate exceeds, so that their sums are finite."""


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
