"""Common parts of the commands: options, types of values, checks of outputs."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from linkside.errors import OutputError
from linkside.files.writing import check_writable
from linkside.report.page import SUFFIXES
from linkside.robot import Robot
from linkside.robot.limits import Limits

no_check = click.option("--no-check", is_flag=True, help="Skip the checks of the recordings.")


report = click.option("--report", type=click.Path(), help="Write a report, a self-contained HTML file.")


def at_a_time(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options ``workers`` and ``on``: how many logs at a time, and where."""
    for option in (
        click.option(
            "--on",
            help="Where to run: dask for processes of this machine, or the address of a scheduler, tcp://host:8786.",
        ),
        click.option(
            "-j", "--jobs", "workers", type=click.IntRange(1), help="Logs at a time.  [default: one per core]"
        ),
    ):
        command = option(command)
    return command


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


def limits_by_joint(robot: Robot, what: str, texts: tuple[str, ...]) -> dict[str, float]:
    """What an option ``[JOINT=]LIMIT`` says of each joint; a number without a joint is that of all others."""
    limits = dict(named_number(f"--{what}", text) for text in texts)
    others = limits.pop("", None)
    return limits if others is None else dict.fromkeys(robot.names, others) | limits


def named_range(text: str) -> tuple[str, tuple[float, float]]:
    """What an option ``JOINT=LOW:HIGH`` says."""
    name, _, interval = text.rpartition("=")
    low, _, high = interval.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise click.UsageError(f"--range {text}: expected JOINT=LOW:HIGH") from None


def kept_limits(command: Callable[..., None]) -> Callable[..., None]:
    """Options of the limits that a motion keeps, for `limits_of`."""
    for option in (
        click.option("--torque", metavar="[JOINT=]LIMIT", multiple=True, help="Limit of a motor's torque, link side."),
        click.option(
            "--acceleration", metavar="[JOINT=]LIMIT", multiple=True, help="Limit of an acceleration.  [default: none]"
        ),
        click.option(
            "--velocity", metavar="[JOINT=]LIMIT", multiple=True, help="Limit of a velocity.  [default: URDF]"
        ),
        click.option(
            "--range", "ranges", metavar="JOINT=LOW:HIGH", multiple=True, help="Limits of a position [rad, m]."
        ),
    ):
        command = option(command)
    return command


def limits_of(robot: Robot, options: Mapping[str, Any]) -> Limits:
    """Limits by the options of `kept_limits`, and by the URDF."""
    return Limits.of(
        robot,
        ranges=dict(map(named_range, options["ranges"])),
        **{what: limits_by_joint(robot, what, options[what]) for what in ("velocity", "acceleration", "torque")},
    )


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
