"""``linkside check``, ``compare``, ``place`` and ``demo``: observability and comparison."""

from __future__ import annotations

import contextlib
import warnings
from functools import partial
from pathlib import Path
from typing import Any

import click

from linkside.errors import EstimatorError, LogError, RecordingWarning
from linkside.files.writing import check_writable
from linkside.fleet import mapped
from linkside.fleet.places import check_output, from_anywhere, is_url, local_output, logs_of
from linkside.fleet.task import naming
from linkside.recording.checks import verdicts
from linkside.recording.log import Log
from linkside.report import inputs
from linkside.robot import Robot

from .error_tables import tool_table
from .group import main
from .options import (
    Shift,
    at_a_time,
    check_figure,
    check_report,
    draw,
    example,
    named_number,
    no_check,
    refuse_clashes,
    report,
)
from .terminal import show


@main.command(epilog=example("linkside check robot.yaml log.parquet --figure check.png"))
@click.argument("robot", type=click.Path())
@click.argument("log", type=click.Path(), required=False)
@click.option("--figure", type=click.Path(), help="Draw a figure: a .png, .pdf or .svg file.")
@click.option("--over", metavar="JOINT,JOINT", help="Joints of the figure's axes.  [default: those that matter most]")
@click.option("--at", "held", metavar="JOINT=POSITION", multiple=True, help="Position of another joint [rad, m].")
@click.option("--bound", is_flag=True, help="Also report the smallest standard deviations possible along LOG.")
@report
def check(
    robot: str,
    log: str | None,
    figure: str | None,
    over: str | None,
    held: tuple[str, ...],
    bound: bool,
    report: str | None,
) -> None:
    """Report what the sensors of ROBOT observe, and check LOG.

    With LOG, the report is also about its motion, and LOG is checked for wrong units, signs and other mistakes.
    """
    from linkside.observability import analysis as module
    from linkside.observability.words import check_tables

    loaded = Robot.load(robot)
    at = dict(named_number("--at", text) for text in held)
    if figure is None and (over or at):
        raise click.UsageError("--over and --at are for --figure")
    if bound and log is None:
        raise click.UsageError("--bound is for a LOG")
    check_figure(figure, [robot, log])
    check_report(report, [robot, log, figure])
    rows, refused = ([], None) if log is None else verdicts(Log.read(log, loaded, check=False), loaded)
    for name, words in rows:
        click.echo(f"{name:<22}{words}")
    if rows:
        click.echo("")
    if refused is not None and report is None:
        raise LogError(f"{log}: {refused}")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # all is listed above
        sound = log is not None and refused is None
        found = module.check(loaded, Log.stream(log, loaded) if log is not None and sound else None)
    show(check_tables(found))
    if bound and log is not None and refused is None:
        _show_bounds(loaded, log)
    if figure is not None:
        with naming(robot):
            drawn = found.figure(None if over is None else over.split(","), at)
        draw(drawn, figure)
    if report is not None:
        from linkside.observability.page import page

        page(found, rows, refused, inputs([("robot", robot), ("log", log)])).write(report)
        click.echo(f"report: {report}")
    if refused is not None:
        raise LogError(f"{log}: {refused}")


def _show_bounds(robot: Robot, path: str) -> None:
    """How good filters can get along a log, and how far off the observer, where the robot is one for it."""
    from linkside import kalman
    from linkside.observers import AccelerationObserver

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        log = Log.read(path, robot)
        show(kalman.bound(robot, log).tables())
    with contextlib.suppress(EstimatorError):
        show(AccelerationObserver(robot, std=False).bound(period=log.period).tables())


