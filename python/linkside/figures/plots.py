"""Figures, drawn without a display; colours that colour-blind readers can tell apart (Okabe and Ito)."""

from __future__ import annotations

import os
import tempfile
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from linkside.errors import OutputError
from linkside.observability.analysis import LIMIT, CheckReport, Sight, prismatic

if TYPE_CHECKING:
    from linkside.demo.run import DemoResult
    from linkside.observability.placement import Placement
    from linkside.tuning.observer_front import Front

Array = npt.NDArray[np.float64]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
SUFFIXES = (".png", ".pdf", ".svg")
CELLS = 180
FINER = 3
POINTS = 4000


def check_writable(path: str | Path) -> None:
    """Raise `OutputError` when a figure could not be written to ``path``; nothing there is changed."""
    path = Path(path)
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: a file that ends in {', '.join(SUFFIXES)} is expected")
    if path.exists() and not (path.is_file() and os.access(path, os.W_OK)):
        raise OutputError(f"{path}: this cannot be written over")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure in the format of its suffix, whole or not at all."""
    check_writable(path)
    path = Path(path)
    part = path.with_name(f".{os.getpid()}.part{path.suffix}")
    try:
        figure.savefig(part, dpi=150)
        os.replace(part, path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    finally:
        part.unlink(missing_ok=True)


def check_figure(report: CheckReport) -> Figure:
    """Draw where accelerations are lost, see `CheckReport.figure`."""
    if not (report.observable and report.joints):
        return _words_only(report)
    rows = 1 if report.path is None else 2
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    grid = figure.add_gridspec(rows, 2, width_ratios=(1.25, 1))
    figure.suptitle(f"{report.robot.model.name}: how well the accelerometers see the links")
    _map(figure, figure.add_subplot(grid[:, 0]), report, _pair(report))
    _shares(figure.add_subplot(grid[0, 1]), report)
    if report.path is not None:
        _along(figure.add_subplot(grid[1, 1]), report)
    return figure


def demo_figure(result: DemoResult) -> Figure:
    """Draw the tool's error and the first joint's torsion, estimated and true."""
    figure = Figure(figsize=(8, 6), layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    for (name, error), colour in zip(result.tool_distance.items(), (COLOURS[1], COLOURS[0]), strict=True):
        above.plot(result.t, error, color=colour, label=name)
    above.set(ylabel="tool error [mm]", ylim=(0, None), title="Distance of the tool from where it truly is")
    below.plot(result.t, 1e3 * result.torsion_true, color="0.6", linewidth=4, label="true")
    below.plot(result.t, 1e3 * result.torsion, color=COLOURS[0], linewidth=1.2, label="observer")
    below.axhline(0, color=COLOURS[1], linewidth=1.2, label="motors alone")
    below.set(xlabel="time [s]", ylabel=r"torsion $\theta - q$ [mrad]", title=f"Torsion of joint {result.joint}")
    for axes in (above, below):
        _finish(axes)
    return figure


def placement_figure(placement: Placement) -> Figure:
    """Draw where a placement is singular, see `Placement.figure`."""
    report = placement.report
    figure = Figure(figsize=(12, 5.6), layout="constrained")
    figure.suptitle(f"{', '.join(sensor.name for sensor in placement.chosen)}: where it loses sight of the links")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    elastic = [joint for joint in map(int, report.influential) if report.robot.elastic[joint]]
    pair = sorted(elastic[:2]) if len(elastic) > 1 else _pair(report)
    _map(figure, left, report, pair)
    if len(pair) == 2:
        _mark_singular(left, report, pair)
    _ranked(right, placement)
    return figure


def _mark_singular(axes: Any, report: CheckReport, pair: list[int]) -> None:
    """Mark, of each kind of singularity, the posture on the map whose lost direction is most purely of that kind."""
    q = _postures(report, pair[0], pair[1], CELLS)[2]
    sight = Sight.of(report.robot, q)
    lost = sight.worst > LIMIT / 2
    for posture, marker in zip(report.singular, "XPDs*^v", strict=False):
        if lost.any():
            likeness = np.abs(sight.directions[lost, -1] @ posture.direction)
            x, y = (q[lost][np.argmax(likeness), joint] * _scale(report, joint) for joint in pair)
            axes.plot(x, y, marker, color=COLOURS[1], markeredgecolor="white", markersize=12, label=posture.words)
    axes.legend(loc="lower left", title="singular for")


def _ranked(axes: Any, placement: Placement) -> None:
    """Draw each candidate's score alone, the best first, and that of the set."""
    alone = np.sort(np.array(placement.alone))
    shown = np.minimum(alone, 1e4 * placement.score)
    axes.semilogy(np.arange(1, len(shown) + 1), shown, ".", color=COLOURS[0], label="candidates alone")
    axes.axhline(placement.score, color=COLOURS[2], label="the chosen set")
    if np.isfinite(placement.before):
        axes.axhline(placement.before, color=COLOURS[1], linestyle="--", label="the robot's own sensors")
    condition = placement.criterion == "condition"
    axes.set(xlabel="candidate", ylabel="worst condition number" if condition else "standard deviation [rad/s²]")
    _finish(axes)


