"""The figure of a Pareto front."""

from __future__ import annotations

import textwrap

from matplotlib.figure import Figure

from linkside.arrays import FloatArray
from linkside.figures import COLOURS, finish, legend_below


def front_figure(ratios: FloatArray, recommended: int, settings: str) -> Figure:
    """Draw a Pareto front, see `Front.figure`; ``settings`` are the recommended ones in words."""
    figure = Figure(figsize=(12, 4.8), layout="constrained")
    title = "Errors and noise of the observer, in multiples of those before tuning"
    figure.suptitle(f"{title}\n{textwrap.fill(f'recommended: {settings}', 130)}", fontsize="medium")
    noise = ratios[:, -1]
    for axes, column, name in zip(figure.subplots(1, 3), range(3), ("position", "velocity", "torsion"), strict=True):
        error = ratios[:, column]
        axes.plot(noise, error, "o", color=COLOURS[0], markersize=4, label="the front")
        axes.plot(1, 1, "X", color="0.4", markersize=9, label="before")
        chosen = noise[recommended], error[recommended]
        axes.plot(*chosen, "*", color=COLOURS[1], markersize=15, label="recommended")
        axes.set(xlabel="noise of link velocity", ylabel=f"error of {name}", ylim=(0, None))
        finish(axes, legend=False)
    legend_below(figure, figure.axes[0])
    return figure
