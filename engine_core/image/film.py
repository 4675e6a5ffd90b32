# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture while it is made, and when it is done."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

FAR = np.float32(1e10)
"""Depth where the camera ray met nothing, as in Cycles."""

LARGEST = 1e37
"""What no pixel exceeds: a picture holds no Inf, however bright the scene."""


@dataclass(eq=False)
class Film:
    """Arrays of the rendered region, row 0 at the bottom.

    combined : (H, W, 4) float32, linear radiance (premultiplied) and alpha.
    depth : (H, W) float32, distance along the view axis of the pixel's first sample; `FAR` if none.
    normal : (H, W, 3) float32, world-space shading normal, mean over the samples.
    sample_count : (H, W) int32, camera rays spent; of control variates, those of the residual.
    control_variate, residual : (H, W, 3) float32, the two terms of control variates' radiance; else 0.
    standard_error : (H, W, 3) float32, of the radiance; inf where nothing is known of it.
    messages : what could not be rendered as asked, one sentence each.
    statistics : counts and seconds by stage, for people (docs/development.md says what each is).
    stopped_by : "samples", "noise", "time" or "cancel".
    """

    combined: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    sample_count: np.ndarray
    control_variate: np.ndarray
    residual: np.ndarray
    standard_error: np.ndarray
    messages: list[str] = field(default_factory=list)
    statistics: dict[str, Any] = field(default_factory=dict)
    stopped_by: str = "samples"

    @classmethod
    def empty(cls, width: int, height: int) -> Film:
        return cls(
            np.zeros((height, width, 4), np.float32),
            np.full((height, width), FAR, np.float32),
            np.zeros((height, width, 3), np.float32),
            np.zeros((height, width), np.int32),
            *(np.zeros((height, width, 3), np.float32) for _ in range(3)),
        )
