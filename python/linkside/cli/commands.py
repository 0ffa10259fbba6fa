"""The command line: ``linkside init``, ``convert``, ``merge``, ``estimate``, ``tune``, ``check``, ``place``, ``demo``.

Whatever a user can get wrong is one line on standard error and exit status 2, and leaves no file behind.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from linkside.errors import EstimatorError, LogError, OutputError, RecordingWarning
from linkside.files.writing import check_writable, write_text
from linkside.kalman.noise import Noise
from linkside.observers import poles as patterns
from linkside.recording.checks import verdicts
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.config import RobotFile
from linkside.robot.starter import DRIVES, starter

from . import convert_bag, reporting
from .error_tables import tool_table
from .estimate_logs import EstimateJob, cores, estimate_all, naming, output_folder
from .failures import Commands, complain
from .methods import METHODS, Options
from .provenance import digest
from .terminal import bar, rate_lines, show

ROWS = 8192
"""Rows of a log that are in memory at a time."""

WHOLE = 2**62
"""More rows than a log has."""

_no_check = click.option("--no-check", is_flag=True, help="Believe the recordings without looking at them first.")

PATTERNS: dict[str, Callable[[float], patterns.PolePattern]] = {
    "damped": patterns.damped,
    "bessel": patterns.bessel,
    "butterworth": patterns.butterworth,
}


def _example(command: str) -> str:
    """The end of a command's help."""
    return f"Example:\n\n\b\n  {command}"


