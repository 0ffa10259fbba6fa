"""A page with a verdict, tables, figures and their inputs, in one self-contained file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeAlias

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup
from matplotlib.figure import Figure

from linkside.files.writing import check_writable, write_text
from linkside.text import Titled

from .drawing import drawing, picture
from .inputs import Input, today, versions

SUFFIXES = (".html", ".htm")

LARGEST = 2_000_000
"""Bytes of a page."""

MOST_ROWS = 500
"""Rows of a table."""

Level: TypeAlias = Literal["good", "doubtful", "bad", "open"]
Part: TypeAlias = "str | Titled | tuple[str, Figure]"
"""A paragraph, a table, or a figure with its caption."""


@dataclass(frozen=True)
class Verdict:
    """Whether what a page shows can be trusted.

    Attributes
    ----------
    level : {"good", "doubtful", "bad", "open"}
        ``"open"`` if the method does not judge itself.
    headline : str
        In a few words.
    reasons : tuple of str
        Reasons, the most serious first.
    """

    level: Level
    headline: str
    reasons: tuple[str, ...] = ()


@dataclass(frozen=True)
class Page:
    """What a page shows, in its order.

    Attributes
    ----------
    title : str
        What it is about.
    verdict : Verdict
        The outcome, ahead of all else.
    facts : list of (str, str)
        Key figures beside it.
    next_steps : list of str
        What to do next.
    sections : list of (str, parts)
        Headings, each with paragraphs, tables and figures.
    inputs : list of Input
        Files that were read.
    settings : list of (str, str)
        How it was made.
    """

    title: str
    verdict: Verdict
    facts: list[tuple[str, str]] = field(default_factory=list)
    next_steps: list[str] = field(default_factory=list)
    sections: list[tuple[str, Sequence[Part]]] = field(default_factory=list)
    inputs: Sequence[Input] = ()
    settings: list[tuple[str, str]] = field(default_factory=list)

    def to_html(self) -> str:
        """The page, of at most 2 MB: figures that would make it larger are drawn in points."""
        figures = [part for _, parts in self.sections for part in parts if isinstance(part, tuple)]
        drawn = {id(figure): drawing(figure, caption) for caption, figure in figures}
        for caption, figure in sorted(figures, key=lambda part: -len(drawn[id(part[1])])):
            if sum(map(len, drawn.values())) < 0.9 * LARGEST:
                break
            drawn[id(figure)] = min(drawn[id(figure)], picture(figure, caption), key=len)
        sections = [(heading, [_shown(part, drawn) for part in parts]) for heading, parts in self.sections]
        return _template().render(page=self, sections=sections, versions=versions(), date=today())

    def write(self, path: str | Path) -> None:
        """Write it whole or not at all; `OutputError` when that cannot be."""
        check_writable(path, SUFFIXES)
        write_text(path, self.to_html())


def write_page(page: Page, path: str | Path) -> None:
    """Write a page."""
    page.write(path)


def _shown(part: Part, drawn: dict[int, Markup]) -> dict[str, Any]:
    if isinstance(part, Titled):
        rows = part.rows[:MOST_ROWS]
        return {
            "kind": "table",
            "title": part.title,
            "heads": part.heads,
            "rows": rows,
            "more": len(part.rows) - len(rows),
        }
    if isinstance(part, tuple):
        return {"kind": "figure", "caption": part[0], "drawing": drawn[id(part[1])]}
    return {"kind": "text", "text": str(part)}


@cache
def _template() -> Template:
    loader = PackageLoader("linkside.report", ".")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return environment.get_template("page.html.jinja")


def paragraphs(parts: Iterable[Any]) -> list[Part]:
    """Sentences and tables of a report in words, as parts of a page."""
    return [part if isinstance(part, Titled) else str(part) for part in parts]