def front_figure(front: Front) -> Figure:
    """Draw a Pareto front, see `Front.figure`."""
    figure = Figure(figsize=(12, 4.2), layout="constrained")
    figure.suptitle("Errors and noise of the observer, in multiples of those before tuning")
    noise = front.ratios[:, -1]
    for axes, column, name in zip(figure.subplots(1, 3), range(3), ("position", "velocity", "torsion"), strict=True):
        error = front.ratios[:, column]
        axes.plot(noise, error, "o", color=COLOURS[0], markersize=4, label="the front")
        axes.plot(1, 1, "X", color="0.4", markersize=9, label="before")
        chosen = noise[front.recommended], error[front.recommended]
        axes.plot(*chosen, "*", color=COLOURS[1], markersize=15, label="recommended")
        axes.set(xlabel="noise of link velocity", ylabel=f"error of {name}", ylim=(0, None))
        _finish(axes)
    return figure


def _pair(report: CheckReport) -> list[int]:
    """The two joints whose position matters most."""
    first = [int(joint) for joint in report.influential]
    return sorted((first + [joint for joint in range(report.robot.n) if joint not in first])[:2])


def _map(figure: Figure, axes: Any, report: CheckReport, pair: list[int]) -> None:
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


def _sweep(report: CheckReport, across: int, up: int) -> tuple[Array, Array, Array]:
    """Standard deviation over two joints, all others at home; degrees where a joint turns.

    A cell shows the worst of some postures in it, or else narrow singular curves would fall between the samples.
    """
    low, high, q = _postures(report, across, up, CELLS * FINER)
    worst = np.concatenate([Sight.of(report.robot, part).worst for part in np.array_split(q, 16)])
    cells = np.minimum(worst, 1e12).reshape(CELLS, FINER, CELLS, FINER).max(axis=(1, 3))
    edges = (np.linspace(low[j], high[j], CELLS + 1) * _scale(report, j) for j in (across, up))
    return next(edges), next(edges), cells


def _postures(report: CheckReport, across: int, up: int, count: int) -> tuple[Array, Array, Array]:
    """Limits of all joints, and postures over two of them, `count` along each, all others at home."""
    low, high = report.limits
    middles = (np.arange(count) + 0.5) / count
    x, y = (low[joint] + middles * (high - low)[joint] for joint in (across, up))
    q = np.tile(report.home, (count * count, 1))
    q[:, across], q[:, up] = np.tile(x, count), np.repeat(y, count)
    return low, high, q


def _draw_path(axes: Any, report: CheckReport, pair: list[int]) -> None:
    assert report.path is not None
    rows = _thinned(len(report.path.t))
    x, y = (report.path.q[rows, joint] * _scale(report, joint) for joint in pair)
    axes.plot(x, y, color="white", linewidth=4, solid_capstyle="round")
    axes.plot(x, y, color=COLOURS[1], linewidth=2, solid_capstyle="round", label="the log")
    axes.plot(x[0], y[0], "o", color=COLOURS[1], markeredgecolor="white", markersize=9, label="its start")
    axes.legend(loc="upper right")


