"""Draws docs/tool_error.png for the README: the tool's error from motor positions alone, and from the observer."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from linkside import AccelerationObserver, Estimate, Log, Robot

HERE = Path(__file__).parent
FOLDER = HERE.parent / "tests/data/kr15_long"


def main() -> None:
    """Estimate a motion of the first three axes, and draw its error."""
    robot = Robot.load(FOLDER / "robot.yaml")
    log = Log.read(FOLDER / "log.parquet", robot)
    truth = Estimate.read(FOLDER / "truth.parquet").tool_position
    tools = {
        "motor positions only": robot.tool_position(log.theta),
        "observer": AccelerationObserver(robot).run(log).tool_position,
    }
    figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
    for name, tool in tools.items():
        error = tool - truth
        axes.semilogy(log.t, 1e3 * np.linalg.norm(error - error.mean(axis=0), axis=1), label=name, linewidth=1)
    axes.set(xlabel="time [s]", ylabel="tool error [mm]", ylim=(0.01, 20), title="kr15_long, constant offset out")
    axes.legend()
    axes.grid(alpha=0.3)
    figure.savefig(HERE / "tool_error.png", dpi=110)


if __name__ == "__main__":
    main()
