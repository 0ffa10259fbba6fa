"""The figure of the demonstration."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from linkside.figures import COLOURS, finish, legend_below

from .run import DemoResult


def demo_figure(result: DemoResult) -> Figure:
    """Draw the tool's error, where it goes, and the first joint's torsion, estimated and true."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    error, path, torsion = figure.subplots(3, 1, sharex=True)
    motors, observer = COLOURS[1], COLOURS[0]
    centre = result.tool.mean(axis=0)
    along = np.linalg.svd(result.tool - centre, full_matrices=False)[2][0]
    path.plot(result.t, 1e3 * (result.tool - centre) @ along, color="0.6", linewidth=4)
    for (name, away), colour in zip(result.tool_error.items(), (motors, observer), strict=True):
        centred = away - away.mean(axis=0)
        error.plot(result.t, 1e3 * np.linalg.norm(centred, axis=1), color=colour)
        path.plot(result.t, 1e3 * (result.tool + centred - centre) @ along, color=colour, linewidth=1.2, label=name)
    means = ", ".join(f"{name} {1e3 * np.linalg.norm(e.mean(axis=0)):.2g} mm" for name, e in result.tool_error.items())
    error.set(ylabel="tool error [mm]", ylim=(0, None), title=f"Tool error less its mean ({means})")
    path.set(ylabel="position [mm]", title="Tool along the direction in which it moves most, mean error out")
    torsion.plot(result.t, 1e3 * result.torsion_true, color="0.6", linewidth=4, label="true")
    torsion.plot(result.t, np.zeros_like(result.t), color=motors, label="motors alone")
    torsion.plot(result.t, 1e3 * result.torsion, color=observer, linewidth=1.2, label="observer")
    torsion.set(xlabel="time [s]", ylabel=r"torsion $\theta - q$ [mrad]", title=f"Torsion of joint {result.joint}")
    for axes in (error, path, torsion):
        finish(axes, legend=False)
    legend_below(figure, torsion)
    return figure
