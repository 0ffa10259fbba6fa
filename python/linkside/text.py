"""Reports as text: sentences and tables."""

from __future__ import annotations

import io
from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, JustifyMethod, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text


def as_text(parts: Iterable[RenderableType], width: int) -> str:
    """Render without colours."""
    console = Console(file=io.StringIO(), width=width)
    render(parts, console)
    return console.file.getvalue()  # type: ignore[attr-defined,no-any-return]


def render(parts: Iterable[RenderableType], console: Console) -> None:
    """Write sentences and tables on a console."""
    for part in parts:
        console.print(part, markup=False, highlight=False)


class Titled:
    """A table under a line of its own: rich would fold a title that is wider than the table."""

    def __init__(self, title: str, heads: Iterable[str]) -> None:
        self._title, self._table = title, Table()
        for index, head in enumerate(heads):
            side: JustifyMethod = "right" if index and head != "in words" else "left"
            self._table.add_column(Text(head), justify=side, overflow="fold")

    def add_row(self, *cells: str) -> None:
        """Add a row; brackets are text, not markup."""
        self._table.add_row(*map(Text, cells))

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the title, then the table."""
        yield Text(f"\n{self._title}", style="bold")
        yield self._table