class Poles(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    """``250``, or a pattern of `linkside.poles` and its frequency, ``bessel:250``."""

    name = "poles"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> patterns.PolePattern:
        """Read the pattern."""
        kind, _, frequency = str(value).rpartition(":")
        try:
            return PATTERNS[kind or "damped"](float(frequency))
        except EstimatorError as error:
            self.fail(str(error), param, ctx)
        except (KeyError, ValueError):
            self.fail(f"{value!r} is neither a frequency nor one of {', '.join(PATTERNS)} with one", param, ctx)


@click.group(cls=Commands, invoke_without_command=True, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="linkside")
@click.option("--debug", is_flag=True, help="Show where in the program an error comes from.")
@click.pass_context
def main(ctx: click.Context, debug: bool) -> None:
    """Where the links of an elastic-joint robot really are."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@main.command(
    epilog="Methods: "
    + "; ".join(f"{name}: {method.help}" for name, method in METHODS.items())
    + ".\n\n"
    + _example("linkside estimate robot.yaml log.parquet --with ekf --out estimate.parquet")
)
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="LOG...", type=click.Path(), nargs=-1, required=True)
@click.option("--with", "method", type=click.Choice(list(METHODS)), default="observer", show_default=True)
@click.option("--out", required=True, help="Parquet or CSV file; for several logs a directory, or a name with {stem}.")
@click.option("--poles", type=Poles(), default="250", show_default=True, help="Frequency [rad/s], or bessel:250 …")
@click.option("--bias", is_flag=True, help="Estimate a bias of each link acceleration as well.")
@click.option("--form", type=click.Choice(["current", "predictor"]), default="current", show_default=True)
@click.option("--tuning", type=click.Path(), help="As `linkside tune` writes it for this method.")
@click.option("--gate", type=float, help="Leave out readings more than so many standard deviations off.")
@click.option(
    "--link-disturbance",
    type=click.Choice(["auto", "on", "off"]),
    default="auto",
    show_default=True,
    help="Whether links may be pushed by torques that the model lacks.",
)
@click.option("--particles", type=int, default=1000, show_default=True, help="How many a particle filter has.")
@click.option("--seed", type=int, default=0, show_default=True, help="Of a particle filter's random numbers.")
@click.option("--gain", type=float, default=100, show_default=True, help="Gain of a velocity observer [1/s].")
@click.option("--rate", type=float, help="Resample logs to this rate [Hz], whole in memory, as observers need it.")
@click.option("--strict", is_flag=True, help="Exit with status 3 where readings contradict the model.")
@_no_check
@click.option("--truth", "truths", type=click.Path(), multiple=True, help="Compare with this file; one for each log.")
@click.option("-j", "--jobs", "workers", type=click.IntRange(1), help="Logs at a time.  [default: one for each core]")
@click.option("--skip-existing", is_flag=True, help="Leave alone Parquet estimates that were made from the same.")
@click.option("--json", "manner", flag_value="json", default="words", help="Say what came of it as a JSON line a log.")
@click.option("--quiet", "manner", flag_value="quiet", help="Say nothing but errors.")
def estimate(
    robot: str, logs: tuple[str, ...], method: str, out: str, strict: bool, no_check: bool, **options: Any
) -> int:
    """Estimate the motion of ROBOT's links from recordings.

    ROBOT is a robot.yaml, each LOG a Parquet or CSV file. Logs are read piece by piece and may be larger than memory.
    Exit status: 0 done, 1 some of several logs could not be estimated, 2 wrong use, 3 not to be believed (--strict).
    """
    truths, manner, keep = options.pop("truths"), options.pop("manner"), options.pop("skip_existing")
    rate = options.pop("rate")
    workers = min(options.pop("workers") or cores(), len(logs))
    if truths and len(truths) != len(logs):
        raise click.UsageError(f"--truth is there {len(truths)} times, for {len(logs)} logs")
    _refuse_untaken(method)
    loaded = Robot.load(robot)
    sources = [robot, _urdf(robot, loaded), *([options["tuning"]] if options["tuning"] else [])]
    if options["tuning"] is not None:
        options["tuning"] = METHODS[method].read_tuning(options["tuning"])
    settings = method, rate, {name: options[name] for name in METHODS[method].takes}
    spill = Path(os.path.realpath(out))
    make = partial(METHODS[method].build, loaded, Options(**options, spill=spill if spill.is_dir() else spill.parent))
    with naming(robot):
        make()  # what is wrong with the robot or the options is said before any log is read
    rows = WHOLE if METHODS[method].whole(loaded) else ROWS
    with output_folder(out, logs) as outputs:
        _refuse_clashes(outputs, [robot, *logs, *truths])
        for output in outputs:
            check_writable(output)
            if keep and output.suffix.lower() != ".parquet":
                raise click.UsageError(f"--skip-existing is for Parquet estimates, not for {output}")
        jobs = [
            EstimateJob(
                loaded,
                make,
                rows,
                METHODS[method].uneven,
                rate,
                not no_check,
                log,
                output,
                truth,
                partial(digest, [*sources, log], settings),
            )
            for log, output, truth in zip(logs, outputs, truths or [None] * len(logs), strict=True)
        ]
        outcomes = estimate_all(jobs, workers, partial(reporting.tell, manner=manner), keep=keep)
    if len(logs) > 1 and manner == "words":
        reporting.summary(outcomes)
    failed = sum(outcome.error is not None for outcome in outcomes)
    if failed:
        complain(f"{failed} of {len(logs)} logs could not be estimated")
        return 1
    return 3 if strict and not all(outcome.believable for outcome in outcomes) else 0


def _urdf(robot: str, loaded: Robot) -> Path:
    assert isinstance(loaded.config, RobotFile)  # it was read from a file
    return Path(robot).parent / loaded.config.urdf


def _refuse_untaken(method: str) -> None:
    """An option that the method would not look at is a mistake to hear of."""
    context = click.get_current_context()
    for option in sorted({option for other in METHODS.values() for option in other.takes}):
        given = context.get_parameter_source(option) == click.core.ParameterSource.COMMANDLINE
        if given and option not in METHODS[method].takes:
            raise click.UsageError(f"--{option.replace('_', '-')} is not for --with {method}")


@main.command(epilog=_example("linkside init robot.urdf --gear-ratio joint_1=121"))
@click.argument("urdf", type=click.Path())
@click.option("--out", type=click.Path(), default="robot.yaml", show_default=True, help="The file to begin.")
@click.option(
    "--drive", type=click.Choice(list(DRIVES)), default="strain-wave", show_default=True, help="Of its joints."
)
@click.option(
    "--gear-ratio", "ratios", multiple=True, metavar="JOINT=N", help="Of a joint; logs are then of motor shafts."
)
def init(urdf: str, out: str, drive: str, ratios: tuple[str, ...]) -> None:
    """Begin a robot.yaml from URDF: its joints and links, and typical values with their ranges.

    What it asks for is marked ASKED. The file must not be there yet.
    """
    check_writable(out, (".yaml", ".yml"))
    if Path(out).exists():
        raise OutputError(f"{out}: this is there already; give another --out")
    given = dict(_named_number("--gear-ratio", text) for text in ratios)
    write_text(out, starter(urdf, out, drive=drive, gear_ratios=given))
    click.echo(f"written: {out}")
    click.echo(f"Next, fill in what it asks for (ASKED), then: linkside check {out}")


@main.command(epilog=_example("linkside merge robot.yaml joints.parquet imu.csv --out log.parquet"))
@click.argument("robot", type=click.Path())
@click.argument("files", metavar="FILE...", type=click.Path(), nargs=-1, required=True)
@click.option("--out", required=True, type=click.Path(), help="The log, a file that ends in .parquet or .csv.")
@click.option("--shift", "shifts", multiple=True, metavar="FILE=SECONDS", help="By how much a FILE's clock is ahead.")
@click.option("--rate", type=float, help="Resample to this rate [Hz], as observers need it.")
@_no_check
def merge(robot: str, files: tuple[str, ...], out: str, shifts: tuple[str, ...], **options: Any) -> None:
    """Merge FILEs of sensors that were recorded apart into one log, by time.

    Each has a column of time and some of ROBOT's other columns. The log has a row for each time, NaN where a sensor has
    no reading.
    """
    check_writable(out)
    _refuse_clashes([Path(out)], [robot, *files])
    ahead = dict(_named_number("--shift", text) for text in shifts)
    if unknown := set(ahead) - set(files):
        raise click.UsageError(f"--shift {min(unknown)}: this is none of the files {', '.join(files)}")
    loaded = Robot.load(robot)
    each = [ahead.get(file, 0.0) for file in files]
    log = Log.merge(files, loaded, shifts=each, rate=options["rate"], check=not options["no_check"])
    log.write(out)
    click.echo(f"{out}: {log!r}")
    for line in rate_lines(log.rates()):
        click.echo(line)


@main.command(epilog=_example("linkside convert bag --joints /joint_states --imu tool_acc=/imu_tool --out log.parquet"))
@click.argument("bag", type=click.Path())
@click.option("--out", type=click.Path(), help="The log, a file that ends in .parquet or .csv.")
@click.option("--robot", type=click.Path(), help="A robot.yaml with `sources`, in place of the options below.")
@click.option(
    "--joints",
    multiple=True,
    metavar="TOPIC[:SIGNAL=PATH,…]",
    help="JointState: position, velocity and effort are columns theta_, dtheta_, tau_JOINT; or arrays of any message.",
)
@click.option("--imu", multiple=True, metavar="NAME=TOPIC", help="Imu: columns NAME_x, _y, _z and NAME_wx, _wy, _wz.")
@click.option("--wrench", multiple=True, metavar="NAME=TOPIC", help="WrenchStamped: NAME_fx, _fy, _fz and NAME_tx, …")
@click.option("--field", "fields", multiple=True, metavar="COLUMN=TOPIC:PATH", help="A number of any message.")
def convert(bag: str, out: str | None, robot: str | None, **options: tuple[str, ...]) -> None:
    """Make a log of BAG, or without options say what is in it.

    BAG is an MCAP file, an SQLite file of rosbag2, or the directory of either. Time is that of the messages' stamps,
    from the first one on; a row for each time, NaN where a sensor has no reading. JointState has the sides of gears
    that its publisher means: q= takes it for the links', theta= for the motors'.
    """
    given = any(options.values())
    if given and robot is not None:
        raise click.UsageError("--robot says what to take; leave out the other options, or leave out --robot")
    if out is None:
        if given or robot is not None:
            raise click.UsageError("--out is missing: the log, a file that ends in .parquet or .csv")
        show(convert_bag.contents(bag))
        return
    if not given and robot is None:
        raise click.UsageError(
            "nothing to take: name topics (--joints, --imu, …), or --robot robot.yaml with `sources`"
        )
    check_writable(out)
    _refuse_clashes([Path(out)], [bag, *([robot] if robot else [])])
    by = convert_bag.sources(options) if robot is None else Robot.load(robot)
    for line in convert_bag.run(bag, by, out):
        click.echo(line)


def _named_number(option: str, text: str) -> tuple[str, float]:
    """What an option says of something by name, ``NAME=NUMBER``."""
    name, _, number = text.rpartition("=")
    try:
        return name, float(number)
    except ValueError:
        raise click.UsageError(f"{option} {text}: expected NAME=NUMBER") from None


@main.command(epilog=_example("linkside tune robot.yaml log.parquet --out tuning.yaml"))
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="LOG...", type=click.Path(), nargs=-1, required=True)
@click.option("--with", "method", type=click.Choice(["ekf", "observer"]), default="ekf", show_default=True)
@click.option("--out", required=True, type=click.Path(), help="The tuning file, for `linkside estimate --tuning`.")
@click.option("--start", type=click.Path(), help="A tuning file to start from (ekf).")
@click.option("--free", help="Which values, by their keys in that file, a,b,c.  [default: transmission, poles]")
@click.option("--states", multiple=True, type=click.Path(), help="What the links did, one for each LOG (observer).")
@click.option("--figure", type=click.Path(), help="Draw the Pareto front (observer).")
@_no_check
@click.option("--evaluations", type=click.IntRange(1), default=2000, help="How often to estimate LOGs (observer).")
def tune(robot: str, logs: tuple[str, ...], method: str, **options: Any) -> None:
    """Find the noise of a Kalman filter under which recordings are most likely, or the poles of an observer.

    With `--with observer` also stiffness, damping and motor_inertia of ROBOT's drives can be free; the links' states
    are measured ones (--states), or the smoother's.
    """
    for option in ("start",) if method == "observer" else ("states", "figure"):
        if options[option]:
            raise click.UsageError(f"--{option.replace('_', '-')} is not for --with {method}")
    _refuse_clashes([Path(options["out"])], [robot, *logs, *options["states"]])
    check_writable(options["out"], (".yaml", ".yml"))
    (_tune_observer if method == "observer" else _tune_noise)(robot, logs, options)
    click.echo(f"tuning: {options['out']}")


def _tune_noise(robot: str, logs: Sequence[str], options: dict[str, Any]) -> None:
    from linkside.tuning import noise_likelihood as module

    loaded = Robot.load(robot)
    noise = None if options["start"] is None else Noise.read(options["start"])
    recordings = [Log.read(log, loaded, check=not options["no_check"]) for log in logs]
    free = tuple((options["free"] or "transmission").split(","))
    with bar(None) as advance:
        result = module.tune(loaded, recordings, noise, free, partial(_show_best, advance, "log-likelihood"))
    result.after.write(options["out"])
    click.echo(result.to_text(), nl=False)


def _tune_observer(robot: str, logs: Sequence[str], options: dict[str, Any]) -> None:
    from linkside.tuning import observer_front as tune_observer

    loaded = Robot.load(robot)
    _check_figure(options["figure"], [robot, *logs, *options["states"], options["out"]])
    recordings = [Log.read(log, loaded, check=not options["no_check"]) for log in logs]
    states = [Estimate.read(file) for file in options["states"]] or None
    free = tuple((options["free"] or "poles").split(","))
    with bar(None) as advance:
        shown = partial(_show_best, advance, "sum of ratios")
        count = options["evaluations"]
        front = tune_observer.tune_observer(loaded, recordings, states, free, shown, evaluations=count)
    front.best.write(options["out"])
    click.echo(front.to_text(), nl=False)
    if options["figure"] is not None:
        _draw(front.figure(), options["figure"])


@main.command(
    epilog=_example("linkside calibrate robot.yaml log.parquet --out robot.calibrated.yaml --report report.html")
)
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="LOG...", type=click.Path(), nargs=-1, required=True)
@click.option("--out", required=True, type=click.Path(), help="The calibrated robot.yaml.")
@click.option("--report", type=click.Path(), help="A report with figures, one HTML file.")
@click.option("--free", help="Kinds or names of parameters, a,b,c; by default those that the logs can tell.")
@click.option("--torque/--no-torque", default=None, help="Whether motor torques are readings, too.")
@click.option("--bound", "bounds", multiple=True, help="NAME=LOW:HIGH, least and largest value of a parameter.")
@click.option("--held-out", type=click.Path(), multiple=True, help="A log that only tests the outcome.")
@_no_check
@click.option("--resume", is_flag=True, help="Go on with an interrupted run.")
@click.option("--force", is_flag=True, help="Write the outcome even where it is not to be believed.")
def calibrate(robot: str, logs: tuple[str, ...], out: str, resume: bool, **options: Any) -> None:
    """Find ROBOT's stiffness, damping, load and sensor errors from its own recordings.

    An outcome that does not foretell readings better than ROBOT as it is, or that is at a bound or far from it, is not
    written, and the exit status is 3.
    """
    from . import calibrate_logs

    outputs = [Path(out), *([Path(options["report"])] if options["report"] else [])]
    _refuse_clashes(outputs, [robot, *logs, *options["held_out"]])
    check_writable(out, (".yaml", ".yml"))
    if options["report"]:
        check_writable(options["report"], (".html", ".htm"))
    with bar(None) as advance:
        result = calibrate_logs.run(robot, logs, out, resume, advance, **options)
    click.echo(result.to_text(), nl=False)
    for output in outputs if result.accepted or options["force"] else outputs[1:]:
        click.echo(f"written: {output}")
    if not (result.accepted or options["force"]):
        click.echo(f"not written: {out}; if the estimates above are to be taken all the same, --force writes them")
    if not result.accepted:
        sys.exit(3)


@main.command(epilog=_example("linkside check robot.yaml log.parquet --figure check.png"))
@click.argument("robot", type=click.Path())
@click.argument("log", type=click.Path(), required=False)
@click.option("--figure", type=click.Path(), help="Draw it: a file that ends in .png, .pdf or .svg.")
@click.option("--over", metavar="JOINT,JOINT", help="Joints of the figure's map.  [default: those that matter most]")
@click.option("--at", "held", metavar="JOINT=POSITION", multiple=True, help="Where the map holds a joint [rad, m].")
def check(robot: str, log: str | None, figure: str | None, over: str | None, held: tuple[str, ...]) -> None:
    """Say what ROBOT's sensors see, how well and where; along LOG if it is given, which is looked at for mistakes."""
    from linkside.observability import analysis as module
    from linkside.observability.words import check_tables

    loaded = Robot.load(robot)
    at = dict(_named_number("--at", text) for text in held)
    if figure is None and (over or at):
        raise click.UsageError("--over and --at are for --figure")
    _check_figure(figure, [robot, log])
    if log is not None:
        _look_at(loaded, log)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # all is listed above
        report = module.check(loaded, None if log is None else Log.stream(log, loaded))
    show(check_tables(report))
    if figure is not None:
        with naming(robot):
            drawn = report.figure(None if over is None else over.split(","), at)
        _draw(drawn, figure)


def _look_at(robot: Robot, path: str) -> None:
    """List what the checks of recordings find; raise `LogError` where one refuses."""
    rows, refused = verdicts(Log.read(path, robot, check=False), robot)
    for name, words in rows:
        click.echo(f"{name:<22}{words}")
    click.echo("")
    if refused is not None:
        raise LogError(f"{path}: {refused}")


class Shift(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.4 only
    """Seconds, or ``auto``."""

    name = "seconds|auto"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float | str:
        """Read it."""
        try:
            return "auto" if value == "auto" else float(value)
        except ValueError:
            self.fail(f"{value!r} is neither a time in seconds nor auto", param, ctx)


@main.command(epilog=_example("linkside compare truth.parquet estimate.parquet --segments rests"))
@click.argument("reference", type=click.Path())
@click.argument("estimates", metavar="ESTIMATE...", type=click.Path(), nargs=-1, required=True)
@click.option("--robot", type=click.Path(), help="A robot.yaml: the tool's path where a file has none.")
@click.option("--names", help="What to call the estimates, a,b,c.  [default: their files]")
@click.option(
    "--align",
    type=click.Choice(["time", "start"]),
    default="time",
    show_default=True,
    help="By time, or both from their first row.",
)
@click.option(
    "--shift", type=Shift(), default="0", show_default=True, help="What estimates are late by [s]; auto finds it."
)
@click.option("--segments", help="A CSV file with start, end, name; or rests, for the parts between rests.")
@click.option("--repeats", is_flag=True, help="Estimates are repeats of one motion: their mean and spread as well.")
@click.option("--out", type=click.Path(), help="Write it: a file that ends in .json, .csv, .tex or .txt.")
@click.option("--figure", type=click.Path(), help="Draw it: a file that ends in .png, .pdf or .svg.")
def compare(reference: str, estimates: tuple[str, ...], **options: Any) -> None:
    """Measure how far ESTIMATEs are from REFERENCE: a truth, another estimate, or a log, for its commanded path."""
    from linkside import comparison as module
    from linkside.comparison.output import SUFFIXES, tables

    out, figure, segments = options["out"], options["figure"], options["segments"]
    inputs = [reference, *estimates, options["robot"]]
    if out is not None:
        check_writable(out, SUFFIXES)
        _refuse_clashes([Path(out)], inputs)
    _check_figure(figure, [*inputs, out])
    result = module.compare_files(
        reference,
        estimates,
        robot=None if options["robot"] is None else Robot.load(options["robot"]),
        names=None if options["names"] is None else options["names"].split(","),
        shift=options["shift"],
        align=options["align"],
        segments="rests" if segments == "rests" else () if segments is None else module.read_segments(segments),
        repeats=options["repeats"],
    )
    show(tables(result))
    if out is not None:
        result.write(out)
        click.echo(f"written: {out}")
    if figure is not None:
        _draw(result.figure(), figure)


@main.command(epilog=_example("linkside demo --figure demo.png"))
@click.option("--figure", type=click.Path(), default="linkside-demo.png", show_default=True, help="Where to draw it.")
def demo(figure: str) -> None:
    """Run the observer on a robot and a recording that come with the package."""
    from linkside.demo import run as module
    from linkside.demo.figure import demo_figure

    _check_figure(figure, [])
    result = module.run()
    show([tool_table(result.errors, "the truth")])
    _draw(demo_figure(result), figure)
    click.echo("Next, your own log:   linkside estimate robot.yaml log.parquet --out estimate.parquet")
    click.echo("      your own robot: linkside check robot.yaml")


@main.command(epilog=_example("linkside place robot.yaml log.parquet --link link3 --link link4 --out sensors.yaml"))
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="[LOG]...", type=click.Path(), nargs=-1)
@click.option("--link", "links", multiple=True, help="A link that can carry a sensor; on a grid around its frame.")
@click.option("--reach", type=float, default=0.3, show_default=True, help="How far that grid goes either way [m].")
@click.option("--steps", type=click.IntRange(1), default=3, show_default=True, help="Its points along each direction.")
@click.option("--axes", default="xyz", show_default=True, help="Three-axis sensors, or x,y,z for single axes.")
@click.option("--candidates", type=click.Path(), help="A file with `accelerometers` to choose from, as in robot.yaml.")
@click.option("--count", type=int, help="Sensors in the set.  [default: the fewest that can do]")
@click.option("--limit", type=float, help="Take the smallest set whose score is at most this.")
@click.option("--by", type=click.Choice(["condition", "covariance"]), default="condition", show_default=True)
@click.option("--out", type=click.Path(), help="Where to write the chosen `accelerometers`, YAML.")
@_no_check
@click.option("--figure", type=click.Path(), help="Draw where it is singular: a file that ends in .png, .pdf or .svg.")
def place(robot: str, logs: tuple[str, ...], links: tuple[str, ...], **options: Any) -> None:
    """Choose accelerometers for ROBOT: those that see its joints best along LOGs, or in the whole workspace."""
    from linkside.observability import placement

    out, inputs = options["out"], [robot, *logs, options["candidates"]]
    if out is not None:
        check_writable(out, (".yaml", ".yml"))
        _refuse_clashes([Path(out)], inputs)
    _check_figure(options["figure"], [*inputs, out])
    loaded = Robot.load(robot)
    sensors = [] if options["candidates"] is None else list(placement.read_candidates(options["candidates"]))
    kinds = options["axes"].split(",")
    with naming(robot):
        sensors += placement.candidates(loaded, links, reach=options["reach"], steps=options["steps"], axes=kinds)
        where = [Log.read(log, loaded, check=not options["no_check"]) for log in logs] or None
        choice = {"count": options["count"], "limit": options["limit"], "criterion": options["by"]}
        found = placement.place(loaded, sensors, where, **choice)
    click.echo(found.to_text(), nl=False)
    if out is not None:
        found.write(out)
        click.echo(f"accelerometers: {out}")
    if options["figure"] is not None:
        _draw(found.figure(), options["figure"])


def _show_best(advance: Callable[[str, int], None], what: str, _: int, best: float) -> None:
    advance(f"{what} {best:.5g}", 1)


def _refuse_clashes(outputs: Sequence[Path], inputs: Sequence[str | None]) -> None:
    taken = {os.path.realpath(path): "would be written over what is read" for path in inputs if path is not None}
    for output in outputs:
        if (where := os.path.realpath(output)) in taken:
            raise OutputError(f"{output}: {taken[where]}")
        taken[where] = "is the output of two logs; give --out as a name that differs, or run them apart"


def _check_figure(figure: str | None, inputs: Sequence[str | None]) -> None:
    if figure is not None:
        from linkside import figures

        figures.check_writable(figure)
        _refuse_clashes([Path(figure)], inputs)


def _draw(figure: Any, path: str) -> None:
    from linkside.figures import save

    save(figure, path)
    click.echo(f"figure: {path}")
