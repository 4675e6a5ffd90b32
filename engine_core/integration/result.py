# SPDX-License-Identifier: GPL-3.0-or-later
"""What an integration gives back."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass(eq=False)
class Result:
    """The mean of a function over every bin; C channels (1 for a function of one), all float64.

    value : (C, *bins) the estimate.
    standard_error : (C, *bins) of the value, pooled over neighbouring bins; inf where nothing is known.
    control_variate : (C, *bins) H, the exact means of the polynomial approximation; 0 without one.
    residual : (C, *bins) what sampling added to it: value = control_variate + residual.
    sample_count : (*bins) int64, residual samples taken in each bin.
    evaluations : of the function, in all. non_finite : how many of these were, and counted as 0.
    regions : of the control variate.
    statistics : counts and seconds by stage, for people.
    """

    value: np.ndarray
    standard_error: np.ndarray
    control_variate: np.ndarray
    residual: np.ndarray
    sample_count: np.ndarray
    evaluations: int
    non_finite: int
    regions: int = 0
    statistics: dict[str, Any] = field(default_factory=dict)
