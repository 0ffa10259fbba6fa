"""A report of what sensors see, and of what is wrong with a recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkside.recording.checks.finding import Finding
from linkside.report import Input, Page, Verdict
from linkside.report.page import Part, paragraphs
from linkside.text import Titled

from .report import CheckReport
from .result import LIMIT
from .words import check_tables


def page(
    report: CheckReport, looked_at: Sequence[tuple[str, str]], refused: Finding | None, inputs: Sequence[Input]
) -> Page:
    """Lay out the report: what sensors see, and what the checks of a recording said, check and verdict in words."""
    words = paragraphs(check_tables(report))
    sections: list[tuple[str, Sequence[Part]]] = []
    if looked_at:
        table = Titled("", ("check", "verdict"))
        for row in looked_at:
            table.add_row(*row)
        sections.append(("The recording", [table]))
    sections.append(("What accelerometers see", words))
    if report.joints and report.robot.accelerometers:
        sections.append(("Where accelerations are lost", [("Where accelerations are lost", report.figure())]))
    return Page(
        f"Check of {report.robot.tree.name}",
        _verdict(report, looked_at, refused),
        [("elastic joints", str(len(report.joints))), ("axes measured", str(len(report.robot.acceleration_channels)))],
        list(_next_steps(report, looked_at, refused)),
        sections,
        inputs,
    )


def _verdict(report: CheckReport, looked_at: Sequence[tuple[str, str]], refused: Finding | None) -> Verdict:
    if refused is not None:
        return Verdict("bad", "No estimate from this recording can be right", (str(refused),))
    if report.joints and not report.observable:
        return Verdict(
            "bad", "The sensors do not distinguish the links' accelerations", ("Methods by accelerometers alone fail.",)
        )
    doubts = tuple(words for _, words in looked_at if words.startswith("suspicious"))
    lost = float(np.mean(report.observability.worst > LIMIT)) if report.joints else 0.0
    if lost > 0:
        doubts += (
            f"In {100 * lost:.2g} % of the workspace "
            f"the standard deviation of some acceleration exceeds {LIMIT:g} rad/s².",
        )
    if doubts:
        return Verdict("doubtful", "It can work, with the reservations below", doubts)
    return Verdict("good", "The sensors observe every link" + (", and the recording is sound" if looked_at else ""))


def _next_steps(report: CheckReport, looked_at: Sequence[tuple[str, str]], refused: Finding | None) -> list[str]:
    if refused is not None:
        return [refused.remedy[:1].upper() + refused.remedy[1:] + "."]
    steps = [] if looked_at else ["Check a recording as well: linkside check robot.yaml log.parquet"]
    if report.joints and not report.observable:
        return [
            *steps,
            "Add accelerometer axes: linkside place robot.yaml --help",
            "A Kalman filter works without, less well.",
        ]
    return [*steps, "Estimate: linkside estimate robot.yaml log.parquet --with ekf --out estimate.parquet"]
