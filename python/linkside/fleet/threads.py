"""Estimating several logs at a time in the threads of this process."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from threading import get_ident

from linkside.mapping import Map

from .task import EstimateJob, Outcome, Progress, Recipe, run


class Stopped(Exception):
    """The user interrupted the run."""


class Interruption:
    """Stops the threads that estimate.

    A kernel looks for an exception of its thread as it does for Ctrl-C in the main thread. A thread is sent one only
    while it estimates: between a file's making and the line that knows of it, it would leave the file behind.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._stopped = False
        self._estimating: set[int] = set()

    def stop(self) -> None:
        """Raise `Stopped` in each thread, at once or when it goes on to estimate."""
        with self._lock:
            self._stopped = True
            for thread in self._estimating:
                _raise_in(thread, ctypes.py_object(Stopped))

    @contextmanager
    def estimating(self) -> Iterator[None]:
        """Register this thread, so that it can be stopped."""
        thread = get_ident()
        with self._lock:
            if self._stopped:
                raise Stopped
            self._estimating.add(thread)
        try:
            yield
        finally:
            with self._lock:
                self._estimating.discard(thread)
                if self._stopped:
                    _raise_in(thread, None)  # takes back what has not been raised yet
        if self._stopped:
            raise Stopped


def _raise_in(thread: int, error: ctypes.py_object[type[Stopped]] | None) -> None:
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), error)


def cores() -> int:
    """How many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):  # not on macOS and Windows
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def on_threads(
    recipe: Recipe,
    jobs: Sequence[EstimateJob],
    workers: int,
    tell: Callable[[Outcome], None],
    progress: Progress,
    *,
    keep: bool,
) -> list[Outcome]:
    """Estimate each log, ``workers`` at a time, and report each when it is done; on an error the others go on."""
    interruption = Interruption()
    outcomes: list[Outcome] = []
    with ThreadPoolExecutor(workers) as pool:

        def advance(log: str, rows: int) -> None:
            done = f"{len(outcomes)}/{len(jobs)} " if len(jobs) > 1 else ""
            progress(f"{done}{log}", rows)

        waiting = {pool.submit(run, recipe, job, advance, interruption.estimating, keep=keep) for job in jobs}
        try:
            for outcome in _as_completed(waiting):
                outcomes.append(outcome)
                tell(outcome)
        except BaseException:  # an interruption, above all
            pool.shutdown(wait=False, cancel_futures=True)
            interruption.stop()
            raise
    return outcomes


@contextmanager
def map_on_threads(workers: int) -> Iterator[Map]:
    """Give a `Map` whose tasks run in as many threads; an error or an interruption ends those that have not begun."""
    pool = ThreadPoolExecutor(workers)
    try:
        yield pool.map
    finally:
        pool.shutdown(cancel_futures=True)


def _as_completed(waiting: set[Future[Outcome]]) -> Iterator[Outcome]:
    """Give results as they come; signals are looked at ten times a second."""
    while waiting:
        done, waiting = wait(waiting, timeout=0.1, return_when=FIRST_COMPLETED)
        for future in done:
            yield future.result()