@main.command(epilog=example("linkside compare truth.parquet estimate.parquet --segments rests"))
@click.argument("reference", type=click.Path())
@click.argument("estimates", metavar="ESTIMATE...", type=click.Path(), nargs=-1, required=True)
@click.option("--robot", type=click.Path(), help="A robot.yaml, to compute tool paths that a file lacks.")
@click.option("--names", help="Names of estimates: a,b,c.  [default: names of their files]")
@click.option(
    "--align",
    type=click.Choice(["time", "start"]),
    default="time",
    show_default=True,
    help="Align rows by time, or by their first rows.",
)
@click.option(
    "--shift", type=Shift(), default="0", show_default=True, help="Delay of the estimates [s]; auto finds it."
)
@click.option("--segments", help="A CSV file with start, end, name; or `rests`, for the parts between rests.")
@click.option(
    "--repeats", is_flag=True, help="The estimates repeat one motion: report mean, spread, trend and outliers."
)
@click.option("--out", type=click.Path(), help="Write the result: a .json, .csv, .tex or .txt file.")
@click.option("--figure", type=click.Path(), help="Draw a figure: a .png, .pdf or .svg file.")
@at_a_time
@report
def compare(reference: str, estimates: tuple[str, ...], **options: Any) -> None:
    """Measure how far ESTIMATEs are from REFERENCE.

    REFERENCE is a truth, another estimate, or a log, of which the commanded path is used. All are Parquet or CSV files,
    globs, or URLs such as s3://bucket/estimates/*.parquet.
    """
    from linkside import comparison as module
    from linkside.comparison.output import SUFFIXES, tables

    out, figure, segments, report = (options[name] for name in ("out", "figure", "segments", "report"))
    found = logs_of(estimates)
    files = [reference, *found, options["robot"]]
    if report is not None and any(map(is_url, (reference, *found))):
        raise click.UsageError("--report is for estimates on this machine, not for URLs")
    if out is not None:
        check_output(out, SUFFIXES)
        refuse_clashes([Path(out)], files)
    check_figure(figure, [*files, out])
    check_report(report, [*files, out, figure])
    with mapped(options["on"], options["workers"], len(found), partial(click.echo, err=True)) as run:
        result = module.compare_files(
            reference,
            found,
            robot=None if options["robot"] is None else Robot.load(options["robot"]),
            names=None if options["names"] is None else options["names"].split(","),
            shift=options["shift"],
            align=options["align"],
            segments="rests" if segments == "rests" else () if segments is None else module.read_segments(segments),
            repeats=options["repeats"],
            read=partial(from_anywhere, module.read_motion),
            run=run,
        )
    show(tables(result))
    if out is not None:
        with local_output(out) as path:
            result.write(path)
        click.echo(f"written: {out}")
    if figure is not None:
        draw(result.figure(), figure)
    if report is not None:
        from linkside.comparison.page import page

        roles = [("reference", reference), *(("estimate", file) for file in found), ("robot", options["robot"])]
        page(result, inputs(roles)).write(report)
        click.echo(f"report: {report}")


@main.command(epilog=example("linkside place robot.yaml log.parquet --link link3 --link link4 --out sensors.yaml"))
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="[LOG]...", type=click.Path(), nargs=-1)
@click.option("--link", "links", multiple=True, help="A link that can carry a sensor, on a grid around its frame.")
@click.option("--reach", type=float, default=0.3, show_default=True, help="Half the width of the grid [m].")
@click.option("--steps", type=click.IntRange(1), default=3, show_default=True, help="Grid points along each axis.")
@click.option("--axes", default="xyz", show_default=True, help="Three-axis sensors, or x,y,z for single axes.")
@click.option("--candidates", type=click.Path(), help="A file with `accelerometers` to choose from, as in robot.yaml.")
@click.option("--count", type=int, help="Number of sensors.  [default: the fewest that suffice]")
@click.option("--limit", type=float, help="Choose the smallest set within this score.")
@click.option("--spares", type=click.IntRange(0), default=0, show_default=True, help="Sensors that may fail.")
@click.option("--by", type=click.Choice(["condition", "covariance"]), default="condition", show_default=True)
@click.option("--out", type=click.Path(), help="Write the chosen `accelerometers` to this YAML file.")
@no_check
@click.option("--figure", type=click.Path(), help="Draw singular postures: a .png, .pdf or .svg file.")
@report
def place(robot: str, logs: tuple[str, ...], links: tuple[str, ...], **options: Any) -> None:
    """Choose accelerometers for ROBOT, and where to mount them.

    The choice observes the joints best along LOGs or, without LOGs, in the whole workspace.
    """
    from linkside.observability import placement

    out, told, files = options["out"], options["report"], [robot, *logs, options["candidates"]]
    if out is not None:
        check_writable(out, (".yaml", ".yml"))
        refuse_clashes([Path(out)], files)
    check_figure(options["figure"], [*files, out])
    check_report(told, [*files, out, options["figure"]])
    loaded = Robot.load(robot)
    sensors = [] if options["candidates"] is None else list(placement.read_candidates(options["candidates"]))
    kinds = options["axes"].split(",")
    with naming(robot):
        sensors += placement.candidates(loaded, links, reach=options["reach"], steps=options["steps"], axes=kinds)
        where = [Log.read(log, loaded, check=not options["no_check"]) for log in logs] or None
        choice = {name: options[name] for name in ("count", "limit", "spares")}
        found = placement.place(loaded, sensors, where, criterion=options["by"], **choice)
    click.echo(found.to_text(), nl=False)
    if out is not None:
        found.write(out)
        click.echo(f"accelerometers: {out}")
    if options["figure"] is not None:
        draw(found.figure(), options["figure"])
    if told is not None:
        from linkside.observability.placement_page import page

        read = [("robot", robot), *(("log", log) for log in logs), ("candidates", options["candidates"])]
        page(found, inputs(read)).write(told)
        click.echo(f"report: {told}")


@main.command(epilog=example("linkside demo --figure demo.png"))
@click.option("--figure", type=click.Path(), default="linkside-demo.png", show_default=True, help="Figure to write.")
def demo(figure: str) -> None:
    """Estimate the recording that comes with the package."""
    from linkside.demo import run as module
    from linkside.demo.figure import demo_figure

    check_figure(figure, [])
    result = module.run()
    show([tool_table(result.errors, "the truth")])
    draw(demo_figure(result), figure)
    click.echo("Next, your own log:   linkside estimate robot.yaml log.parquet --out estimate.parquet")
    click.echo("      your own robot: linkside check robot.yaml")
