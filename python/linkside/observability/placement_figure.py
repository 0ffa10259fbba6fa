"""The figure of a placement: where it is singular, and how well each candidate does alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from linkside.figures import COLOURS, finish

from .figure import CELLS, draw_map, leading_pair, scale, spread
from .result import LIMIT, CheckResult, Observability


class Scores(NamedTuple):
    """Scores of each candidate alone, of the set, and of the robot's own sensors; what a score is called."""

    alone: Sequence[float]
    chosen: float
    before: float
    label: str


def placement_figure(report: CheckResult, names: Sequence[str], scores: Scores) -> Figure:
    """Draw where a set of sensors is singular, see `Placement.figure`."""
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    figure.suptitle(f"{', '.join(names)}: where it loses sight of the links")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    elastic = [joint for joint in map(int, report.influential) if report.robot.elastic[joint]]
    pair = sorted(elastic[:2]) if len(elastic) > 1 else leading_pair(report)
    draw_map(figure, left, report, pair)
    if len(pair) == 2:
        _mark_singular(left, report, pair)
    _ranked(right, scores)
    return figure


def _mark_singular(axes: Any, report: CheckResult, pair: list[int]) -> None:
    """Mark, of each kind of singularity, the posture on the map whose lost direction is most purely of that kind."""
    q = spread(report, pair[0], pair[1], CELLS)[2]
    observability = Observability.of(report.robot, q)
    lost = observability.worst > LIMIT / 2
    for posture, marker in zip(report.singular, "XPDs*^v", strict=False):
        if lost.any():
            likeness = np.abs(observability.directions[lost, -1] @ posture.direction)
            x, y = (q[lost][np.argmax(likeness), joint] * scale(report, joint) for joint in pair)
            axes.plot(x, y, marker, color=COLOURS[1], markeredgecolor="white", markersize=12, label=posture.words)
    axes.legend(loc="lower left", title="singular for")


def _ranked(axes: Any, scores: Scores) -> None:
    """Draw each candidate's score alone, the best first, and that of the set."""
    alone = np.sort(np.array(scores.alone))
    shown = np.minimum(alone, 1e4 * scores.chosen)
    axes.semilogy(np.arange(1, len(shown) + 1), shown, ".", color=COLOURS[0], label="candidates alone")
    axes.axhline(scores.chosen, color=COLOURS[2], label="the chosen set")
    if np.isfinite(scores.before):
        axes.axhline(scores.before, color=COLOURS[1], linestyle="--", label="the robot's own sensors")
    axes.set(xlabel="candidate", ylabel=scores.label)
    finish(axes)
