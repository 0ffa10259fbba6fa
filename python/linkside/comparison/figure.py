"""The picture of a comparison, drawn without a display."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.figure import Figure

from linkside.figures import COLOURS, finish

from .output import SCALES
from .result import ComparisonResult

MOST_JOINTS = 12
"""Joints that are drawn."""


def draw(comparison: ComparisonResult) -> Figure:
    """Draw the tool's distance, and each joint's difference, over time; segments are shaded."""
    signals = [s for s in comparison.differences[0].signals if s.startswith("q_")][:MOST_JOINTS]
    panels = [*(["tool"] if any("tool" in d.signals for d in comparison.differences) else []), *signals]
    columns = 2 if len(panels) > 3 else 1
    rows = -(-len(panels) // columns)
    figure = Figure(figsize=(6.5 * columns, 1.2 + 2.2 * rows), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True).ravel()
    for axes in grid[len(panels) :]:
        axes.set_visible(False)
    units = {m.signal: m.unit for m in comparison.measures}
    count = len(comparison.differences)
    colours = COLOURS if count <= len(COLOURS) else colormaps["viridis"](np.linspace(0, 0.95, count))
    for axes, signal in zip(grid, panels, strict=False):
        scale, unit = SCALES.get(units[signal], (1.0, units[signal]))
        for difference, colour in zip(comparison.differences, colours, strict=False):
            if signal in difference.signals:
                error = scale * difference.signals[signal]
                line = np.linalg.norm(error, axis=1) if signal == "tool" else error[:, 0]
                axes.plot(difference.t, line, color=colour, linewidth=1, label=difference.name)
        for segment in comparison.segments:
            axes.axvspan(segment.start, segment.end, color="0.93", zorder=0)
        axes.set(ylabel=f"{signal.removeprefix('q_')} [{unit}]")
        finish(axes, legend=False)
    for axes in grid[max(0, len(panels) - columns) : len(panels)]:  # the lowest of each column
        axes.set_xlabel("time [s]")
        axes.tick_params(labelbottom=True)
    handles, labels = grid[0].get_legend_handles_labels()
    if count <= 2 * len(COLOURS):
        figure.legend(handles, labels, loc="outside lower center", ncols=min(count, 4), frameon=False)
    figure.suptitle(f"difference from {comparison.reference}", fontsize="medium")
    return figure
