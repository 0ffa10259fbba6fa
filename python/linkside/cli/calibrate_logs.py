"""Calibration for the command line, from files to files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from linkside.calibration import Calibration, Step, calibrate
from linkside.calibration import resume as state
from linkside.errors import EstimatorError
from linkside.files.writing import check_writable
from linkside.fleet import mapped
from linkside.fleet.places import from_anywhere
from linkside.recording.log import Log
from linkside.report import inputs
from linkside.robot import Robot


def run(
    robot: str,
    logs: Sequence[str],
    out: str,
    resume: bool,
    advance: Callable[[str, int], None],
    note: Callable[[str], None],
    *,
    on: str | None,
    workers: int | None,
    report: str | None,
    free: str | None,
    torque: bool | None,
    bounds: Sequence[str],
    held_out: Sequence[str],
    force: bool,
    no_check: bool = False,
) -> Calibration:
    """Calibrate, and write an accepted result, or with ``force`` any; the best so far is kept beside ``out``.

    Logs are paths or URLs, evaluated ``workers`` at a time, where ``on`` says.
    """
    best = Path(f"{out}.partial")
    check_writable(best, (".partial",))
    start = state.kept(best) if resume else None
    limits = dict(map(_bound, bounds))
    loaded = Robot.load(robot)

    def show(step: Step) -> None:
        state.keep(best, step)
        change = f"{step.changed} by {step.change:+.3g} tolerances" if step.change else "start"
        advance(f"log-likelihood {step.log_likelihood:.1f}, {change}", 1)

    recordings, tests = (
        [from_anywhere(partial(_read, log, loaded, check=not no_check), log) for log in names]
        for names in (logs, held_out)
    )
    with mapped(on, workers, len(logs), note) as evaluated:
        result = calibrate(
            loaded,
            recordings,
            None if free is None else free.split(","),
            torque=torque,
            bounds=limits,
            held_out=tests,
            start=start,
            progress=show,
            run=evaluated,
        )
    if result.accepted or force:
        result.write(robot, out)
    if report is not None:
        files = [("robot", robot), *(("log", log) for log in logs), *(("log held out", log) for log in held_out)]
        result.write_report(report, inputs(files))
    best.unlink(missing_ok=True)
    return result


def _read(name: str, robot: Robot, path: str, *, check: bool) -> Log:
    """Read a log, or the copy of one, which is called by its own name."""
    return replace(Log.read(path, robot, check=check), source=name)


def _bound(text: str) -> tuple[str, tuple[float, float]]:
    name, _, interval = text.partition("=")
    low, _, high = interval.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise EstimatorError(f"--bound {text}: expected NAME=LOW:HIGH") from None
