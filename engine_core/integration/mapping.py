# SPDX-License-Identifier: GPL-3.0-or-later
"""Running one function over many items, wherever that is done."""

from __future__ import annotations

from collections.abc import Callable, Iterable

Map = Callable[[Callable, Iterable], list]
"""map_(function, items): the results in the order of the items; on workers, or here, as its maker likes."""


def in_order(function: Callable, items: Iterable) -> list:
    """Here, one after the other."""
    return [function(item) for item in items]


AT_LEAST = 4
"""Parts of what is not much, so that all workers have some."""


def even_parts(count: int, most: int) -> list[slice]:
    """``count`` items in parts of equal size, of ``most`` at most, and none much smaller if it can be helped.

    Threads that share the work wait for one another whenever arrays are short.
    """
    number = min(max(-(-count // most), min(AT_LEAST, AT_LEAST * count // most), 1), count)
    return [slice(count * i // number, count * (i + 1) // number) for i in range(number)]
