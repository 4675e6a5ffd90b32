# SPDX-License-Identifier: GPL-3.0-or-later
"""What closures say of N points of one material, gathered."""

from __future__ import annotations

import numpy as np

from ..bsdf.lobe import Lobe

LARGEST = np.float32(1e30)
"""Radiance beyond which products of a colour and a strength are cut, before they overflow."""


class SurfaceTerms:
    """Filled by `closures.Closure.shade`.

    wants_lobes : False where only emission and transparency are asked for, as by shadow rays.
    lobes : terms of the BSDF, each with N lanes.
    emission : (3, N) radiance, or (3, 1) 0. transparency : (3, N) what passes straight on, or (3, 1).
    holdout : (N,) or () how much of alpha is cut out.
    """

    def __init__(self, wants_lobes: bool = True) -> None:
        self.wants_lobes = wants_lobes
        self.lobes: list[Lobe] = []
        self.emission = np.zeros((3, 1), np.float32)
        self.transparency = np.zeros((3, 1), np.float32)
        self.holdout = np.float32(0)

    def add(self, lobe: Lobe) -> None:
        self.lobes.append(lobe)

    def emit(self, radiance: np.ndarray) -> None:
        self.emission = self.emission + np.clip(radiance, -LARGEST, LARGEST)

    def transmit(self, weight: np.ndarray) -> None:
        """weight : (3, 1), (3, N), () or (N,)."""
        self.transparency = self.transparency + weight

    def hold_out(self, weight: np.ndarray) -> None:
        self.holdout = self.holdout + weight
