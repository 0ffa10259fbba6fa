"""The figure of a placement: where it is singular, and how well each candidate does alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from linkside.arrays import FloatArray
from linkside.figures import COLOURS, finish, plain_log

from . import figure as maps
from .figure import draw_map, leading_pair, legend_under, regular_cut, scale, spread
from .result import LIMIT, CheckResult, Observability

HOPELESS = 1e3
"""A candidate whose score alone is this many times that of the chosen set observes too little."""


class Scores(NamedTuple):
    """Scores of each candidate alone, with its link, of the set, and of the robot's own sensors; a score's name."""

    alone: Sequence[float]
    links: Sequence[str]
    chosen: float
    before: float
    label: str


def placement_figure(report: CheckResult, names: Sequence[str], scores: Scores) -> Figure:
    """Draw where a set of sensors is singular, see `Placement.figure`."""
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    figure.suptitle(f"{', '.join(names)}: where it loses sight of the links")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    elastic = [joint for joint in map(int, report.influential) if report.robot.elastic[joint]]
    pair = sorted(elastic[:2]) if len(elastic) > 1 else leading_pair(report)
    cut = regular_cut(report, pair, {})
    draw_map(figure, left, report, pair, cut)
    if len(pair) == 2:
        _mark_singular(left, report, pair, cut)
    _ranked(right, scores)
    return figure


def _mark_singular(axes: Any, report: CheckResult, pair: list[int], cut: FloatArray) -> None:
    """Mark, of each kind of singularity, the posture on the map whose lost direction is most purely of that kind."""
    q = spread(report, pair, cut, maps.CELLS)
    observability = Observability.of(report.robot, q)
    lost = observability.worst > LIMIT / 2
    for posture, marker in zip(report.singular, "XPDs*^v", strict=False):
        if lost.any():
            likeness = np.abs(observability.directions[lost, -1] @ posture.direction)
            x, y = (q[lost][np.argmax(likeness), joint] * scale(report, joint) for joint in pair)
            axes.plot(
                x,
                y,
                marker,
                color=COLOURS[1],
                markeredgecolor="white",
                markersize=12,
                label=f"singular: {posture.words}",
            )
    legend_under(axes)


def _ranked(axes: Any, scores: Scores) -> None:
    """Draw each candidate's score alone, by link, and that of the set."""
    alone, rows = np.array(scores.alone), list(dict.fromkeys(scores.links))
    row = np.array([rows.index(link) for link in scores.links])
    able = alone < HOPELESS * scores.chosen
    axes.semilogx(alone[able], row[able], "o", color=COLOURS[0], markersize=5, alpha=0.5, label="a candidate alone")
    axes.axvline(scores.chosen, color=COLOURS[2], label="the chosen set")
    if np.isfinite(scores.before) and scores.before < HOPELESS * scores.chosen:
        axes.axvline(scores.before, color=COLOURS[1], linestyle="--", label="the robot's own sensors")
    counts = np.bincount(row[~able], minlength=len(rows))
    names = [
        f"{link}\n{count} see too little alone" if count else link for link, count in zip(rows, counts, strict=True)
    ]
    low, high = axes.get_xlim()
    axes.set(xlabel=scores.label, ylim=(len(rows) - 0.5, -0.5), xlim=(low / 1.1, 1.1 * high))
    axes.set_yticks(range(len(rows)), names, fontsize="small")
    plain_log(axes.xaxis)
    finish(axes, legend=False)
    legend_under(axes, columns=1)
