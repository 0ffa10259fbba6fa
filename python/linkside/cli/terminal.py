"""What the terminal shows: reports, and a bar while work goes on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from linkside.text import render

DELAY = 2.0
"""Work that takes less than this needs no bar [s]."""


@contextmanager
def bar(total: int | None) -> Iterator[Callable[[str, int], None]]:
    """Show a bar on standard error, if that is a terminal and work takes long; yields ``advance(what, rows)``."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    progress = Progress(*columns, console=console, transient=True, disable=not console.is_terminal)
    task = progress.add_task("", total=total)
    begun = time.monotonic()

    def advance(what: str, rows: int) -> None:
        progress.update(task, description=what, advance=rows)
        if time.monotonic() - begun > DELAY:
            progress.start()

    try:
        yield advance
    finally:
        progress.stop()


def rate_lines(rates: Iterable[tuple[str, float, float]]) -> Iterator[str]:
    """A line a column: how often it is read, and in which part of the rows."""
    for column, hertz, share in rates:
        yield f"  {column:<22}{hertz:10.6g} Hz, in {100 * share:5.1f} % of the rows"


def show(parts: Iterable[RenderableType]) -> None:
    """Print on standard output; a pipe has no width, so tables are as wide as they need to be there."""
    render(parts, Console(width=None if sys.stdout.isatty() else 160))
