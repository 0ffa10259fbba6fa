"""Draws tool_error.svg for the README: a robot, and the path of its tool by its motors and by the observer."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pinocchio
from drawing import save, style

from linkside import AccelerationObserver, Estimate, Log, Robot
from linkside.figures.style import COLOURS, finish

HERE = Path(__file__).parent
FOLDER = HERE.parent / "tests/data/arm2_square"
MAGNIFIED = 10  # so that millimetres show on a square of 20 cm


@style()
def draw_all() -> None:
    """Estimate a square path of a two-joint arm, and draw it."""
    robot = Robot.load(FOLDER / "robot.yaml")
    log = Log.read(FOLDER / "log.parquet", robot)
    truth = Estimate.read(FOLDER / "truth.parquet")
    path = truth.tool_position
    errors = {
        name: (tool - path) - (tool - path).mean(axis=0)
        for name, tool in {
            "motor positions only": robot.tool_position(log.theta),
            "observer": AccelerationObserver(robot).run(log).tool_position,
        }.items()
    }
    figure, (arm, square, time) = plt.subplots(1, 3, figsize=(10, 3), layout="constrained", width_ratios=(1, 1, 1.6))
    draw_arm(arm, robot, truth.q[0])
    arm.plot(path[::4, 0], path[::4, 2], color="black", linewidth=1)
    square.plot(path[::4, 0], path[::4, 2], color="black", linewidth=1, label="true path")
    for (name, error), colour in zip(errors.items(), (COLOURS[1], COLOURS[0]), strict=True):
        drawn = path + MAGNIFIED * error
        square.plot(drawn[::4, 0], drawn[::4, 2], color=colour, linewidth=0.8)
        time.semilogy(log.t[::4], 1e3 * np.linalg.norm(error[::4], axis=1), color=colour, linewidth=0.8, label=name)
    square.set(title=f"path of the tool, errors × {MAGNIFIED}", aspect="equal", xlabel="x [m]")
    arm.set(title="robot and path", aspect="equal", xlabel="x [m]", ylabel="z [m]")
    time.set(title="tool error, constant offset removed", xlabel="time [s]", ylabel="[mm]", ylim=(3e-3, 20))
    time.legend(loc="upper right", frameon=False, ncols=2)
    for axes in (arm, square, time):
        finish(axes, legend=False)
    save(figure, HERE / "tool_error.svg")


def draw_arm(axes: plt.Axes, robot: Robot, q: np.ndarray) -> None:
    """Joints as discs and links as bars, in the plane of x and z."""
    data = robot.model.createData()
    pinocchio.forwardKinematics(robot.model, data, robot.to_pinocchio(q))
    joints = [data.oMi[index].translation for index in range(1, robot.model.njoints)]
    points = np.array([np.zeros(3), *joints, robot.tool_position(q[None])[0]])
    axes.plot(points[:, 0], points[:, 2], color="0.7", linewidth=7, solid_capstyle="round", solid_joinstyle="round")
    axes.plot(points[1:-1, 0], points[1:-1, 2], "o", color=COLOURS[0], markersize=8)
    axes.plot(points[0, 0], points[0, 2], "s", color="0.4", markersize=10)
