"""How the same work is done for each of several logs: one after the other, or wherever a caller says."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, TypeVar

Task = TypeVar("Task")
Result = TypeVar("Result")


class Map(Protocol):
    """Calls a function with each task, anywhere, and gives the results in their order.

    Function, tasks and results can be pickled; results do not depend on where they are computed.
    """

    def __call__(self, function: Callable[[Task], Result], tasks: Sequence[Task], /) -> Iterable[Result]:
        """Call ``function`` with each of ``tasks``."""


def here(function: Callable[[Task], Result], tasks: Sequence[Task], /) -> Iterable[Result]:
    """Call ``function`` with each of ``tasks``, one after the other."""
    return map(function, tasks)
