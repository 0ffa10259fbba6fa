"""``linkside estimate``."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from linkside.errors import EstimatorError
from linkside.files.writing import check_writable
from linkside.observers import poles as patterns
from linkside.robot import Robot
from linkside.robot.config import RobotFile

from . import reporting
from .estimate_logs import EstimateJob, Outcome, cores, estimate_all, naming, output_folder
from .failures import complain
from .group import main
from .methods import METHODS, Options
from .options import check_report, example, no_check, refuse_clashes, report
from .provenance import digest

ROWS = 8192
"""Rows of a log that are in memory at a time."""

WHOLE = 2**62
"""More rows than a log has."""

PATTERNS: dict[str, Callable[[float], patterns.PolePattern]] = {
    "damped": patterns.damped,
    "bessel": patterns.bessel,
    "butterworth": patterns.butterworth,
}


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


@main.command(
    epilog="Methods: "
    + "; ".join(f"{name}: {method.help}" for name, method in METHODS.items())
    + ".\n\n"
    + example("linkside estimate robot.yaml log.parquet --with ekf --out estimate.parquet")
)
@click.argument("robot", type=click.Path())
@click.argument("logs", metavar="LOG...", type=click.Path(), nargs=-1, required=True)
@click.option("--with", "method", type=click.Choice(list(METHODS)), default="observer", show_default=True)
@click.option("--out", required=True, help="Parquet or CSV file; for several logs a directory, or a name with {stem}.")
@click.option("--poles", type=Poles(), default="250", show_default=True, help="Frequency [rad/s], or bessel:250.")
@click.option("--bias", is_flag=True, help="Estimate a bias of each link acceleration as well.")
@click.option("--form", type=click.Choice(["current", "predictor"]), default="current", show_default=True)
@click.option("--tuning", type=click.Path(), help="A tuning file, as `linkside tune` writes it.")
@click.option("--gate", type=float, help="Reject readings this many standard deviations from the prediction.")
@click.option(
    "--link-disturbance",
    type=click.Choice(["auto", "on", "off"]),
    default="auto",
    show_default=True,
    help="Whether to estimate torques on the links that the model lacks.",
)
@click.option(
    "--loss",
    type=click.Choice(["squares", "huber", "student-t"]),
    default="squares",
    show_default=True,
    help="What an error of a reading costs; less than its square where there are outliers.",
)
@click.option("--particles", type=int, default=1000, show_default=True, help="Number of particles.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random numbers of a particle filter.")
@click.option("--gain", type=float, default=100, show_default=True, help="Gain of a velocity observer [1/s].")
@click.option("--rate", type=float, help="Resample logs to this even rate [Hz], in memory; for observers.")
@click.option("--strict", is_flag=True, help="Exit with status 3 if readings contradict the model.")
@no_check
@report
@click.option("--truth", "truths", type=click.Path(), multiple=True, help="Compare with this truth; one for each log.")
@click.option("-j", "--jobs", "workers", type=click.IntRange(1), help="Logs at a time.  [default: one per core]")
@click.option("--skip-existing", is_flag=True, help="Skip estimates whose inputs are unchanged.")
@click.option("--json", "manner", flag_value="json", default="words", help="Report each log as one line of JSON.")
@click.option("--quiet", "manner", flag_value="quiet", help="Print errors only.")
def estimate(
    robot: str, logs: tuple[str, ...], method: str, out: str, strict: bool, no_check: bool, **options: Any
) -> int:
    """Estimate the motion of ROBOT's links from recordings.

    ROBOT is a robot.yaml, each LOG a Parquet or CSV file. Logs are read piece by piece and may be larger than memory.
    Exit status: 0 done, 1 some of several logs failed, 2 wrong usage, 3 readings contradict the model (--strict).
    """
    told = options.pop("report")
    truths, manner, keep = options.pop("truths"), options.pop("manner"), options.pop("skip_existing")
    rate = options.pop("rate")
    workers = min(options.pop("workers") or cores(), len(logs))
    if truths and len(truths) != len(logs):
        raise click.UsageError(f"--truth is there {len(truths)} times, for {len(logs)} logs")
    _refuse_untaken(method)
    loaded = Robot.load(robot)
    sources = [robot, urdf_of(robot, loaded), *([options["tuning"]] if options["tuning"] else [])]
    if options["tuning"] is not None:
        options["tuning"] = METHODS[method].read_tuning(options["tuning"])
    settings = method, rate, no_check, {name: options[name] for name in METHODS[method].takes}
    spill = Path(os.path.realpath(out))
    make = partial(METHODS[method].build, loaded, Options(**options, spill=spill if spill.is_dir() else spill.parent))
    with naming(robot):
        make()  # what is wrong with the robot or the options is said before any log is read
    rows = WHOLE if METHODS[method].whole(loaded) else ROWS
    with output_folder(out, logs) as outputs:
        refuse_clashes(outputs, [robot, *logs, *truths])
        check_report(told, [robot, *logs, *truths, *map(str, outputs)])
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
    if told is not None:
        _write_report(told, outcomes, robot, method, rate, options)
        if manner == "words":
            click.echo(f"report: {told}")
    failed = sum(outcome.error is not None for outcome in outcomes)
    if failed:
        complain(f"{failed} of {len(logs)} logs could not be estimated")
        return 1
    return 3 if strict and not all(outcome.believable for outcome in outcomes) else 0


def _write_report(
    path: str, outcomes: Sequence[Outcome], robot: str, method: str, rate: float | None, options: dict[str, Any]
) -> None:
    from .estimate_page import batch_page, estimate_page

    taken = {name: options[name] for name in METHODS[method].takes if name != "tuning"}
    words = [(name.replace("_", " "), _plain(value)) for name, value in taken.items()]
    settings = [("method", method), *words, *([("rate", f"{rate:g} Hz")] if rate else [])]
    tuning = click.get_current_context().params["tuning"]
    settings += [("tuning", tuning)] if tuning else []
    page = estimate_page(outcomes[0], robot, settings) if len(outcomes) == 1 else batch_page(outcomes, robot, settings)
    page.write(path)


def _plain(value: object) -> str:
    return "none" if value is None else f"{value}"


def urdf_of(robot: str, loaded: Robot) -> Path:
    """Where the URDF of a robot.yaml is."""
    assert isinstance(loaded.config, RobotFile)  # it was read from a file
    return Path(robot).parent / loaded.config.urdf


def _refuse_untaken(method: str) -> None:
    """An option that the method would not look at is a mistake to hear of."""
    context = click.get_current_context()
    for option in sorted({option for other in METHODS.values() for option in other.takes}):
        given = context.get_parameter_source(option) == click.core.ParameterSource.COMMANDLINE
        if given and option not in METHODS[method].takes:
            raise click.UsageError(f"--{option.replace('_', '-')} is not for --with {method}")
