"""A report of a calibration: its verdict, estimates, fit and correlations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from linkside.report import Input, Page, Verdict
from linkside.report.page import Part
from linkside.text import Titled

from . import figures
from .result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def page(calibration: Result, inputs: Sequence[Input] = ()) -> Page:
    """Lay out the report; ``inputs`` are the files it was made from."""
    sources = ", ".join(log.source for log in calibration.problem.logs)
    sections: list[tuple[str, Sequence[Part]]] = [
        (
            "Estimates",
            [_estimates(calibration), ("Estimates, as distances from robot.yaml", figures.estimates(calibration))],
        ),
        ("Not estimated", [_refused(calibration)] if calibration.refused else []),
        ("Fit", [_fit(calibration), ("Autocorrelation of innovations", figures.whiteness(calibration))]),
        ("Correlation", _correlations(calibration) if len(calibration.estimates) > 1 else []),
    ]
    return Page(
        f"Calibration by {sources}",
        _verdict(calibration),
        [
            ("readings", str(calibration.after.used)),
            ("parameters", str(len(calibration.estimates))),
            *_foretold(calibration),
        ],
        list(_next_steps(calibration)),
        [(heading, parts) for heading, parts in sections if parts],
        inputs,
    )


def _verdict(calibration: Result) -> Verdict:
    doubts = tuple(str(c) for c in (*calibration.contradictions, *calibration.notes))
    if not calibration.accepted:
        return Verdict("bad", "Do not use these values", (*calibration.objections, *doubts))
    if doubts:
        return Verdict("doubtful", "These values can be used, with reservations", doubts)
    return Verdict("good", "These values predict readings that they were not fitted to")


def _foretold(calibration: Result) -> list[tuple[str, str]]:
    told = [] if calibration.foretold is None else [("foretold", str(calibration.foretold))]
    if calibration.held_out is not None:
        before, after = calibration.held_out
        told.append(("logs held out, log-likelihood", f"{before:.1f} before, {after:.1f} after"))
    return told


def _next_steps(calibration: Result) -> list[str]:
    excite = "linkside excite robot.yaml log.parquet --out motion.parquet"
    if not calibration.accepted:
        steps = ["Record a faster motion of all joints, with the tool's load as in robot.yaml, and calibrate again."]
    else:
        steps = ["Estimate with the new robot.yaml a recording that was not used here, and look at its verdict."]
        if bounds := [e.parameter.name for e in calibration.estimates if e.at_bound]:
            steps.append(f"At their bounds: {', '.join(bounds)}. Widen them (--bound), or hold them fixed.")
    return [*steps, f"Plan a motion for what is not estimated: {excite}"] if calibration.refused else steps


def _estimates(calibration: Result) -> Titled:
    table = Titled("", ("parameter", "robot.yaml", "estimate", "std. error", "widened by", "unit", ""))
    for e in calibration.estimates:
        values = f"{e.parameter.start:.5g}", f"{e.value:.5g}", f"{e.std:.2g}", f"{e.widening:.1f}"
        table.add_row(e.parameter.name, *values, e.parameter.unit, "at its bound" if e.at_bound else "")
    return table


def _refused(calibration: Result) -> Titled:
    table = Titled("", ("parameter", "reason"))
    for name, reason in calibration.refused.items():
        table.add_row(name, reason)
    return table


def _fit(calibration: Result) -> Titled:
    before, after = calibration.before, calibration.after
    table = Titled("", ("", "before", "after"))
    table.add_row("log-likelihood", f"{before.log_likelihood:.1f}", f"{after.log_likelihood:.1f}")
    for i, name in enumerate(calibration.problem.channels):
        table.add_row(f"NIS, {name}", f"{before.nis[i]:.3g}", f"{after.nis[i]:.3g}")
        first = [f"{fit.autocorrelation[0, i]:.2f}" for fit in (before, after)]
        table.add_row(f"correlation at lag 1, {name}", *first)
    return table


def _correlations(calibration: Result) -> list[tuple[str, Figure]]:
    """All of them, and the profile of the pair that is most correlated."""
    strength = np.abs(calibration.correlation) - np.eye(len(calibration.estimates))
    i, j = np.unravel_index(int(np.argmax(strength)), strength.shape)
    first, second = (calibration.estimates[int(k)].parameter.name for k in (i, j))
    return [
        ("Correlation", figures.correlation(calibration)),
        (f"Profile of {first} and {second}", figures.profile(calibration, first, second)),
    ]
