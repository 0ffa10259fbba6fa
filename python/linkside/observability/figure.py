"""The figure of what accelerometers see: over the workspace, and along a recording."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.figures import COLOURS, finish, line_style, plain_log
from linkside.robot.workspace import prismatic, sobol

from .result import LIMIT, CheckResult, Observability
from .words import check_words

LOST: dict[str, Any] = {"color": "0.4", "linestyle": (0, (1, 2)), "label": f"{LIMIT:g} rad/s²: lost"}
"""How the limit is drawn from which an acceleration counts as lost."""

CELLS = 120
"""Cells of a map along each joint."""

FINER = 3
"""Postures in a cell along each joint."""

POINTS = 4000
CUTS = 64
"""Postures of the other joints among which a map's is chosen."""

COARSE = 12
"""Postures along each joint of the map by which it is chosen."""


def check_figure(
    report: CheckResult, over: Sequence[str] | None = None, at: Mapping[str, float] | None = None
) -> Figure:
    """Draw where accelerations are lost, see `CheckReport.figure`."""
    if not (report.observable and report.joints):
        return _words_only(report)
    rows = 1 if report.path is None else 2
    pair = leading_pair(report) if over is None else chosen_pair(report, over)
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.25, 1))
    figure.suptitle(f"{report.robot.tree.name}: how well the accelerometers see the links")
    draw_map(figure, figure.add_subplot(grid[:, 0]), report, pair, regular_cut(report, pair, at or {}))
    _shares(figure.add_subplot(grid[0, 1]), report)
    if report.path is not None:
        _along(figure.add_subplot(grid[1, 1]), report)
    return figure


def leading_pair(report: CheckResult) -> list[int]:
    """The two joints whose position matters most."""
    first = [int(joint) for joint in report.influential]
    return sorted((first + [joint for joint in range(report.robot.n) if joint not in first])[:2])


def chosen_pair(report: CheckResult, over: Sequence[str]) -> list[int]:
    """The joints that were asked for."""
    names = report.robot.names
    if len(over) != len(set(over)) or len(over) != min(2, len(names)) or not set(over) <= set(names):
        raise EstimatorError(
            f"a map is over two of the joints {', '.join(names)}, not over {', '.join(over) or 'none'}"
        )
    return [names.index(name) for name in over]


def regular_cut(report: CheckResult, pair: list[int], at: Mapping[str, float]) -> FloatArray:
    """A posture (n,) to hold the other joints at, as ``at`` says, else near home: there most of the map is regular.

    A posture that is singular for a joint beyond the map makes a map that is singular everywhere.
    """
    names = report.robot.names
    if unknown := set(at) - set(names):
        raise EstimatorError(f"the robot has no joint {min(unknown)!r}, only {', '.join(names)}")
    low, high = report.limits
    postures = np.vstack([report.home, low + sobol(report.robot.n)[:CUTS] * (high - low)])
    for name, position in at.items():
        postures[:, names.index(name)] = position
    if len(pair) == 1:
        return np.array(postures[0], float)
    worst = [np.median(Observability.of(report.robot, spread(report, pair, cut, COARSE)).worst) for cut in postures]
    distance = np.linalg.norm((postures - report.home) / (high - low), axis=1)
    good = np.asarray(worst) <= 2 * min(worst)
    return np.asarray(postures[good][np.argmin(distance[good])])


def draw_map(figure: Figure, axes: Any, report: CheckResult, pair: list[int], cut: FloatArray) -> None:
    """Draw the worst combination's standard deviation over two joints, the others held as in ``cut`` (n,)."""
    if len(pair) == 1:
        _line(axes, report)
        return
    x, y, deviation = _sweep(report, pair, cut)
    norm = LogNorm(deviation.min(), max(LIMIT, 2 * deviation.min()), clip=True)
    image = axes.pcolormesh(x, y, deviation, norm=norm, cmap="cividis", rasterized=True)
    bar = figure.colorbar(image, ax=axes, extend="max", label="standard deviation of the worst combination [rad/s²]")
    plain_log(bar.ax.yaxis)
    if report.path is not None:
        _draw_path(axes, report, pair)
    axes.set(xlabel=_label(report, pair[0]), ylabel=_label(report, pair[1]))
    axes.set_title(_held(report, pair, cut), fontsize="medium")


