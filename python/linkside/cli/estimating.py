"""``linkside estimate``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import click

from linkside.errors import EstimatorError
from linkside.fleet import METHODS, EstimateJob, Outcome
from linkside.fleet.estimating import check_places, outputs, recipe, run_all
from linkside.fleet.places import is_url, logs_of, plain
from linkside.fleet.task import Recipe
from linkside.observers import poles as patterns
from linkside.recording.opening import log_rows

from . import reporting
from .failures import complain
from .group import main
from .options import at_a_time, check_report, example, no_check, report
from .terminal import bar

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
@click.option(
    "--with",
    "method",
    type=click.Choice(list(METHODS)),
    default="observer",
    show_default=True,
    help="Method, see below.",
)
@click.option("--out", required=True, help="Parquet or CSV file; for several logs a directory, or a name with {stem}.")
@click.option(
    "--poles",
    type=Poles(),
    default="250",
    show_default=True,
    help="Poles of the observer: a frequency [rad/s], or a pattern such as bessel:250.",
)
@click.option("--bias", is_flag=True, help="Estimate a bias of each link acceleration as well.")
@click.option(
    "--form",
    type=click.Choice(["current", "predictor"]),
    default="current",
    show_default=True,
    help="State of the observer after (current) or before a sample's motor positions are used.",
)
@click.option("--tuning", type=click.Path(), help="A tuning file, as `linkside tune` writes it.")
@click.option(
    "--gate", type=float, help="Reject readings further than this many standard deviations from the prediction."
)
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
    help="Cost of an error of a reading: squares for Gaussian noise, huber or student-t for outliers.",
)
@click.option("--exclude-faulty", is_flag=True, help="Go on without a channel found faulty, from its fault on.")
@click.option("--particles", type=int, default=1000, show_default=True, help="Number of particles.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the random numbers of a particle filter.")
@click.option("--gain", type=float, default=100, show_default=True, help="Gain of a velocity observer [1/s].")
@click.option("--rate", type=float, help="Resample logs to this even rate [Hz], in memory; for observers.")
@click.option("--strict", is_flag=True, help="Exit with status 3 if readings contradict the model.")
@no_check
@report
@click.option("--truth", "truths", type=click.Path(), multiple=True, help="Compare with this truth; one for each log.")
@at_a_time
@click.option(
    "--manifest", help="Write a Parquet table with a row for each log: verdict, figures, digests, time and worker."
)
@click.option("--skip-existing", is_flag=True, help="Skip estimates whose inputs are unchanged.")
@click.option("--json", "manner", flag_value="json", default="words", help="Report each log as one line of JSON.")
@click.option("--quiet", "manner", flag_value="quiet", help="Print errors only.")
def estimate(
    robot: str, logs: tuple[str, ...], method: str, out: str, strict: bool, no_check: bool, **options: Any
) -> int:
    """Estimate the motion of ROBOT's links from recordings.

    ROBOT is a robot.yaml, each LOG a Parquet or CSV file, a glob, or a URL such as s3://bucket/logs/*.parquet. Logs are
    read piece by piece and may be larger than memory.
    Exit status: 0 done, 1 some of several logs failed, 2 wrong usage, 3 readings contradict the model (--strict).
    """
    told, truths, manner = options.pop("report"), options.pop("truths"), options.pop("manner")
    keep, rate, on = options.pop("skip_existing"), options.pop("rate"), options.pop("on")
    workers, manifest = options.pop("workers"), options.pop("manifest")
    names = logs_of(logs)
    if truths and len(truths) != len(names):
        raise click.UsageError(f"--truth is there {len(truths)} times, for {len(names)} logs")
    _refuse_untaken(method)
    taken = {name: options[name] for name in METHODS[method].takes}
    made = recipe(robot, method, rate=rate, check=not no_check, out=out, **taken)
    with outputs(plain(out), names) as places:
        jobs = list(map(EstimateJob, names, places, truths or [None] * len(names)))
        if told is not None and any(map(is_url, (*names, *places))):
            raise click.UsageError("--report is for logs and estimates on this machine, not for URLs")
        check_places(jobs, [robot], keep=keep)
        check_report(told, [robot, *names, *truths, *places])
        tell = partial(reporting.tell, robot=made.robot, manner=manner)
        outcomes = _run(made, jobs, on, workers, tell, keep=keep, manifest=manifest)
    if len(jobs) > 1 and manner == "words":
        reporting.summary(outcomes)
    if told is not None:
        _write_report(told, outcomes, made, robot, method, taken)
        if manner == "words":
            click.echo(f"report: {told}")
    failed = sum(outcome.error is not None for outcome in outcomes)
    if failed:
        complain(f"{failed} of {len(jobs)} logs could not be estimated")
        return 1
    return 3 if strict and not all(outcome.believable for outcome in outcomes) else 0


def _run(
    made: Recipe,
    jobs: Sequence[EstimateJob],
    on: str | None,
    workers: int | None,
    tell: Callable[[Outcome], None],
    **settings: Any,
) -> list[Outcome]:
    """Estimate with a bar: by rows where they are known beforehand, or by logs on a cluster."""
    counts = [] if on is not None else [None if is_url(job.log) else log_rows(job.log) for job in jobs]
    total = len(jobs) if on is not None else None if None in counts else sum(filter(None, counts))
    with bar(total) as advance:

        def hear(outcome: Outcome) -> None:
            if outcome.error is not None and len(jobs) == 1:
                raise outcome.error
            if on is not None:
                advance(outcome.job.log, 1)
            tell(outcome)

        return run_all(made, jobs, on, workers, hear, advance, **settings, note=partial(click.echo, err=True))


def _write_report(
    path: str, outcomes: Sequence[Outcome], made: Recipe, robot: str, method: str, taken: dict[str, Any]
) -> None:
    from .estimate_page import batch_page, estimate_page

    words = [(name.replace("_", " "), _plain(value)) for name, value in taken.items() if name != "tuning"]
    settings = [("method", method), *words, *([("rate", f"{made.rate:g} Hz")] if made.rate else [])]
    settings += [("tuning", taken["tuning"])] if taken.get("tuning") else []
    one = len(outcomes) == 1
    page = estimate_page(outcomes[0], made, robot, settings) if one else batch_page(outcomes, robot, settings)
    page.write(path)


def _plain(value: object) -> str:
    return "none" if value is None else f"{value}"


def _refuse_untaken(method: str) -> None:
    """An option that the method would not look at is a mistake to hear of."""
    context = click.get_current_context()
    for option in sorted({option for other in METHODS.values() for option in other.takes}):
        given = context.get_parameter_source(option) == click.core.ParameterSource.COMMANDLINE
        if given and option not in METHODS[method].takes:
            raise click.UsageError(f"--{option.replace('_', '-')} is not for --with {method}")
