"""Reports of estimates: of one log, or of many."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from linkside._core import largest_nis
from linkside.fleet.estimating import urdf_of
from linkside.fleet.tally import STATUS_WORDS
from linkside.fleet.task import Outcome, Recipe, read_log
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.recording.overview import Overview
from linkside.recording.overview_figures import residual_figures, status_figures, tool_figures, torsion_figures
from linkside.report import Page, Verdict, inputs
from linkside.report.page import Part, paragraphs
from linkside.robot import Robot
from linkside.text import Titled

from .error_tables import error_tables
from .failures import in_words
from .reporting import all_logs

REMEDIES = {
    "damped": "Some accelerations are poorly observed: see linkside check robot.yaml log.parquet, and linkside place.",
    "unseen": "Some accelerations are not observed at all: linkside check robot.yaml log.parquet names them.",
    "predicted": "Rows without any reading: look at the recorder, or at the clocks of merged files.",
    "gated": "Outliers were rejected: check which channel has them, and whether its noise_std is large enough.",
    "bridged": "Readings are missing when they are due: look at the recorder, if there are many.",
}
"""Advice for flagged rows."""

ODD = 0.01
"""Share of flagged rows from which on the verdict mentions them."""


def estimate_page(outcome: Outcome, made: Recipe, robot_file: str, settings: Sequence[tuple[str, str]]) -> Page:
    """Lay out the report of one log."""
    job, tally = outcome.job, outcome.tally
    view = Overview.of(made.robot, _beside(outcome, made))
    used = tally.used / max(tally.rows, 1)
    sections: list[tuple[str, Sequence[Part]]] = [
        ("Against the truth", paragraphs(error_tables(outcome, made.robot))),
        ("Tool", list(tool_figures(view))),
        ("Springs", list(torsion_figures(view))),
        ("Readings against the estimate", list(residual_figures(view, used))),
        ("Status", [*_status(outcome), *status_figures(view)]),
        ("The recording", [*_suspicions(outcome), *(f"Converted: {words}." for words in outcome.conversions)]),
        ("The robot", [_robot(made.robot)]),
    ]
    tuning = dict(settings).get("tuning")
    files: list[tuple[str, str | Path | None]] = [
        ("robot", robot_file),
        ("URDF", urdf_of(robot_file, made.robot)),
        ("log", job.log),
    ]
    files += [("tuning", tuning), ("truth", job.truth), ("estimate", job.output)]
    return Page(
        f"Estimate of {Path(job.log).name}",
        verdict(outcome),
        list(_facts(outcome, view)),
        list(dict.fromkeys(_next_steps(outcome))),
        [(heading, parts) for heading, parts in sections if parts],
        inputs(files),
        list(settings),
    )


def batch_page(outcomes: Sequence[Outcome], robot_file: str, settings: Sequence[tuple[str, str]]) -> Page:
    """Lay out the report of many logs."""
    failed = [one for one in outcomes if one.error is not None]
    doubted = [one for one in outcomes if one.error is None and not one.believable]
    reasons = [f"{one.job.log}: {in_words(one.error)}" for one in failed if one.error is not None]
    reasons += [f"{one.job.log}: {reason}" for one in doubted for reason in verdict(one).reasons[:1]]
    counts = f"{len(outcomes) - len(failed) - len(doubted)} of {len(outcomes)} estimates"
    if failed or doubted:
        outcome = Verdict("bad" if failed else "doubtful", f"{counts} are without contradiction", tuple(reasons[:20]))
    else:
        outcome = Verdict(
            "good" if any(one.tally.used for one in outcomes) else "open", f"{counts} are without contradiction"
        )
    steps = [step for one in (*failed, *doubted) for step in _next_steps(one)]
    files = [("robot", robot_file), *(("log", one.job.log) for one in outcomes)]
    return Page(
        f"Estimates of {len(outcomes)} logs",
        outcome,
        [("rows", str(sum(one.tally.rows for one in outcomes))), ("not estimated", str(len(failed)))],
        list(dict.fromkeys(steps))[:12],
        [("All logs, the worst first", [all_logs(outcomes)])],
        inputs(files),
        list(settings),
    )


def verdict(outcome: Outcome) -> Verdict:
    """Whether to trust an estimate: by its readings, its status, and what was suspicious in the recording."""
    tally = outcome.tally
    doubts = [
        f"{100 * count / tally.rows:.2g} % of the rows: {STATUS_WORDS.get(word, word)}" for word, count in _odd(outcome)
    ]
    doubts += [str(found) for found in outcome.suspicions if found.verdict == "suspicious"]
    if tally.findings or tally.status["contradicted"]:
        faults = [str(fault) for fault in tally.findings] or ["Rows are in contradiction to the model."]
        return Verdict("bad", "Readings contradict this estimate", (*faults, *doubts))
    if not tally.believable:
        per_reading, most = tally.nis / tally.used, largest_nis(tally.used) / tally.used
        much = f"NIS {per_reading:.3g} per reading, where {most:.3g} is the most"
        return Verdict(
            "doubtful", "Readings are further from their predictions than their noise allows", (much, *doubts)
        )
    if doubts:
        return Verdict("doubtful", "No reading contradicts this estimate, with what is said below", tuple(doubts))
    if not tally.used:
        why = "This method does not judge its own predictions: --with ekf or smoother on the same log does."
        return Verdict("open", "Nothing was found that speaks against this estimate", (why,))
    return Verdict("good", "No row, channel or finding contradicts this estimate")


def _odd(outcome: Outcome) -> Iterator[tuple[str, int]]:
    for word, count in outcome.tally.status.items():
        if word not in ("good", "contradicted", "faulty", "unwrapped") and count > ODD * outcome.tally.rows:
            yield word, count


def _next_steps(outcome: Outcome) -> Iterator[str]:
    tally = outcome.tally
    if outcome.error is not None:
        yield f"Look at the log by itself: linkside check robot.yaml {outcome.job.log}"
        return
    for fault in tally.findings:
        yield f"{fault.channel or 'No single channel'}: likely {'; or '.join(fault.causes)}."
    for found in outcome.suspicions:
        if found.verdict == "suspicious":
            yield f"{found.column}: {found.remedy}."
    yield from (REMEDIES[word] for word, _ in _odd(outcome) if word in REMEDIES)
    if not tally.believable:
        yield "Find springs, load and sensor errors: linkside calibrate robot.yaml log.parquet --out new.yaml"
        if not tally.findings:
            yield "Find the noise by the log: linkside tune robot.yaml log.parquet --out tuning.yaml"
    elif tally.used:
        yield "Compare with a truth or with another method: linkside compare other.parquet estimate.parquet"


def _beside(outcome: Outcome, made: Recipe) -> Iterator[tuple[Log, Estimate]]:
    """The log and its estimate, piece by piece."""
    job, rows = outcome.job, min(made.rows, 65_536)
    pieces = (whole[first : first + rows] for whole in read_log(made, job.log) for first in range(0, len(whole), rows))
    yield from zip(pieces, Estimate.stream(job.output, rows), strict=True)


def _facts(outcome: Outcome, view: Overview) -> Iterator[tuple[str, str]]:
    tally = outcome.tally
    yield "rows", f"{tally.rows}, {tally.motion:.6g} s"
    yield "good", f"{100 * tally.status['good'] / max(tally.rows, 1):.4g} %"
    if tally.used:
        yield "NIS per reading", f"{tally.nis / tally.used:.3g} (1 if the noise is right)"
    if view.bend:
        yield "springs move the tool by up to", f"{1e3 * view.bend.largest[0]:.3g} mm"
    if view.tool_std:
        yield "tool's 2σ, largest", f"{2e3 * float(view.tool_std.largest.max()):.3g} mm"
    if tally.disturbed:
        name, torque = max(tally.disturbed.items(), key=lambda item: item[1])
        yield "largest disturbance torque", f"{torque:.3g} N m, {name}"


def _status(outcome: Outcome) -> list[Titled]:
    table = Titled("", ("rows", "count", "in words"))
    for word, count in outcome.tally.status.items():
        if count:
            table.add_row(word, str(count), STATUS_WORDS.get(word, "nothing to report"))
    return [table] if table.rows else []


def _suspicions(outcome: Outcome) -> list[Titled]:
    table = Titled("", ("verdict", "what the checks found"))
    for found in outcome.suspicions:
        table.add_row(found.verdict, str(found))
    return [table] if table.rows else []


def _robot(robot: Robot) -> Titled:
    table = Titled(robot.tree.name, ("joint", "stiffness", "damping", "motor inertia", "gear ratio"))
    for drive in robot.drives:
        values = (drive.stiffness, drive.damping, drive.motor_inertia) if drive.elastic else ("rigid", "–", "–")
        table.add_row(drive.name, *(v if isinstance(v, str) else f"{v:.4g}" for v in values), f"{drive.gear_ratio:g}")
    return table
