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
from .options import (
    check_figure,
    check_report,
    draw,
    example,
    kept_limits,
    limits_of,
    named_number,
    no_check,
    refuse_clashes,
    report,
)
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
@kept_limits
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
    from linkside.excitation import excite as plan
    from linkside.excitation import expected_errors
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
    limits = limits_of(loaded, options)
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
