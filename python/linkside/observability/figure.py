"""The figure of what accelerometers see: over the workspace, and along a recording."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from linkside.arrays import FloatArray
from linkside.figures import COLOURS, finish
from linkside.robot.workspace import prismatic

from .result import LIMIT, CheckResult, Observability
from .words import check_words

CELLS = 180
FINER = 3
POINTS = 4000


def check_figure(report: CheckResult) -> Figure:
    """Draw where accelerations are lost, see `CheckReport.figure`."""
    if not (report.observable and report.joints):
        return _words_only(report)
    rows = 1 if report.path is None else 2
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.25, 1))
    figure.suptitle(f"{report.robot.model.name}: how well the accelerometers see the links")
    draw_map(figure, figure.add_subplot(grid[:, 0]), report, leading_pair(report))
    _shares(figure.add_subplot(grid[0, 1]), report)
    if report.path is not None:
        _along(figure.add_subplot(grid[1, 1]), report)
    return figure


def leading_pair(report: CheckResult) -> list[int]:
    """The two joints whose position matters most."""
    first = [int(joint) for joint in report.influential]
    return sorted((first + [joint for joint in range(report.robot.n) if joint not in first])[:2])


def draw_map(figure: Figure, axes: Any, report: CheckResult, pair: list[int]) -> None:
    """Draw the worst combination's standard deviation over two joints."""
    if len(pair) == 1:
        _line(axes, report)
        return
    x, y, deviation = _sweep(report, pair[0], pair[1])
    norm = LogNorm(deviation.min(), max(LIMIT, 2 * deviation.min()), clip=True)
    image = axes.pcolormesh(x, y, deviation, norm=norm, cmap="cividis", rasterized=True)
    figure.colorbar(image, ax=axes, extend="max", label="standard deviation of the worst combination [rad/s²]")
    if report.path is not None:
        _draw_path(axes, report, pair)
    axes.set(xlabel=_label(report, pair[0]), ylabel=_label(report, pair[1]), title=_held(report, pair))


def _sweep(report: CheckResult, across: int, up: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Standard deviation over two joints, all others at home; degrees where a joint turns.

    A cell shows the worst of some postures in it, or else narrow singular curves would fall between the samples.
    """
    low, high, q = spread(report, across, up, CELLS * FINER)
    worst = np.concatenate([Observability.of(report.robot, part).worst for part in np.array_split(q, 16)])
    cells = np.minimum(worst, 1e12).reshape(CELLS, FINER, CELLS, FINER).max(axis=(1, 3))
    edges = (np.linspace(low[j], high[j], CELLS + 1) * scale(report, j) for j in (across, up))
    return next(edges), next(edges), cells


def spread(report: CheckResult, across: int, up: int, count: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Limits of all joints, and postures over two of them, `count` along each, all others at home."""
    low, high = report.limits
    middles = (np.arange(count) + 0.5) / count
    x, y = (low[joint] + middles * (high - low)[joint] for joint in (across, up))
    q = np.tile(report.home, (count * count, 1))
    q[:, across], q[:, up] = np.tile(x, count), np.repeat(y, count)
    return low, high, q


def _draw_path(axes: Any, report: CheckResult, pair: list[int]) -> None:
    assert report.path is not None
    rows = _thinned(len(report.path.t))
    x, y = (report.path.q[rows, joint] * scale(report, joint) for joint in pair)
    axes.plot(x, y, color="white", linewidth=4, solid_capstyle="round")
    axes.plot(x, y, color=COLOURS[1], linewidth=2, solid_capstyle="round", label="the log")
    axes.plot(x[0], y[0], "o", color=COLOURS[1], markeredgecolor="white", markersize=9, label="its start")
    axes.legend(loc="upper right")


def _line(axes: Any, report: CheckResult) -> None:
    """A robot of one joint has no map, but a curve."""
    q = np.linspace(report.limits[0, 0], report.limits[1, 0], POINTS)
    worst = Observability.of(report.robot, q[:, None]).worst
    axes.semilogy(q * scale(report, 0), np.minimum(worst, 1e12), color=COLOURS[0])
    axes.set(xlabel=_label(report, 0), ylabel="standard deviation [rad/s²]", title="over the workspace")
    axes.set_ylim(worst.min() / 3, 3 * max(LIMIT, worst.min()))
    axes.axhline(LIMIT, color="0.4", linestyle=":")
    finish(axes, legend=False)


def _shares(axes: Any, report: CheckResult) -> None:
    """Draw the share of the workspace in which each joint is seen at least so well."""
    share = np.linspace(0, 100, 1001)
    for name, values, style in _styled(report.joints, report.observability.joints):
        ranked = np.quantile(values, share / 100, method="lower")
        axes.semilogx(np.minimum(ranked, 1e12), share, label=name, **style)
    axes.axvline(LIMIT, color="0.4", linestyle=":")
    right = 30 * LIMIT
    axes.set(xlim=(None, right), ylabel="share of the workspace [%]", title="seen at least so well, over the workspace")
    axes.set_xlabel("standard deviation of link acceleration [rad/s²]")
    finish(axes)


def _along(axes: Any, report: CheckResult) -> None:
    """Draw each joint's standard deviation along the log, the worst of every stretch of it."""
    assert report.path is not None
    rows = _thinned(len(report.path.t))
    worst = np.maximum.reduceat(report.path.joints, rows, axis=0)
    for name, values, style in _styled(report.joints, np.minimum(worst, 1e12)):
        axes.semilogy(report.path.t[rows], values, label=name, **style)
    top = max(1.5 * LIMIT, min(1.2 * float(worst.max()), 1e3 * LIMIT))
    axes.axhline(LIMIT, color="0.4", linestyle=":")
    axes.set(xlabel="time [s]", ylabel="standard deviation [rad/s²]", ylim=(None, top), title="along the log")
    finish(axes, legend=False)


def _styled(joints: Iterable[str], values: FloatArray) -> Iterable[tuple[str, FloatArray, dict[str, Any]]]:
    """A colour and a dash for each joint: lines that coincide stay visible."""
    dashes = ("-", "--", "-.", ":")
    for index, name in enumerate(joints):
        style = {"color": COLOURS[index % len(COLOURS)], "linestyle": dashes[index % len(dashes)]}
        yield name, values[:, index], style


def _words_only(report: CheckResult) -> Figure:
    figure = Figure(figsize=(8, 2), layout="constrained")
    figure.text(0.5, 0.5, "\n".join(check_words(report)), ha="center", va="center", wrap=True)
    return figure


def _thinned(rows: int) -> npt.NDArray[np.intp]:
    return np.arange(0, rows, 1 + rows // POINTS)


def _held(report: CheckResult, pair: list[int]) -> str:
    held = [joint for joint in sorted(map(int, report.influential)) if joint not in pair]
    places = (f"{report.robot.names[j]} = {report.home[j] * scale(report, j):.1f}{_unit(report, j)}" for j in held)
    others = textwrap.fill(f"at {', '.join(places)}", 60) if held else ""
    return f"worst combination of link accelerations\n{others}".strip()


def _label(report: CheckResult, joint: int) -> str:
    return f"{report.robot.names[joint]} [{_unit(report, joint)}]"


def _unit(report: CheckResult, joint: int) -> str:
    return "m" if prismatic(report.robot)[joint] else "°"


def scale(report: CheckResult, joint: int) -> float:
    """What a position is multiplied by to be shown, in degrees where a joint turns."""
    return 1.0 if prismatic(report.robot)[joint] else 180 / np.pi
