"""The reduced-order observer, six joints, against the same equations in NumPy and Pinocchio."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pinocchio as pin
from timing import Result, microseconds

from linkside import Log, ReducedOrderObserver, Robot

DATA = Path(__file__).parents[2] / "tests/data"
GAIN = 100.0
AGREE = 1e-2  # rad/s: the peer takes Euler's steps


def bench() -> Iterator[Result]:
    """A recording, and one sample after the other."""
    robot = Robot.load(DATA / "kr15_six_axes/robot.yaml")
    log = Log.read(DATA / "kr15_six_axes/log.parquet", robot)
    observer = ReducedOrderObserver(robot, GAIN)
    apart = np.abs(plain(robot, log) - observer.run(log).dq).max()
    if not apart <= AGREE:
        raise SystemExit(f"linkside and NumPy are {apart:.1e} rad/s apart, this compares nothing")
    ours = microseconds(lambda: observer.run(log), len(log))
    theirs = microseconds(lambda: plain(robot, log), len(log), repeats=3)
    yield Result("reduced-order, 6 joints", ours, "NumPy + Pinocchio", theirs)
    yield step(observer, log)


def step(observer: ReducedOrderObserver, log: Log) -> Result:
    """As a control loop would."""
    samples = list(zip(log.theta, log.tau, strict=True))

    def loop() -> None:
        for q, tau in samples:
            observer.step(q=q, tau=tau)

    return Result("reduced-order step from Python, 6 joints", microseconds(loop, len(samples)), most=3.0)


def plain(robot: Robot, log: Log) -> np.ndarray:
    """Cristofaro and De Luca's eq. (6) in terms of the estimate, one Euler step a sample."""
    model, data = robot.model, robot.model.createData()
    order = [model.joints[model.getJointId(name)].idx_q for name in robot.names]
    motors = np.diag([drive.motor_inertia for drive in robot.drives])
    viscous = np.array([drive.motor_friction.viscous for drive in robot.drives])
    dry = np.array([drive.motor_friction.coulomb for drive in robot.drives])
    out = np.zeros_like(log.theta)
    position, velocity, rest = np.empty(robot.n), np.empty(robot.n), np.zeros(robot.n)
    for k in range(len(log) - 1):
        dq = out[k]
        position[order], velocity[order] = log.theta[k], dq
        forces = pin.rnea(model, data, position, velocity, rest)[order]
        mass = pin.crba(model, data, position)
        mass = (np.triu(mass) + np.triu(mass, 1).T)[np.ix_(order, order)] + motors
        friction = viscous * dq + dry * dq / np.hypot(dq, 2e-3)
        ddq = np.linalg.solve(mass, log.tau[k] - forces - friction)
        moved = log.theta[k + 1] - log.theta[k]
        out[k + 1] = dq + GAIN * (moved - log.period * dq) + log.period * ddq
    return out
