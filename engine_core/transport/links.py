# SPDX-License-Identifier: GPL-3.0-or-later
"""What lights are linked to: which triangles and fogs they light, and what casts shadows in their light."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.surfaces import ALL_CAST
from ..geometry.triangles import Triangles
from ..scene import NO_SHADOW, Light, Linking, Material, Mesh, Volume

Blockers = Sequence[frozenset[int] | None]
"""The blockers of lights, by number; numbers `ALL_CAST` and `NONE_CAST` first."""


def blockers_of(lights: Sequence[Light], meshes: Sequence[Mesh] = ()) -> Blockers:
    """All blockers of lights, and of meshes that emit; those of lights have their numbers without meshes."""
    found = [light.links.blockers for light in lights] + [mesh.linking.blockers for mesh in meshes]
    return [*dict.fromkeys([None, NO_SHADOW, *found])]


def linked_emitters(meshes: Sequence[Mesh], materials: Sequence[Material]) -> list[Mesh]:
    """Which meshes emit and are linked to a part of what there is."""
    emits = np.array([(material.emission > 0).any() for material in materials])
    return [mesh for mesh in meshes if mesh.linking != Linking() and emits[mesh.materials].any()]


class Links:
    """Of the L lights of a scene.

    blockers : (L,) intp, numbers of what casts shadows in their light.
    in_fog : (L,) bool, whether they light fog.
    all_lit : whether all light all triangles.
    kinds : (L, C) bool, whether lights light triangles of a kind; what is lit by the same lights is of one.
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
        self._casting = blockers
        self._set = triangles.light_set
        used = np.unique(self._set).tolist() or [0]
        lit = np.array([[links.lights(s) for s in used] for links in linking], bool).reshape(-1, len(used))
        self.all_lit = bool(lit.all())
        self.kinds, kind = np.unique(lit, axis=1, return_inverse=True)
        self._kind = np.zeros(max(used) + 1, np.intp)
        self._kind[used] = kind.reshape(-1)

    def casting(self, light: np.ndarray | None) -> np.ndarray | int:
        """Numbers (K,) of the blockers of lights (K,), None for the only one; one if all have the same."""
        if len(self.blockers) == 0 or (self.blockers == self.blockers[0]).all():
            return int(self.blockers[0]) if len(self.blockers) else ALL_CAST
        return self.blockers.take(light)

    def cast_by_all(self, triangles: Triangles, first: int) -> np.ndarray | bool:
        """(T,) bool or a bool, which triangles cast shadows in the light of all lights from ``first`` on."""
        result = True
        for sets in (self._casting[k] for k in np.unique(self.blockers[first:])):
            if sets is not None:
                result = result & np.isin(triangles.shadow_set, list(sets))
        return result

    def lit(self, light: np.ndarray | None, triangle: np.ndarray) -> np.ndarray:
        """(K,) bool, whether lights (K,), None for the only one, light triangles (K,)."""
        return self.kinds[0 if light is None else light, self.kind(triangle)]

    def kind(self, triangle: np.ndarray) -> np.ndarray:
        """(K,) intp, columns of `kinds` that triangles (K,) are of."""
        sets = self._set.take(triangle) if np.ndim(self._set) else np.full(len(triangle), self._set)
        return self._kind.take(sets)


def lights_fog(links: Linking, volumes: Sequence[Volume]) -> bool:
    """Whether any of some volumes: fogs are integrated together, and what lights one lights all."""
    return any(links.lights_volume(s) for s in {volume.light_set for volume in volumes} or {0})


def linked_to_some_fogs(
    lights: Sequence[Light], meshes: Sequence[Mesh], volumes: Sequence[Volume]
) -> list[str]:
    """A sentence for each light, or mesh that emits, that should light some fogs and not others."""
    fogs = {volume.light_set for volume in volumes}
    sources = [(f'Light "{light.name}"', light.linking) for light in lights if light.power.any()]
    sources += [(f'Mesh "{mesh.name}"', mesh.linking) for mesh in meshes]
    return [
        f"{name} is linked to some fogs and not to others; it lights all of them."
        for name, links in sources
        if len({links.lights_volume(s) for s in fogs}) > 1
    ]
