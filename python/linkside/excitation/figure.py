"""The figure of a planned motion."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from linkside.figures import COLOURS, finish
from linkside.figures.style import legend_below, line_style, plain_log
from linkside.robot import Robot

from .expected import ExpectedErrors, MotorMotion

MOST = 24
"""Parameters that are drawn: those with the smallest standard errors."""


def excitation_figure(robot: Robot, motion: MotorMotion, before: ExpectedErrors, after: ExpectedErrors) -> Figure:
    """Draw the motion of each joint, and the standard errors that a calibration will have."""
    figure = Figure(figsize=(13, 5.6), layout="constrained")
    figure.suptitle(f"{robot.model.name}: a motion to calibrate by")
    left, right = figure.subplots(1, 2, width_ratios=(1.3, 1))
    start = motion.theta[0]
    for j, name in enumerate(robot.names):
        left.plot(motion.t, motion.theta[:, j] - start[j], **line_style(j), linewidth=1, label=name)
    left.set(xlabel="time [s]", ylabel="position, from the start [rad, m]")
    finish(left, legend=False)
    legend_below(figure, left)
    _errors(right, before, after)
    return figure


def _errors(axes: Any, before: ExpectedErrors, after: ExpectedErrors) -> None:
    """Draw standard errors before and after, in tolerances of robot.yaml."""
    order = np.argsort(np.array([p.name in after.reasons for p in after.parameters]) + after.std)[:MOST][::-1]
    rows = np.arange(len(order))
    axes.hlines(rows, after.std[order], before.std[order], color="0.8", linewidth=2)
    axes.plot(before.std[order], rows, "o", color=COLOURS[1], label="without the motion")
    axes.plot(after.std[order], rows, "o", color=COLOURS[0], label="with it")
    axes.set_xscale("log")
    axes.set_yticks(rows, [after.parameters[i].name for i in order], fontsize="x-small")
    axes.set(xlabel="standard error, in tolerances of robot.yaml")
    plain_log(axes.xaxis)
    finish(axes, legend=False)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, fontsize="small", frameon=False)
