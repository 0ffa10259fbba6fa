"""Tables of how far estimates are from the truth."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType

from linkside.fleet import Outcome
from linkside.recording.estimate import EstimateError
from linkside.robot import Robot
from linkside.robot.workspace import prismatic
from linkside.text import Titled


def error_tables(outcome: Outcome, robot: Robot) -> Iterator[RenderableType]:
    """Errors against the truth, if there is one: of the tool, beside that of motors alone, and of each joint."""
    if not outcome.errors:
        return
    error, *motors = outcome.errors
    if error.tool_rms_mm is not None:
        beside = {"motors alone": motors[0]} if motors else {}
        yield tool_table(beside | {"estimate": error}, str(outcome.job.truth))
    if any(signal.partition("_")[0] in ("q", "dq", "theta", "dtheta") for signal in error.rms):
        yield _joint_errors(error, robot)


def tool_table(errors: dict[str, EstimateError], title: str) -> Titled:
    """Distance of the tool from the truth, a row for each estimate."""
    heads = ("RMS", "largest", "RMS, offset out", "largest, offset out")
    table = Titled(f"tool error against {title} [mm]", ("", *heads))
    for name, error in errors.items():
        values = (error.tool_rms_mm, error.tool_max_mm, error.tool_rms_centred_mm, error.tool_max_centred_mm)
        table.add_row(name, *("–" if value is None else f"{value:.4f}" for value in values))
    return table


def _joint_errors(error: EstimateError, robot: Robot) -> Titled:
    signals = ("q", "dq", "theta", "dtheta")
    table = Titled("error by joint, RMS", ("joint", *signals))
    for name, slides in zip(robot.names, prismatic(robot), strict=True):
        unit = "m" if slides else "rad"
        cells = []
        for signal in signals:
            value = error.rms.get(f"{signal}_{name}")
            cells.append("–" if value is None else f"{1e6 * value:.4g} µ{unit}{'/s' * signal.startswith('d')}")
        table.add_row(name, *cells)
    return table