def _line(axes: Any, report: CheckReport) -> None:
    """A robot of one joint has no map, but a curve."""
    q = np.linspace(report.limits[0, 0], report.limits[1, 0], POINTS)
    worst = Sight.of(report.robot, q[:, None]).worst
    axes.semilogy(q * _scale(report, 0), np.minimum(worst, 1e12), color=COLOURS[0])
    axes.set(xlabel=_label(report, 0), ylabel="standard deviation [rad/s²]", title="over the workspace")
    axes.set_ylim(worst.min() / 3, 3 * max(LIMIT, worst.min()))
    axes.axhline(LIMIT, color="0.4", linestyle=":")
    _finish(axes, legend=False)


def _shares(axes: Any, report: CheckReport) -> None:
    """Draw the share of the workspace in which each joint is seen at least so well."""
    share = np.linspace(0, 100, 1001)
    for name, values, style in _styled(report.joints, report.sight.joints):
        ranked = np.quantile(values, share / 100, method="lower")
        axes.semilogx(np.minimum(ranked, 1e12), share, label=name, **style)
    axes.axvline(LIMIT, color="0.4", linestyle=":")
    right = 30 * LIMIT
    axes.set(xlim=(None, right), ylabel="share of the workspace [%]", title="seen at least so well, over the workspace")
    axes.set_xlabel("standard deviation of link acceleration [rad/s²]")
    _finish(axes)


def _along(axes: Any, report: CheckReport) -> None:
    """Draw each joint's standard deviation along the log, the worst of every stretch of it."""
    assert report.path is not None
    rows = _thinned(len(report.path.t))
    worst = np.maximum.reduceat(report.path.joints, rows, axis=0)
    for name, values, style in _styled(report.joints, np.minimum(worst, 1e12)):
        axes.semilogy(report.path.t[rows], values, label=name, **style)
    top = max(1.5 * LIMIT, min(1.2 * float(worst.max()), 1e3 * LIMIT))
    axes.axhline(LIMIT, color="0.4", linestyle=":")
    axes.set(xlabel="time [s]", ylabel="standard deviation [rad/s²]", ylim=(None, top), title="along the log")
    _finish(axes, legend=False)


def _styled(joints: Iterable[str], values: Array) -> Iterable[tuple[str, Array, dict[str, Any]]]:
    """A colour and a dash for each joint: lines that coincide stay visible."""
    dashes = ("-", "--", "-.", ":")
    for index, name in enumerate(joints):
        style = {"color": COLOURS[index % len(COLOURS)], "linestyle": dashes[index % len(dashes)]}
        yield name, values[:, index], style


def _words_only(report: CheckReport) -> Figure:
    from linkside.cli.progress import check_words

    figure = Figure(figsize=(8, 2), layout="constrained")
    figure.text(0.5, 0.5, "\n".join(check_words(report)), ha="center", va="center", wrap=True)
    return figure


def _thinned(rows: int) -> npt.NDArray[np.intp]:
    return np.arange(0, rows, 1 + rows // POINTS)


def _held(report: CheckReport, pair: list[int]) -> str:
    held = [joint for joint in sorted(map(int, report.influential)) if joint not in pair]
    places = (f"{report.robot.names[j]} = {report.home[j] * _scale(report, j):.1f}{_unit(report, j)}" for j in held)
    others = textwrap.fill(f"at {', '.join(places)}", 60) if held else ""
    return f"worst combination of link accelerations\n{others}".strip()


def _label(report: CheckReport, joint: int) -> str:
    return f"{report.robot.names[joint]} [{_unit(report, joint)}]"


def _unit(report: CheckReport, joint: int) -> str:
    return "m" if prismatic(report.robot)[joint] else "°"


def _scale(report: CheckReport, joint: int) -> float:
    return 1.0 if prismatic(report.robot)[joint] else 180 / np.pi


def _finish(axes: Any, legend: bool = True) -> None:
    axes.grid(True, color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
    if legend:
        axes.legend(frameon=False)
