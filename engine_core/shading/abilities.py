# SPDX-License-Identifier: GPL-3.0-or-later
"""What a closure can do at all, so that nothing is asked of surfaces that cannot have it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .closures import Emission, Holdout, Principled, Transparent
from .values import Value


@dataclass(frozen=True)
class Abilities:
    """emits : radiance of its own. transmits : light straight on. holds_out : cuts a hole into alpha."""

    emits: bool = False
    transmits: bool = False
    holds_out: bool = False

    def __or__(self, other: Abilities) -> Abilities:
        return Abilities(*(getattr(self, f.name) or getattr(other, f.name) for f in fields(self)))


def abilities(closure: Any) -> Abilities:
    """Of a closure with all that it is mixed of; None is black."""
    if isinstance(closure, Emission):
        return Abilities(emits=_may(closure.strength) and _may(closure.color))
    if isinstance(closure, Transparent):
        return Abilities(transmits=_may(closure.color))
    if isinstance(closure, Holdout):
        return Abilities(holds_out=True)
    if isinstance(closure, Principled):
        return Abilities(
            emits=_may(closure.emission_strength) and _may(closure.emission_color),
            transmits=_may(closure.alpha, but=1.0),
        )
    found = Abilities()
    for part in ("first", "second"):
        if hasattr(closure, part):
            found = found | abilities(getattr(closure, part))
    return found


def _may(value: Any, but: float = 0.0) -> bool:
    """Whether a value can be anything ``but`` one number."""
    return isinstance(value, Value) or bool((np.asarray(value, np.float32) != np.float32(but)).any())
