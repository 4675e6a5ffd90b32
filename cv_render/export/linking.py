# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and shadow linking: objects' receiver and blocker collections, as sets of meshes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

from ...engine_core.scene import Linking

# Instances by the thousand share them.
_UNLINKED = {True: Linking(), False: Linking(fog=False)}


class LightLinks:
    """The sets that the objects of a scene are of, and which of them lights are linked to.

    Objects in no collection of a light are of set 0, those that are in the same collections share one.
    """

    def __init__(self, objects: Iterable[Any]) -> None:
        """objects : all of a dependency graph, those that only instances show among them."""
        linked = [obj.light_linking for obj in objects]
        self._receivers = Collections(filter(None, (links.receiver_collection for links in linked)))
        self._blockers = Collections(filter(None, (links.blocker_collection for links in linked)))

    def sets(self, obj: Any, parent: Any) -> tuple[int, int]:
        """The light set and the shadow set of an object, those of what instances it if that is in any."""
        return tuple(kind.set_of(parent) or kind.set_of(obj) for kind in (self._receivers, self._blockers))

    def linking(self, obj: Any) -> Linking:
        """Of a light, or of what emits."""
        if not (self._receivers or self._blockers):
            return _UNLINKED[obj.visible_volume_scatter]
        links = obj.light_linking
        return Linking(
            receivers=self._receivers.linked(links.receiver_collection),
            blockers=self._blockers.linked(links.blocker_collection),
            fog=obj.visible_volume_scatter,
        )


class Collections:
    """Collections of one kind: each includes some objects and excludes others."""

    def __init__(self, collections: Iterable[Any]) -> None:
        originals = [collection.original for collection in collections]
        states = {collection.as_pointer(): dict(_states(collection)) for collection in originals}
        self._number: dict[int, int] = {}
        signatures: dict[tuple[str, ...], int] = {}
        for member in dict.fromkeys(member for state in states.values() for member in state):
            signature = tuple(state.get(member, "") for state in states.values())
            self._number[member] = signatures.setdefault(signature, len(signatures) + 1)
        nothing = ("",) * len(states)
        self._linked: dict[int, frozenset[int]] = {}
        for k, (pointer, state) in enumerate(states.items()):
            # With nothing included, all is but what is excluded.
            lit = ("INCLUDE",) if "INCLUDE" in state.values() else ("INCLUDE", "")
            every = [(nothing, 0), *signatures.items()]
            self._linked[pointer] = frozenset(number for which, number in every if which[k] in lit)

    def __len__(self) -> int:
        return len(self._linked)

    def set_of(self, obj: Any) -> int:
        """The set that an object is of; 0 if it is in no collection."""
        return self._number.get(obj.original.as_pointer(), 0) if self._number else 0

    def linked(self, collection: Any | None) -> frozenset[int] | None:
        """The sets that a collection links to; None for all."""
        return None if collection is None else self._linked[collection.original.as_pointer()]


def _states(collection: Any) -> Iterator[tuple[int, str]]:
    """Objects of a collection, and whether they are included or excluded; what is said last counts."""
    found = []
    for child, link in zip(collection.children, collection.collection_children, strict=True):
        found += [(obj, link.light_linking.link_state) for obj in child.all_objects]
    for obj, link in zip(collection.objects, collection.collection_objects, strict=True):
        found.append((obj, link.light_linking.link_state))
    return ((obj.as_pointer(), state) for obj, state in found)
