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
    """A table under a line of its own: rich would fold a title that is wider than the table.

    Attributes
    ----------
    title : str
        That line.
    heads : tuple of str
        Heads of the columns.
    rows : list of tuple of str
        The cells.
    """

    def __init__(self, title: str, heads: Iterable[str]) -> None:
        self.title, self.heads, self.rows = title, tuple(heads), list[tuple[str, ...]]()

    def add_row(self, *cells: str) -> None:
        """Add a row; brackets are text, not markup."""
        self.rows.append(cells)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the title, then the table."""
        table = Table()
        for index, head in enumerate(self.heads):
            side: JustifyMethod = "right" if index and head != "in words" else "left"
            table.add_column(Text(head), justify=side, overflow="fold")
        for row in self.rows:
            table.add_row(*map(Text, row))
        yield Text(f"\n{self.title}", style="bold")
        yield table
