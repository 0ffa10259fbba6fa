"""Calibration for the command line, from files to files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from linkside.calibration import Calibration, Step, calibrate
from linkside.calibration import resume as state
from linkside.errors import EstimatorError
from linkside.files.writing import check_writable
from linkside.recording.log import Log
from linkside.report import inputs
from linkside.robot import Robot


def run(
    robot: str,
    logs: Sequence[str],
    out: str,
    resume: bool,
    advance: Callable[[str, int], None],
    *,
    report: str | None,
    free: str | None,
    torque: bool | None,
    bounds: Sequence[str],
    held_out: Sequence[str],
    force: bool,
    no_check: bool = False,
) -> Calibration:
    """Calibrate, and write an accepted result, or with ``force`` any; the best so far is kept beside ``out``."""
    partial = Path(f"{out}.partial")
    check_writable(partial, (".partial",))
    start = state.kept(partial) if resume else None
    limits = dict(map(_bound, bounds))
    loaded = Robot.load(robot)

    def show(step: Step) -> None:
        state.keep(partial, step)
        change = f"{step.changed} by {step.change:+.3g} tolerances" if step.change else "start"
        advance(f"log-likelihood {step.log_likelihood:.1f}, {change}", 1)

    result = calibrate(
        loaded,
        [Log.read(log, loaded, check=not no_check) for log in logs],
        None if free is None else free.split(","),
        torque=torque,
        bounds=limits,
        held_out=[Log.read(log, loaded, check=not no_check) for log in held_out],
        start=start,
        progress=show,
    )
    if result.accepted or force:
        result.write(robot, out)
    if report is not None:
        files = [("robot", robot), *(("log", log) for log in logs), *(("log held out", log) for log in held_out)]
        result.write_report(report, inputs(files))
    partial.unlink(missing_ok=True)
    return result


def _bound(text: str) -> tuple[str, tuple[float, float]]:
    name, _, interval = text.partition("=")
    low, _, high = interval.partition(":")
    try:
        return name, (float(low), float(high))
    except ValueError:
        raise EstimatorError(f"--bound {text}: expected NAME=LOW:HIGH") from None
