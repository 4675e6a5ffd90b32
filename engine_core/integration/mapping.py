# SPDX-License-Identifier: GPL-3.0-or-later
"""Running one function over many items, wherever that is done."""

from __future__ import annotations

from collections.abc import Callable, Iterable

Map = Callable[[Callable, Iterable], list]
"""map_(function, items): the results in the order of the items; on workers, or here, as its maker likes."""


def in_order(function: Callable, items: Iterable) -> list:
    """Here, one after the other."""
    return [function(item) for item in items]
