# SPDX-License-Identifier: GPL-3.0-or-later
"""What lights are linked to: which triangles and fogs they light, and what casts shadows in their light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.surfaces import ALL_CAST
from ..geometry.triangles import Triangles
from ..scene import NO_SHADOW, Linking, Scene, Volume

Blockers = Sequence[frozenset[int] | None]
"""The blockers of lights, by number; numbers `ALL_CAST` and `NONE_CAST` first."""


def blockers_of(scene: Scene) -> Blockers:
    """All that `Linking.blockers` are in a scene."""
    found = {light.links.blockers for light in scene.lights} | {m.linking.blockers for m in scene.meshes}
    return [None, NO_SHADOW, *sorted(found - {None, NO_SHADOW}, key=sorted)]


class Links:
    """Of the L lights of a scene.

    blockers : (L,) intp, numbers of what casts shadows in their light.
    in_fog : (L,) bool, whether they light fog.
    all_lit : whether all light all triangles.
    """

    def __init__(
        self,
        linking: Sequence[Linking],
        triangles: Triangles,
        blockers: Blockers = (None, NO_SHADOW),
        volumes: Sequence[Volume] = (),
    ) -> None:
        """blockers : as `blockers_of` the scene. volumes : its fogs."""
        number = {which: k for k, which in enumerate(blockers)}
        self.blockers = np.array([number[links.blockers] for links in linking], np.intp)
        self.in_fog = np.array([lights_fog(links, volumes) for links in linking], bool)
        self._casting = [blockers[k] for k in np.unique(self.blockers)]
        self._set = triangles.light_set
        used = np.unique(self._set).tolist()
        self._lit = np.ones((len(linking), max(used, default=0) + 1), bool)
        for row, links in zip(self._lit, linking, strict=True):
            row[used] = [links.lights(s) for s in used]
        self.all_lit = bool(self._lit.all())

    def casting(self, light: np.ndarray | None) -> np.ndarray | int:
        """Numbers (K,) of the blockers of lights (K,), None for the only one; one if all have the same."""
        if len(self.blockers) == 0 or (self.blockers == self.blockers[0]).all():
            return int(self.blockers[0]) if len(self.blockers) else ALL_CAST
        return self.blockers.take(light)

    def cast_by_all(self, triangles: Triangles) -> np.ndarray | bool:
        """(T,) bool, or a bool for all: which triangles cast shadows in the light of every light."""
        result = True
        for sets in self._casting:
            if sets is not None:
                result = result & np.isin(triangles.shadow_set, list(sets))
        return result

    def lit(self, light: np.ndarray | None, triangle: np.ndarray) -> np.ndarray:
        """(K,) bool, whether lights (K,), None for the only one, light triangles (K,)."""
        return self._lit[0 if light is None else light, self._sets(triangle)]

    def all_to(self, triangle: np.ndarray) -> np.ndarray:
        """(L, K) bool, the same of all lights."""
        return self._lit.take(np.broadcast_to(self._sets(triangle), len(triangle)), axis=1)

    def _sets(self, triangle: np.ndarray) -> np.ndarray | int:
        return self._set.take(triangle) if np.ndim(self._set) else self._set


def lights_fog(links: Linking, volumes: Sequence[Volume]) -> bool:
    """Whether any of some volumes: fogs are integrated together, and what lights one lights all."""
    return any(links.lights_volume(s) for s in {volume.light_set for volume in volumes} or {0})


def linked_to_some_fogs(scene: Scene) -> list[str]:
    """A sentence for each light that should light some fogs and not others."""
    fogs = {volume.light_set for volume in scene.volumes}
    sources = [(f'Light "{light.name}"', light.linking) for light in scene.lights]
    sources += [(f'Mesh "{mesh.name}"', mesh.linking) for mesh in scene.meshes]
    return [
        f"{name} is linked to some fogs and not to others; it lights all of them."
        for name, links in sources
        if len({links.lights_volume(s) for s in fogs}) > 1
    ]
