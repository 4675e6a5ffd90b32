# SPDX-License-Identifier: GPL-3.0-or-later
"""What surfaces are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .validation import fail, set_colour


@dataclass(frozen=True, eq=False)
class Material:
    """A surface: Lambertian, perhaps emitting, or whatever a closure describes.

    reflectance : RGB albedo, at least 0.
    emission : RGB radiance in W/(sr m2), leaving both sides.
    surface : a `shading.closures.Closure`, instead of these two.
    """

    reflectance: Any = 0.8
    emission: Any = 0.0
    name: str = "Material"
    surface: Any = None

    def __post_init__(self) -> None:
        reflectance = set_colour(self, "reflectance")
        if (reflectance < 0).any():
            raise fail(self, "reflectance", f"is {reflectance.tolist()}, wanted no negative value")
        set_colour(self, "emission")
        if self.surface is not None and not callable(getattr(self.surface, "shade", None)):
            raise fail(self, "surface", f"is {self.surface!r}, wanted a closure")