def _sweep(report: CheckResult, pair: list[int], cut: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Standard deviation over two joints; degrees where a joint turns.

    A cell shows the worst of some postures in it, or else narrow singular curves would fall between the samples.
    """
    low, high = report.limits
    q = spread(report, pair, cut, CELLS * FINER)
    worst = np.concatenate([Observability.of(report.robot, part).worst for part in np.array_split(q, 16)])
    cells = np.minimum(worst, 1e12).reshape(CELLS, FINER, CELLS, FINER).max(axis=(1, 3))
    edges = (np.linspace(low[j], high[j], CELLS + 1) * scale(report, j) for j in pair)
    return next(edges), next(edges), cells


def spread(report: CheckResult, pair: list[int], cut: FloatArray, count: int) -> FloatArray:
    """Postures over two joints, ``count`` along each, all others as in ``cut`` (n,)."""
    low, high = report.limits
    middles = (np.arange(count) + 0.5) / count
    x, y = (low[joint] + middles * (high - low)[joint] for joint in pair)
    q = np.tile(cut, (count * count, 1))
    q[:, pair[0]], q[:, pair[1]] = np.tile(x, count), np.repeat(y, count)
    return q


def _draw_path(axes: Any, report: CheckResult, pair: list[int]) -> None:
    assert report.path is not None
    rows = _thinned(len(report.path.t))
    x, y = (report.path.q[rows, joint] * scale(report, joint) for joint in pair)
    axes.plot(x, y, color="white", linewidth=4, solid_capstyle="round")
    axes.plot(x, y, color=COLOURS[1], linewidth=2, solid_capstyle="round", label="the log")
    axes.plot(x[0], y[0], "o", color=COLOURS[1], markeredgecolor="white", markersize=9, label="its start")
    legend_under(axes)


def legend_under(axes: Any, columns: int = 2) -> None:
    """Put the legend below axes that have no room beside them."""
    if axes.get_legend_handles_labels()[1]:
        place = {"loc": "upper left", "bbox_to_anchor": (0.0, -0.11), "borderaxespad": 0.0}
        axes.legend(**place, ncols=columns, fontsize="small", frameon=False)


def _line(axes: Any, report: CheckResult) -> None:
    """A robot of one joint has no map, but a curve."""
    q = np.linspace(report.limits[0, 0], report.limits[1, 0], POINTS)
    worst = Observability.of(report.robot, q[:, None]).worst
    axes.semilogy(q * scale(report, 0), np.minimum(worst, 1e12), color=COLOURS[0])
    axes.set(xlabel=_label(report, 0), ylabel="standard deviation [rad/s²]", title="over the workspace")
    axes.set_ylim(worst.min() / 3, 3 * max(LIMIT, worst.min()))
    axes.axhline(LIMIT, **LOST)
    plain_log(axes.yaxis)
    finish(axes)


def _shares(axes: Any, report: CheckResult) -> None:
    """Draw the share of the workspace in which each joint is seen at least so well."""
    share = np.linspace(0, 100, 1001)
    for name, values, style in _styled(report.joints, report.observability.joints):
        ranked = np.quantile(values, share / 100, method="lower")
        axes.semilogx(np.minimum(ranked, 1e12), share, label=name, **style)
    axes.axvline(LIMIT, **LOST)
    right = 30 * LIMIT
    axes.set(xlim=(None, right), ylabel="share of the workspace [%]", title="seen at least so well, over the workspace")
    axes.set_xlabel("standard deviation of link acceleration [rad/s²]")
    plain_log(axes.xaxis)
    finish(axes)


def _along(axes: Any, report: CheckResult) -> None:
    """Draw each joint's standard deviation along the log, the worst of every stretch of it."""
    assert report.path is not None
    rows = _thinned(len(report.path.t))
    worst = np.maximum.reduceat(report.path.joints, rows, axis=0)
    for name, values, style in _styled(report.joints, np.minimum(worst, 1e12)):
        axes.semilogy(report.path.t[rows], values, label=name, **style)
    top = max(1.5 * LIMIT, min(1.2 * float(worst.max()), 1e3 * LIMIT))
    axes.axhline(LIMIT, **LOST)
    axes.set(xlabel="time [s]", ylabel="standard deviation [rad/s²]", ylim=(None, top), title="along the log")
    plain_log(axes.yaxis)
    finish(axes, legend=False)


def _styled(joints: Iterable[str], values: FloatArray) -> Iterable[tuple[str, FloatArray, dict[str, Any]]]:
    """A colour and a dash for each joint: lines that coincide stay visible."""
    for index, name in enumerate(joints):
        yield name, values[:, index], line_style(index)


def _words_only(report: CheckResult) -> Figure:
    figure = Figure(figsize=(8, 2), layout="constrained")
    figure.text(0.5, 0.5, "\n".join(check_words(report)), ha="center", va="center", wrap=True)
    return figure


def _thinned(rows: int) -> npt.NDArray[np.intp]:
    return np.arange(0, rows, 1 + rows // POINTS)


def _held(report: CheckResult, pair: list[int], cut: FloatArray) -> str:
    held = [joint for joint in sorted(map(int, report.influential)) if joint not in pair]
    places = (f"{report.robot.names[j]} = {cut[j] * scale(report, j):.1f}{_unit(report, j)}" for j in held)
    others = textwrap.fill(f"at {', '.join(places)}", 54) if held else ""
    return f"worst combination of link accelerations\n{others}".strip()


def _label(report: CheckResult, joint: int) -> str:
    return f"{report.robot.names[joint]} [{_unit(report, joint)}]"


def _unit(report: CheckResult, joint: int) -> str:
    return "m" if prismatic(report.robot)[joint] else "°"


def scale(report: CheckResult, joint: int) -> float:
    """What a position is multiplied by to be shown, in degrees where a joint turns."""
    return 1.0 if prismatic(report.robot)[joint] else 180 / np.pi
