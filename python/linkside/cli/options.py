"""Common parts of the commands: options, types of values, checks of outputs."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from linkside.errors import OutputError
from linkside.files.writing import check_writable
from linkside.report.page import SUFFIXES

no_check = click.option("--no-check", is_flag=True, help="Skip the checks of the recordings.")


report = click.option("--report", type=click.Path(), help="Write a report, a self-contained HTML file.")


def example(command: str) -> str:
    """The end of a command's help."""
    return f"Example:\n\n\b\n  {command}"


def named_number(option: str, text: str) -> tuple[str, float]:
    """What an option says of something by name, ``NAME=NUMBER``."""
    name, _, number = text.rpartition("=")
    try:
        return name, float(number)
    except ValueError:
        raise click.UsageError(f"{option} {text}: expected NAME=NUMBER") from None


class Shift(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    """Seconds, or ``auto``."""

    name = "seconds|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        """Read it."""
        try:
            return "auto" if value == "auto" else float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a time in seconds nor auto", param, ctx)


def refuse_clashes(outputs: Sequence[Path], inputs: Sequence[str | None]) -> None:
    """Raise `OutputError` where an output would be written over an input, or over another output."""
    taken = {os.path.realpath(path): "would be written over what is read" for path in inputs if path is not None}
    for output in outputs:
        if (where := os.path.realpath(output)) in taken:
            raise OutputError(f"{output}: {taken[where]}")
        taken[where] = "is the output of two logs; give --out as a name that differs, or run them apart"


def check_figure(figure: str | None, inputs: Sequence[str | None]) -> None:
    """Raise `OutputError` where a figure that is asked for cannot be written."""
    if figure is not None:
        from linkside import figures

        figures.check_writable(figure)
        refuse_clashes([Path(figure)], inputs)


def draw(figure: Any, path: str) -> None:
    """Write a figure, and say so."""
    from linkside.figures import save

    save(figure, path)
    click.echo(f"figure: {path}")


def check_report(path: str | None, inputs: Sequence[str | None]) -> None:
    """Raise `OutputError` where a report that is asked for cannot be written."""
    if path is not None:
        check_writable(path, SUFFIXES)
        refuse_clashes([Path(path)], inputs)
