"""The figure of the demonstration."""

from __future__ import annotations

from matplotlib.figure import Figure

from linkside.figures import COLOURS, finish

from .run import DemoResult


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
        finish(axes)
    return figure
