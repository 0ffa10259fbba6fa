"""Figures of an estimate over time, each narrow enough for a page that is read on a phone."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from linkside.figures import COLOURS, finish, legend_below, line_style
from linkside.robot.workspace import prismatic

from .overview import FLAGS, Overview
from .trace import Trace

WIDTH = 6.4
"""Of a figure [in]."""


def tool_figures(overview: Overview) -> Iterator[tuple[str, Figure]]:
    """The tool's path over time, its displacement by the springs, and its standard deviation; with captions."""
    if overview.tool:
        figure, axes = _panel()
        middle = np.nanmean(overview.tool.mean, axis=0)
        for index, axis in enumerate("xyz"):
            label = f"{axis} less {middle[index]:.4g} m"
            _band(axes, overview.tool, index, 1e3, line_style(index), label, middle[index])
        axes.set_ylabel("tool [mm]")
        yield "Path of the tool over time", _done(figure, axes)
    if overview.bend:
        figure, axes = _panel()
        _band(axes, overview.bend, 0, 1e3, line_style(0), "tool from where motors alone would have it")
        if overview.tool_std:
            size = np.linalg.norm(overview.tool_std.high, axis=1)
            axes.plot(overview.tool_std.t, 2e3 * size, color=COLOURS[1], ls="--", lw=1.2, label="2σ of the tool")
        axes.set(ylabel="distance [mm]", ylim=(0, None))
        yield "Displacement of the tool by the springs, and its standard deviation", _done(figure, axes)


def torsion_figures(overview: Overview) -> Iterator[tuple[str, Figure]]:
    """Links less motors over time, with two standard deviations."""
    for slides, unit in ((False, "mrad"), (True, "mm")):
        joints = [i for i, one in enumerate(prismatic(overview.robot)) if one == slides and overview.robot.elastic[i]]
        if joints:
            figure, axes = _panel()
            for place, joint in enumerate(joints):
                style = line_style(place)
                _band(axes, overview.torsion, joint, 1e3, style, overview.robot.names[joint])
                if overview.q_std:
                    std, mean = overview.q_std.high[:, joint], overview.torsion.mean[:, joint]
                    edges = 1e3 * (mean - 2 * std), 1e3 * (mean + 2 * std)
                    axes.fill_between(overview.q_std.t, *edges, color=style["color"], alpha=0.12, lw=0)
            axes.set_ylabel(f"torsion [{unit}]")
            band = ", with two standard deviations" if overview.q_std else ""
            yield f"Links less motors{band}", _done(figure, axes)


def residual_figures(overview: Overview, used_per_row: float) -> Iterator[tuple[str, Figure]]:
    """Innovations and residuals over time."""
    if overview.nis and used_per_row:
        figure, axes = _panel()
        axes.plot(overview.nis.t, overview.nis.mean[:, 0] / used_per_row, color=COLOURS[0], lw=1, label="mean")
        axes.axhline(1, color="0.3", ls="--", lw=1, label="if the noise is right")
        axes.set(ylabel="NIS per reading", ylim=(0, None))
        yield (
            "Normalised innovation squared: much above 1, readings contradict the model; below is no fault",
            _done(figure, axes),
        )
    names = overview.robot.names
    yield from _residuals(overview.motors, names, 1e3, "read less estimate [mrad, mm]", "Motor positions")
    channels = overview.robot.acceleration_channels
    yield from _residuals(overview.forces, channels, 1.0, "read less estimate [m/s²]", "Accelerometers")


def status_figures(overview: Overview) -> Iterator[tuple[str, Figure]]:
    """When rows are flagged, a line a flag; nothing where none is."""
    share = overview.flags.mean
    there = [index for index in range(len(FLAGS)) if share[:, index].any()]
    if there:
        figure = Figure(figsize=(WIDTH, 0.9 + 0.35 * len(there)), layout="constrained")
        axes = figure.subplots()
        for place, index in enumerate(there):
            axes.fill_between(
                overview.flags.t, place, place + 0.9 * share[:, index], step="mid", color=COLOURS[1], lw=0
            )
        axes.set_yticks([place + 0.4 for place in range(len(there))], [str(FLAGS[i].name).lower() for i in there])
        axes.set(xlabel="time [s]", ylim=(-0.1, len(there)))
        finish(axes, legend=False)
        yield "When rows are flagged: the share of rows", figure


def _residuals(
    trace: Trace, names: Sequence[str], scale: float, label: str, caption: str
) -> Iterator[tuple[str, Figure]]:
    if trace and np.isfinite(trace.mean).any():
        figure, axes = _panel()
        for index, name in enumerate(names):
            _band(axes, trace, index, scale, line_style(index), name)
        axes.set_ylabel(label)
        yield f"{caption}, less what the estimate says", _done(figure, axes)


def _band(
    axes: Any, trace: Trace, index: int, scale: float, style: dict[str, str], label: str, less: float = 0.0
) -> None:
    """A channel, from its least to its largest value in each stretch."""
    low, high = (scale * (values[:, index] - less) for values in (trace.low, trace.high))
    same = np.array_equal(low, high, equal_nan=True)
    t, values = (trace.t, low) if same else (np.repeat(trace.t, 2), np.stack([low, high], axis=1).ravel())
    there = np.isfinite(values)
    axes.plot(t[there], values[there], lw=1, label=label, **style)


def _panel() -> tuple[Figure, Any]:
    figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
    return figure, figure.subplots()


def _done(figure: Figure, axes: Any) -> Figure:
    axes.set_xlabel("time [s]")
    finish(axes, legend=False)
    legend_below(figure, axes, columns=3)
    return figure
