# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and shadow linking: which meshes a light lights, and which cast shadows in its light."""

from __future__ import annotations

from dataclasses import dataclass

NO_SHADOW = frozenset({-1})
"""Blockers of a light that casts no shadow: not even fog is between it and what it lights, as in Cycles."""


@dataclass(frozen=True)
class Linking:
    """What a light, or a mesh that emits, is linked to.

    receivers : the sets (`Mesh.light_set`, `Volume.light_set`) that it lights; None for all.
    blockers : the sets (`Mesh.shadow_set`) that cast shadows in its light; None for all.
    fog : False lights no fog.
    """

    receivers: frozenset[int] | None = None
    blockers: frozenset[int] | None = None
    fog: bool = True

    def lights(self, light_set: int) -> bool:
        """Whether it lights a set of meshes."""
        return self.receivers is None or light_set in self.receivers

    def lights_volume(self, light_set: int) -> bool:
        """Whether it lights a set of volumes."""
        return self.fog and self.lights(light_set)
