"""A report of a calibration to file: one HTML page with its figures inside."""

from __future__ import annotations

import base64
from html import escape
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from linkside.files.writing import write_text

from . import figures
from .result import Result

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STYLE = """
body { font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222 }
table { border-collapse: collapse } td, th { padding: .15em .7em; text-align: right; border-bottom: 1px solid #ddd }
td:first-child, th:first-child, td:last-child { text-align: left } img { max-width: 100% }
.warning { background: #fff2cc; padding: .5em 1em; border-left: 4px solid #e0a800 }
"""


def write(calibration: Result, out: str | Path) -> None:
    """Write the report."""
    write_text(out, to_html(calibration))


def to_html(calibration: Result) -> str:
    """Give the report as one HTML page that needs no other file."""
    sources = ", ".join(log.source for log in calibration.problem.logs)
    parts = [
        f"<h1>Calibration</h1><p>{escape(sources)}: {calibration.after.used} readings, "
        f"{calibration.evaluations} evaluations.</p>",
        *(f'<p class="warning">{escape(str(c))}</p>' for c in calibration.contradictions),
        "<h2>Estimates</h2>",
        _estimates(calibration),
        _image(figures.estimates(calibration), "estimates"),
        _refused(calibration),
        "<h2>Fit</h2>",
        _fit(calibration),
        _image(figures.whiteness(calibration), "autocorrelation of innovations"),
    ]
    if len(calibration.estimates) > 1:
        parts += [
            "<h2>Correlation</h2>",
            _image(figures.correlation(calibration), "correlation"),
            _closest(calibration),
        ]
    title = "linkside calibration"
    body = "\n".join(parts)
    head = f'<meta charset="utf-8"><title>{title}</title><style>{STYLE}</style>'
    return f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n{body}\n</body></html>\n'


def _table(head: list[str], rows: list[list[str]]) -> str:
    cells = "".join(f"<th>{escape(h)}</th>" for h in head)
    lines = ["<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows]
    return "<table><tr>" + cells + "</tr>" + "".join(lines) + "</table>"


def _estimates(calibration: Result) -> str:
    head = ["parameter", "robot.yaml", "estimate", "std. error", "widened by", "unit", ""]
    rows = [
        [
            *(e.parameter.name, f"{e.parameter.start:.5g}", f"{e.value:.5g}", f"{e.std:.2g}", f"{e.widening:.1f}"),
            *(e.parameter.unit, "at its bound" if e.at_bound else ""),
        ]
        for e in calibration.estimates
    ]
    return _table(head, rows)


def _refused(calibration: Result) -> str:
    if not calibration.refused:
        return ""
    rows = [[name, reason] for name, reason in calibration.refused.items()]
    return "<h2>Not estimated</h2>" + _table(["parameter", "reason"], rows)


def _fit(calibration: Result) -> str:
    before, after = calibration.before, calibration.after
    rows = [["log-likelihood", f"{before.log_likelihood:.1f}", f"{after.log_likelihood:.1f}"]]
    if calibration.held_out is not None:
        rows.append(["log-likelihood, held out", *(f"{x:.1f}" for x in calibration.held_out)])
    for i, name in enumerate(calibration.problem.channels):
        rows.append([f"NIS, {name}", f"{before.nis[i]:.3g}", f"{after.nis[i]:.3g}"])
        first = [f"{fit.autocorrelation[0, i]:.2f}" for fit in (before, after)]
        rows.append([f"correlation at lag 1, {name}", *first])
    return _table(["", "before", "after"], rows)


def _closest(calibration: Result) -> str:
    """The profile of the pair that is most correlated."""
    strength = np.abs(calibration.correlation) - np.eye(len(calibration.estimates))
    i, j = np.unravel_index(int(np.argmax(strength)), strength.shape)
    first, second = (calibration.estimates[int(k)].parameter.name for k in (i, j))
    return _image(figures.profile(calibration, first, second), f"profile of {first} and {second}")


def _image(figure: Figure, text: str) -> str:
    data = BytesIO()
    figure.savefig(data, format="png", dpi=110)
    encoded = base64.b64encode(data.getvalue()).decode("ascii")
    return f'<p><img alt="{escape(text)}" src="data:image/png;base64,{encoded}"></p>'
