"""``linkside excite``: plan a motion to calibrate by."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import click

from linkside.files.writing import check_writable
from linkside.recording.log import Log
from linkside.report import inputs
from linkside.robot import Robot

from .group import main
from .options import check_figure, check_report, draw, example, named_number, no_check, refuse_clashes, report
from .terminal import bar, show


@main.command(
    "excite", epilog=example("linkside excite robot.yaml --reach 0.4 --out motion.parquet --figure motion.svg")
)
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="[LOG]...", type=click.Path(), nargs=-1)
@click.option("--out", type=click.Path(), help="The motion to write: a .parquet or .csv file.")
@click.option("--free", help="Parameters to calibrate later: a,b,c.  [default: all that calibrate frees]")
@click.option("--duration", type=float, default=10.0, show_default=True, help="Duration of the motion [s].")
@click.option("--rate", type=float, help="Samples a second [Hz].  [default: rate_hz of ROBOT, or 1000]")
@click.option("--bandwidth", type=float, help="Highest frequency of the motion [Hz].")
@click.option("--reach", type=float, default=0.5, show_default=True, help="How far each joint moves [rad, m].")
@click.option("--posture", metavar="JOINT=POSITION", multiple=True, help="Where a joint begins and ends [rad, m].")
@click.option("--range", "ranges", metavar="JOINT=LOW:HIGH", multiple=True, help="Limits of a position [rad, m].")
@click.option("--velocity", metavar="[JOINT=]LIMIT", multiple=True, help="Limit of a velocity.  [default: URDF]")
@click.option(
    "--acceleration", metavar="[JOINT=]LIMIT", multiple=True, help="Limit of an acceleration.  [default: none]"
)
@click.option("--torque", metavar="[JOINT=]LIMIT", multiple=True, help="Limit of a motor's torque, link side.")
@click.option("--one-by-one", is_flag=True, help="Move one joint after the other, not all together.")
@click.option("--evaluations", type=click.IntRange(2), default=200, show_default=True, help="Number of motions to try.")
@click.option(
    "--seed",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="Seed of the search; the same seed gives the same motion.",
)
@click.option("--figure", type=click.Path(), help="Draw the motion: a .png, .pdf or .svg file.")
@report
@no_check
def excite(
    robot: str, logs: tuple[str, ...], out: str | None, figure: str | None, report: str | None, **options: Any
) -> None:
    """Plan a motion for the calibration of ROBOT.

    Springs, masses and sensor poses are identifiable from its recording. With LOGs, recorded or planned, the motion
    adds what they lack. Without --out, report what is identifiable from LOGs.

    The motion stays within the joint limits, but the planner does not know of obstacles, cables or tables: look at the
    motion before the robot moves. Positions and velocities are those of motors, as recordings of ROBOT have them.
    """
    from linkside.excitation import Limits, expected_errors
    from linkside.excitation import excite as plan
    from linkside.excitation.words import errors_table

    if out is None and not logs:
        raise click.UsageError("--out is missing: the motion, a file that ends in .parquet or .csv; or give a LOG")
    if out is None and (figure or report):
        raise click.UsageError("--figure and --report are for --out")
    if out is not None:
        check_writable(out)
        refuse_clashes([Path(out)], [robot, *logs])
    check_figure(figure, [robot, *logs, out])
    check_report(report, [robot, *logs, out, figure])
    loaded = Robot.load(robot)
    recorded = [Log.read(log, loaded, check=not options["no_check"]) for log in logs]
    free = None if options["free"] is None else options["free"].split(",")
    if out is None:
        show([errors_table(None, expected_errors(loaded, recorded, free))])
        return
    limits = Limits.of(
        loaded,
        ranges=dict(map(_range, options["ranges"])),
        **{what: _limit(loaded, what, options[what]) for what in ("velocity", "acceleration", "torque")},
    )
    settings = {name: options[name] for name in ("duration", "rate", "bandwidth", "reach", "one_by_one", "seed")}
    count = options["evaluations"]
    with bar(count) as advance:
        planned = plan(
            loaded,
            recorded,
            free,
            limits=limits,
            posture=_named("posture", options["posture"]),
            evaluations=count,
            progress=lambda _, best: advance(f"standard errors {math.exp(best):.3g} tolerances", 1),
            **settings,
        )
    show(planned.tables())
    planned.write(out)
    click.echo(f"motion: {out}")
    if figure is not None:
        draw(planned.figure(), figure)
    if report is not None:
        from linkside.excitation.page import page

        page(planned, inputs([("robot", robot), *(("log", log) for log in logs), ("motion", out)])).write(report)
        click.echo(f"report: {report}")


def _named(what: str, texts: tuple[str, ...]) -> dict[str, float]:
    return dict(named_number(f"--{what}", text) for text in texts)


def _limit(robot: Robot, what: str, texts: tuple[str, ...]) -> dict[str, float]:
    """Limits by joint; a number without a joint is that of all others."""
    limits = _named(what, texts)
    others = limits.pop("", None)
    return limits if others is None else dict.fromkeys(robot.names, others) | limits


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, interval = text.rpartition("=")
    low, _, high = interval.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise click.UsageError(f"--range {text}: expected JOINT=LOW:HIGH") from None
