"""What a command says when it fails: one line on standard error, and an exit status."""

from __future__ import annotations

import signal
import sys
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, NoReturn, TextIO, cast

import click

from linkside.errors import LinksideError, LinksideWarning, printable


class Commands(click.Group):
    """Commands whose errors are one line."""

    def main(self, *args: Any, **kwargs: Any) -> NoReturn:
        """Run a command and exit: 0 if all is well, 2 on an error, 130 when interrupted."""
        _prepare_streams()
        try:
            with _warnings_in_words():
                sys.exit(super().main(*args, **{**kwargs, "prog_name": "linkside", "standalone_mode": False}) or 0)
        except click.Abort:
            complain("interrupted")
            sys.exit(130)
        except click.ClickException as error:
            complain(error.format_message())
        except (LinksideError, OSError) as error:
            complain(in_words(error))
        sys.exit(2)

    def invoke(self, ctx: click.Context) -> Any:
        """Run a command; show where an error comes from if that was asked for."""
        try:
            return super().invoke(ctx)
        except (LinksideError, OSError):
            if ctx.params["debug"]:
                traceback.print_exc()
            raise


def _prepare_streams() -> None:
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError):
            cast("Any", stream).reconfigure(errors="replace")  # µ and σ must not break a terminal in ASCII
    with suppress(ValueError):  # only the main thread may; so that a job that is ended leaves nothing half done
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))


def in_words(error: Exception) -> str:
    """Say what is wrong in one line."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return str(error)


def complain(message: str) -> None:
    """Write a line on standard error."""
    click.echo(f"linkside: {printable(message)}", err=True)


@contextmanager
def _warnings_in_words() -> Iterator[None]:
    """Print linkside's warnings on standard error, one line each, and each once."""
    said: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        if not issubclass(category, LinksideWarning):
            click.echo(warnings.formatwarning(message, category, filename, lineno, line), file=file or sys.stderr)
        elif str(message) not in said:
            said.add(str(message))
            complain(f"warning: {message}")

    with warnings.catch_warnings():
        warnings.simplefilter("always", LinksideWarning)
        warnings.showwarning = show
        yield
