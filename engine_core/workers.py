# SPDX-License-Identifier: GPL-3.0-or-later
"""Threads that a render's work runs on, and waiting for them: progress, cancelling, the time limit."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ThreadPoolExecutor, wait
from contextlib import suppress
from threading import Event
from typing import Any

import numpy as np

from .image.film import Film

POLL_SECONDS = 0.05


class Sink:
    """Where a render reports to; all calls come from the thread that called `render`.

    watched : whether anybody looks at tiles before the end; if not, `tile` need not be called.
    """

    watched = True

    def cancelled(self) -> bool:
        """Polled every `POLL_SECONDS`; True stops the render and keeps what is there."""
        return False

    def tile(self, film: Film, x0: int, y0: int, x1: int, y1: int) -> None:
        """Pixels [y0:y1, x0:x1] of the film hold a new estimate."""

    def progress(self, fraction: float, elapsed: float, remaining: float | None, text: str) -> None:
        """How far the render is: fraction in [0, 1], seconds, and a phrase for people."""


class Nobody(Sink):
    """Nothing is shown before the end."""

    watched = False


class _Cancelled(Exception):
    """Unwinds a worker between two batches."""


class Workers:
    """Threads of this process, and a clock that started with the render.

    began, built : seconds of `time.perf_counter` at which the render began, and at which its scene was built.
    """

    def __init__(self, sink: Sink, time_limit: float, threads: int, executor: Executor | None = None) -> None:
        """time_limit : seconds, 0 for none. executor : runs the work, on ``threads`` of its own if None."""
        self._work = self._done = 0
        self._sink, self._limit = sink, time_limit
        self._own = executor is None
        self._pool = executor or ThreadPoolExecutor(threads, "cv-render")
        self._stop = Event()
        self.began = self.built = time.perf_counter()

    def begin(self) -> None:
        """The scene is built: the seconds that remain are told from what comes now."""
        self.built = time.perf_counter()

    def close(self) -> None:
        """Stop what still runs, and wait for it if the threads are its own."""
        self._stop.set()
        if self._own:
            self._pool.shutdown(wait=True, cancel_futures=True)

    def expect(self, work: int) -> None:
        """What is waited for next is so much in all, in any unit."""
        self._work, self._done = work, 0

    def advance(self, work: int) -> None:
        """Called by work: so much more of it is done."""
        self._done += work

    def check(self) -> None:
        """Called by work before every batch: raises where it has been stopped."""
        if self._stop.is_set():
            raise _Cancelled

    def submit(self, function: Callable, *arguments: Any) -> Future:
        """Run a function on one of the threads, for `wait`."""
        return self._pool.submit(_quietly, function, *arguments)

    def map(self, function: Callable, items: Iterable) -> list:
        """Run a function over items; results in their order."""
        pending = [self._pool.submit(_quietly, function, item) for item in items]
        try:
            return [future.result() for future in pending]
        finally:
            # Nothing may still be written when whoever asked goes on.
            wait([future for future in pending if not future.cancel()])

    def drive(self, build: Callable, text: str) -> tuple[Future, str | None]:
        """Run ``build(map_, enough)``, which uses the threads; its future, and why it was stopped if it was.

        map_ : runs a function over items on the threads. enough : whether to make do with what there is.
        """

        def enough() -> bool:
            # Half of the time is the samples', to which the polynomials are worth little alone.
            return bool(self._limit) and time.perf_counter() - self.began > self._limit / 2

        with ThreadPoolExecutor(1, "cv-render-build") as driver:
            building = {driver.submit(_quietly, build, self.map, enough): None}
            outcome = next(iter(building))
            ended = self.wait(building, lambda future, _: None, lambda: text, always=True)
        return outcome, ended

    def wait(
        self,
        pending: dict[Future, Any],
        finish: Callable[[Future, Any], None],
        text: Callable[[], str],
        before: float = 0.0,
        share: float = 1.0,
        always: bool = False,
    ) -> str | None:
        """Report until all futures are done; returns why they were stopped, if they were.

        before, share : what of the whole render was done before, and is done by these.
        always : not to be stopped by the time limit.
        """
        ended = None
        try:
            while pending:
                finished, _ = wait(pending, POLL_SECONDS, FIRST_COMPLETED)
                for future in finished:
                    with suppress(_Cancelled):
                        finish(future, pending.pop(future))
                elapsed = time.perf_counter() - self.began
                self._tell(before, share, elapsed, text())
                if ended is None:
                    if self._sink.cancelled():
                        ended = "cancel"
                    elif self._limit and elapsed >= self._limit and not always:
                        ended = "time"
                    if ended:
                        self._stop.set()
                        for future in [f for f in pending if f.cancel()]:
                            del pending[future]
        except BaseException:
            self._stop.set()
            for future in pending:
                future.cancel()
            wait(pending)
            raise
        return ended

    def part(self) -> float:
        """Of what is waited for, how much is done, in [0, 1]."""
        return min(self._done / max(self._work, 1), 1.0)

    def _tell(self, before: float, share: float, elapsed: float, text: str) -> None:
        fraction = min(before + share * self.part(), 1.0)
        rendering = time.perf_counter() - self.built
        remaining = rendering * (1 - fraction) / fraction if fraction > 0.01 else None
        if self._limit and remaining is not None:
            remaining = min(remaining, max(self._limit - elapsed, 0.0))
        self._sink.progress(fraction, elapsed, remaining, text)


def _quietly(function: Callable, *arguments: Any) -> Any:
    """What over- or underflows is dealt with where it matters; NumPy's state is each thread's own."""
    with np.errstate(all="ignore"):
        return function(*arguments)
