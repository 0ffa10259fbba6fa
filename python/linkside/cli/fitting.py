"""``linkside tune`` and ``calibrate``: settings and robots that recordings agree with."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from linkside.files.writing import check_writable
from linkside.fleet.places import is_url, logs_of
from linkside.fleet.task import naming
from linkside.kalman.noise import Noise
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.report import inputs
from linkside.robot import Robot

from .group import main
from .options import at_a_time, check_figure, check_report, draw, example, no_check, refuse_clashes, report
from .terminal import bar

if TYPE_CHECKING:
    from linkside.observers.tuning_file import ObserverTuning
    from linkside.tuning.noise_likelihood import Tuning
    from linkside.tuning.observer_front import Front


@main.command(epilog=example("linkside tune robot.yaml log.parquet --out tuning.yaml"))
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="LOG...", type=click.Path(), nargs=-1, required=True)
@click.option("--with", "method", type=click.Choice(["ekf", "observer"]), default="ekf", show_default=True)
@click.option("--out", required=True, type=click.Path(), help="The tuning file to write, for `estimate --tuning`.")
@click.option("--start", type=click.Path(), help="A tuning file to start from (ekf).")
@click.option("--free", help="Keys in that file to tune: a,b,c.  [default: transmission, poles]")
@click.option("--states", multiple=True, type=click.Path(), help="True link states, one for each LOG (observer).")
@click.option("--figure", type=click.Path(), help="Draw the Pareto front (observer).")
@no_check
@report
@click.option("--evaluations", type=click.IntRange(1), default=2000, help="Number of evaluations (observer).")
@click.option("--em", is_flag=True, help="Expectation and maximisation: with intervals, and tested (ekf).")
def tune(robot: str, logs: tuple[str, ...], method: str, **options: Any) -> None:
    """Tune the noise of a Kalman filter, or the poles of an observer.

    The noise is that with which the readings in LOGs are most likely. With --em values that LOGs do not tell stay as
    they are, and the result is not written, and the exit status is 3, if it does not predict held-back readings better
    than the noise before. `--with observer` can also free the stiffness, damping and motor_inertia of the drives. It
    compares with measured states of the links (--states), or else with the smoother.
    """
    for option in ("start", "em") if method == "observer" else ("states", "figure"):
        if options[option]:
            raise click.UsageError(f"--{option.replace('_', '-')} is not for --with {method}")
    refuse_clashes([Path(options["out"])], [robot, *logs, *options["states"]])
    check_writable(options["out"], (".yaml", ".yml"))
    told = options["report"]
    check_report(told, [robot, *logs, *options["states"], options["out"], options["figure"]])
    tuned, found = (_tune_observer if method == "observer" else _tune_noise)(robot, logs, options)
    if found is not None:
        found.write(options["out"])
    click.echo(f"{'not written' if found is None else 'tuning'}: {options['out']}")
    if told is not None:
        from linkside.tuning.page import page

        files = [("robot", robot), *(("log", log) for log in logs), *(("states", file) for file in options["states"])]
        page(tuned, inputs([*files, ("start", options["start"]), ("tuning", options["out"])])).write(told)
        click.echo(f"report: {told}")
    if found is None:
        sys.exit(3)


@main.command(epilog=example("linkside align robot.yaml log.parquet --out robot.aligned.yaml"))
@click.argument("robot", type=click.Path())
@click.argument("log", type=click.Path())
@click.option("--tracker", help="Which of `trackers` of ROBOT.  [default: the only one]")
@click.option("--free", default="place,delay", show_default=True, help="What to find: place, delay, xyz (the target).")
@click.option("--out", required=True, type=click.Path(), help="The robot.yaml to write.")
@no_check
def align(robot: str, log: str, tracker: str | None, free: str, out: str, no_check: bool) -> None:
    """Find where a tracker of ROBOT stands, and how late it is, by a LOG with its readings.

    A tracker is a laser tracker, a camera or a motion capture system that sees a point of a link.
    """
    from linkside.calibration import align_tracker

    refuse_clashes([Path(out)], [robot, log])
    check_writable(out, (".yaml", ".yml"))
    loaded = Robot.load(robot)
    with naming(robot):
        found = align_tracker(loaded, Log.read(log, loaded, check=not no_check), tracker, free.split(","))
    click.echo(found.to_text(), nl=False)
    found.write(robot, out)
    click.echo(f"robot: {out}")


def _tune_noise(robot: str, logs: Sequence[str], options: dict[str, Any]) -> tuple[Tuning, Noise | None]:
    """What tuning found, and the noise to write, if it is accepted."""
    from linkside.tuning import noise_likelihood as module

    loaded = Robot.load(robot)
    noise = None if options["start"] is None else Noise.read(options["start"])
    recordings = [Log.read(log, loaded, check=not options["no_check"]) for log in logs]
    free = tuple((options["free"] or "transmission").split(","))
    with bar(None) as advance:
        shown = partial(_show_best, advance, "log-likelihood")
        result = module.tune(loaded, recordings, noise, free, shown, method="em" if options["em"] else "search")
    click.echo(result.to_text(), nl=False)
    return result, result.after if result.accepted else None


def _tune_observer(robot: str, logs: Sequence[str], options: dict[str, Any]) -> tuple[Front, ObserverTuning]:
    """The compromises that tuning found, and the one to write."""
    from linkside.tuning import observer_front as tune_observer

    loaded = Robot.load(robot)
    check_figure(options["figure"], [robot, *logs, *options["states"], options["out"]])
    recordings = [Log.read(log, loaded, check=not options["no_check"]) for log in logs]
    states = [Estimate.read(file) for file in options["states"]] or None
    free = tuple((options["free"] or "poles").split(","))
    with bar(None) as advance:
        shown = partial(_show_best, advance, "sum of ratios")
        count = options["evaluations"]
        front = tune_observer.tune_observer(loaded, recordings, states, free, shown, evaluations=count)
    click.echo(front.to_text(), nl=False)
    if options["figure"] is not None:
        draw(front.figure(), options["figure"])
    return front, front.best


@main.command(
    epilog=example("linkside calibrate robot.yaml log.parquet --out robot.calibrated.yaml --report report.html")
)
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="LOG...", type=click.Path(), nargs=-1, required=True)
@click.option("--out", required=True, type=click.Path(), help="The calibrated robot.yaml to write.")
@report
@click.option("--free", help="Parameters to free: a,b,c.  [default: all that are identifiable]")
@click.option("--torque/--no-torque", default=None, help="Whether to use motor torques as measurements.")
@click.option("--bound", "bounds", multiple=True, help="NAME=LOW:HIGH, bounds of a parameter.")
@click.option("--held-out", type=click.Path(), multiple=True, help="A log used only to test the result.")
@no_check
@at_a_time
@click.option("--resume", is_flag=True, help="Resume an interrupted run.")
@click.option("--force", is_flag=True, help="Write the result even if it is refused.")
def calibrate(robot: str, logs: tuple[str, ...], out: str, resume: bool, **options: Any) -> None:
    """Identify springs, load and sensor errors of ROBOT from LOGs.

    Each LOG is a file, a glob, or a URL such as s3://bucket/logs/*.parquet; of several, each is evaluated by itself.
    The result is not written, and the exit status is 3, if it does not predict held-back readings better than ROBOT as
    it is, if an estimate is at a bound, or if one is far from ROBOT.
    """
    from . import calibrate_logs

    names, tests = logs_of(logs), logs_of(options.pop("held_out"))
    if options["report"] is not None and any(map(is_url, (*names, *tests))):
        raise click.UsageError("--report is for logs on this machine, not for URLs")
    outputs = [Path(out), *([Path(options["report"])] if options["report"] else [])]
    refuse_clashes(outputs, [robot, *names, *tests])
    check_writable(out, (".yaml", ".yml"))
    check_report(options["report"], [robot, *names, *tests])
    with bar(None) as advance:
        note = partial(click.echo, err=True)
        result = calibrate_logs.run(robot, names, out, resume, advance, note, held_out=tests, **options)
    click.echo(result.to_text(), nl=False)
    if result.refused:
        click.echo("linkside excite ROBOT LOG... --out motion.parquet plans a motion for the parameters not estimated")
    for output in outputs if result.accepted or options["force"] else outputs[1:]:
        click.echo(f"written: {output}")
    if not (result.accepted or options["force"]):
        click.echo(f"not written: {out}; --force writes the estimates above anyway")
    if not result.accepted:
        sys.exit(3)


def _show_best(advance: Callable[[str, int], None], what: str, _: int, best: float) -> None:
    advance(f"{what} {best:.5g}", 1)
