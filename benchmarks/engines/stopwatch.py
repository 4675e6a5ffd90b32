# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the time of a render goes: functions timed from outside, in all threads."""

from __future__ import annotations

import functools
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass
class Spent:
    """Seconds in the functions of one label, less those in labelled functions that they called.

    wall, processor : summed over threads; the rest of wall is waiting, for a core or for the GIL.
    """

    wall: float = 0.0
    processor: float = 0.0
    calls: int = 0


class Stopwatch:
    """``with Stopwatch() as watch: watch.time(RayTracer, "occluded", "shadow rays"); ...``"""

    def __init__(self) -> None:
        self._replaced: list[tuple[Any, str, Any]] = []
        self._threads: list[dict[str, Spent]] = []
        self._here = threading.local()

    def __enter__(self) -> Stopwatch:
        return self

    def __exit__(self, *_: object) -> None:
        for owner, name, function in reversed(self._replaced):
            setattr(owner, name, function)

    def time(self, owner: Any, name: str, label: str, keep: Callable[[Any], None] | None = None) -> None:
        """Time the function ``name`` of a class or module; ``keep`` is called with what it returns."""
        function = getattr(owner, name)
        self._replaced.append((owner, name, function))

        @functools.wraps(function)
        def timed(*arguments: Any, **named: Any) -> Any:
            inside, spent = self._thread()
            inside.append([0.0, 0.0])
            wall, processor = time.perf_counter(), time.thread_time()
            try:
                result = function(*arguments, **named)
            finally:
                processor, wall = time.thread_time() - processor, time.perf_counter() - wall
                children_wall, children_processor = inside.pop()
                if inside:
                    inside[-1][0] += wall
                    inside[-1][1] += processor
                one = spent[label]
                one.wall += wall - children_wall
                one.processor += processor - children_processor
                one.calls += 1
            if keep is not None:
                keep(result)
            return result

        setattr(owner, name, timed)

    def _thread(self) -> tuple[list[list[float]], dict[str, Spent]]:
        if not hasattr(self._here, "spent"):
            self._here.inside, self._here.spent = [], defaultdict(Spent)
            self._threads.append(self._here.spent)
        return self._here.inside, self._here.spent

    def total(self) -> dict[str, Spent]:
        """By label, over all threads."""
        result: dict[str, Spent] = defaultdict(Spent)
        for thread in self._threads:
            for label, spent in thread.items():
                result[label].wall += spent.wall
                result[label].processor += spent.processor
                result[label].calls += spent.calls
        return dict(result)
