# SPDX-License-Identifier: GPL-3.0-or-later
"""What surfaces are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .validation import fail, set_colour


@dataclass(frozen=True, eq=False)
class Material:
    """A Lambertian surface that may also emit.

    reflectance : RGB albedo, at least 0.
    emission : RGB radiance in W/(sr m2), leaving both sides.
    """

    reflectance: Any = 0.8
    emission: Any = 0.0
    name: str = "Material"

    def __post_init__(self) -> None:
        reflectance = set_colour(self, "reflectance")
        if (reflectance < 0).any():
            raise fail(self, "reflectance", f"is {reflectance.tolist()}, wanted no negative value")
        set_colour(self, "emission")
