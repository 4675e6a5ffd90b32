# SPDX-License-Identifier: GPL-3.0-or-later
"""What could not be rendered as asked: collected while exporting, told once."""

from __future__ import annotations

from collections.abc import Iterator

NAMES_SHOWN = 3


class Messages:
    """Sentences, each with the data-blocks that it is about."""

    def __init__(self) -> None:
        self._owners: dict[str, dict[str, None]] = {}

    def add(self, owner: str, problem: str) -> None:
        """Note that ``owner``, e.g. 'Material "Gold"', has a ``problem``; a repeated one counts once."""
        self._owners.setdefault(problem, {})[owner] = None

    def __iter__(self) -> Iterator[str]:
        for problem, owners in self._owners.items():
            shown = list(owners)[:NAMES_SHOWN]
            more = len(owners) - len(shown)
            yield ", ".join(shown) + (f" and {more} more" if more else "") + f": {problem}"


def named(datablock: object) -> str:
    """How messages call a data-block: 'Camera "Top"'; an object by the name that the outliner shows."""
    kind = datablock.bl_rna.name
    for general in ("Light", "Shader Node Tree"):
        if kind.endswith(" " + general):
            kind = general
    return f'{kind} "{datablock.name}"'
