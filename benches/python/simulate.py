"""The simulator, six elastic joints, beside the same step in NumPy and Pinocchio; and the space robot's closed loop."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
from timing import Result, microseconds

from linkside import Robot, simulate
from linkside.control.controllers import JointPD
from linkside.papers.ulrich2011 import estimator, run, space_robot

ROOT = Path(__file__).parents[2]
RATE = 4000.0
STEPS = 4000
KP, KD = 2000.0, 200.0
AGREE = 1e-9  # rad
SQUARE = 60_000  # steps


def bench() -> Iterator[Result]:
    """A step of Runge and Kutta with its controller; then robot, filter and controller together."""
    robot = Robot.load(ROOT / "tests/data/kr15_six_axes/robot.yaml")
    goal = np.full(robot.n, 0.1)
    apart = np.abs(plain(robot, goal) - ours(robot, goal)).max()
    if not apart <= AGREE:
        raise SystemExit(f"linkside and NumPy are {apart:.1e} rad apart, this compares nothing")
    theirs = microseconds(lambda: plain(robot, goal), STEPS, repeats=3)
    yield Result("simulate, 6 joints", microseconds(lambda: ours(robot, goal), STEPS), "NumPy + Pinocchio", theirs)
    space = space_robot("nonlinear")
    loop = microseconds(lambda: run(space, estimator(space), 100e3, SQUARE / 100e3), SQUARE, repeats=3)
    yield Result("space robot, EKF and adaptive control", loop, most=10.0)


def ours(robot: Robot, goal: np.ndarray) -> np.ndarray:
    """Links' positions after all steps."""
    control = JointPD(KP, KD, [0.0], [goal])
    return simulate(robot, control, STEPS / RATE, RATE).truth["q"][-1]


def plain(robot: Robot, goal: np.ndarray) -> np.ndarray:
    """The same motion by loops in Python around Pinocchio's forward dynamics."""
    data = robot.model.createData()
    spring, damping, inertia = (
        np.array([getattr(d, name) for d in robot.drives]) for name in ("stiffness", "damping", "motor_inertia")
    )

    def slope(x: np.ndarray, tau: np.ndarray) -> np.ndarray:
        q, theta, dq, dtheta = x
        pull = spring * (theta - q) + damping * (dtheta - dq)
        links = pin.aba(robot.model, data, q, dq, pull - robot.link_friction(dq))
        return np.array([dq, dtheta, links, (tau - pull - robot.motor_friction(dtheta)) / inertia])

    q = np.zeros(robot.n)
    x = np.array([q, q + robot.gravity_torque(q) / spring, q, q])
    for _ in range(STEPS):
        tau = KP * (goal - x[1]) - KD * x[3]
        h = 1 / RATE
        one = slope(x, tau)
        two = slope(x + h / 2 * one, tau)
        three = slope(x + h / 2 * two, tau)
        x = x + h / 6 * (one + 2 * two + 2 * three + slope(x + h * three, tau))
    return x[0]
