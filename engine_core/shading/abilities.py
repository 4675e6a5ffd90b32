# SPDX-License-Identifier: GPL-3.0-or-later
"""What a closure can do at all, so that nothing is asked of surfaces that cannot have it."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from .closures import Emission, Holdout, Principled, Transparent
from .values import Value


@dataclass(frozen=True)
class Abilities:
    """emits : radiance of its own. varies : not the same everywhere and to all sides. transmits : light
    straight on. holds_out : cuts a hole into alpha. bends : may have a normal that is not the surface's."""

    emits: bool = False
    varies: bool = False
    transmits: bool = False
    holds_out: bool = False
    bends: bool = False

    def __or__(self, other: Abilities) -> Abilities:
        return Abilities(*(getattr(self, f.name) or getattr(other, f.name) for f in fields(self)))


def abilities(closure: Any) -> Abilities:
    """Of a closure with all that it is mixed of; None is black."""
    if isinstance(closure, Emission):
        emits = _may(closure.strength) and _may(closure.color)
        return Abilities(emits, emits and _any_value(closure.strength, closure.color))
    if isinstance(closure, Transparent):
        return Abilities(transmits=_may(closure.color))
    if isinstance(closure, Holdout):
        return Abilities(holds_out=True)
    if isinstance(closure, Principled):
        emits = _may(closure.emission_strength) and _may(closure.emission_color)
        # A coat is above what emits.
        on_the_way = closure.emission_strength, closure.emission_color, closure.alpha
        varies = _any_value(*on_the_way) or _may(closure.coat_weight)
        bends = closure.normal is not None or closure.coat_normal is not None
        return Abilities(emits, emits and varies, transmits=_may(closure.alpha, but=1.0), bends=bends)
    found = Abilities(bends=getattr(closure, "normal", None) is not None)
    for part in ("first", "second"):
        if hasattr(closure, part):
            found = found | abilities(getattr(closure, part))
    if found.emits and _any_value(getattr(closure, "factor", 0.0)):
        found = replace(found, varies=True)
    return found


def _any_value(*values: Any) -> bool:
    return any(isinstance(value, Value) for value in values)


def _may(value: Any, but: float = 0.0) -> bool:
    """Whether a value can be anything ``but`` one number."""
    return isinstance(value, Value) or bool((np.asarray(value, np.float32) != np.float32(but)).any())
