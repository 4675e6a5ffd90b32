# SPDX-License-Identifier: GPL-3.0-or-later
"""What fills space: fog, smoke, glowing air; the same everywhere within its boundary."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .validation import fail, set_array, set_colour


@dataclass(frozen=True, eq=False)
class Volume:
    """A homogeneous participating medium; coefficients are per scene unit, at least 0.

    scattering : (S, 3) RGB scattering coefficients of S phase functions; a colour or a number is one's.
    anisotropy : (S,) their Henyey-Greenstein g, in [-1, 1]: the mean cosine, above 0 forwards.
    absorption : RGB absorption coefficient.
    emission : RGB radiance per unit length, in W/(sr m3).
    light_set : which set it is of that `Linking.receivers` names.
    """

    scattering: Any = 0.0
    absorption: Any = 0.0
    anisotropy: Any = 0.0
    emission: Any = 0.0
    name: str = "Volume"
    light_set: int = 0

    def __post_init__(self) -> None:
        if np.ndim(self.scattering) < 2:
            object.__setattr__(self, "scattering", set_colour(self, "scattering")[None])
        set_array(self, "scattering", (None, 3))
        if np.ndim(self.anisotropy) == 0:
            object.__setattr__(self, "anisotropy", [self.anisotropy])
        set_array(self, "anisotropy", (len(self.scattering),))
        for field in ("absorption", "emission"):
            set_colour(self, field)
        for field in ("scattering", "absorption", "emission"):
            value = getattr(self, field)
            if (value < 0).any():
                raise fail(self, field, f"is {value.tolist()}, wanted no negative value")
        if (np.abs(self.anisotropy) > 1).any():
            raise fail(self, "anisotropy", f"is {self.anisotropy.tolist()}, wanted -1 to 1")

    @property
    def extinction(self) -> np.ndarray:
        """(3,) scattering and absorption together."""
        return self.scattering.sum(axis=0) + self.absorption
