"""Feedforward beside Pinocchio and differences, the loop on the estimate, and what design takes."""

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
from scipy.signal import lfilter
from timing import Result, microseconds

import linkside
from linkside import AccelerationObserver, Estimate, Log, Robot, simulate
from linkside.control import Desired, inverse_dynamics
from linkside.control.feedback import StateFeedback, pole_placement
from linkside.control.trajectories import Trajectory, rest_to_rest
from linkside.observability import candidates, place
from linkside.tuning import tune_observer

PERIOD = 5e-4
AGREE = 1e-3  # of the largest torque: the peer differentiates by differences
EVALUATIONS = 50


def bench() -> Iterator[Result]:
    """The KR15-like robot, its first joint by 30°."""
    robot = Robot.load(linkside.demo.ROBOT)
    log = Log.read(linkside.demo.LOG, robot)
    start = log.theta[0]
    motion = rest_to_rest([start, start + np.radians([30, 0, 0, 0, 0, 0])], 0.5, PERIOD)
    desired = inverse_dynamics(robot, motion)
    apart = np.abs(differences(robot, motion) - desired.tau)[5:-5].max() / np.abs(desired.tau).max()
    if not apart <= AGREE:
        raise SystemExit(f"linkside and Pinocchio with differences are {apart:.1e} apart, this compares nothing")
    ours = microseconds(lambda: inverse_dynamics(robot, motion), len(motion))
    theirs = microseconds(lambda: differences(robot, motion), len(motion), repeats=3)
    yield Result("feedforward, 6 joints", ours, "Pinocchio + differences", theirs)
    yield from loops(robot, desired, log)
    yield from designs(robot, log)


def loops(robot: Robot, desired: Desired, log: Log) -> Iterator[Result]:
    """Observer, feedback and feedforward: from Python, and within the simulator."""
    gains, samples = pole_placement(robot, desired.q[0]), list(zip(log.theta, log.acceleration, strict=True))
    controller = StateFeedback(robot, desired, gains, AccelerationObserver(robot, period=PERIOD, start="rest"))

    def live() -> None:
        controller.observer.reset()
        for theta, acceleration in samples:
            controller.step(theta=theta, acceleration=acceleration)

    def simulated() -> None:
        duration, start = PERIOD * (len(desired.t) - 1), desired.q[0]
        simulate(robot, controller, duration, 1 / PERIOD, q=start, feedback=controller.observer, substeps=2)

    yield Result("full-state control step from Python, 6 joints", microseconds(live, len(samples)), most=20.0)
    yield Result("the same in simulation, 2 steps of integration", microseconds(simulated, len(desired.t)))


def designs(robot: Robot, log: Log) -> Iterator[Result]:
    """Placement for each set and posture, tuning for each evaluation and sample."""
    offered = candidates(robot, ["link3", "link4"], reach=0.2)
    found = place(robot, offered, log)
    work = len(offered) * len(found.q)
    yield Result("placement, a set and posture", microseconds(lambda: place(robot, offered, log), work, repeats=3))
    truth = Estimate.read(linkside.demo.TRUTH)

    def tune() -> None:
        tune_observer(robot, log, truth, evaluations=EVALUATIONS)

    yield Result("observer tuning, an evaluation and sample", microseconds(tune, EVALUATIONS * len(log), repeats=3))


def differences(robot: Robot, motion: Trajectory) -> np.ndarray:
    """Motor torques: Pinocchio's inverse dynamics, the spring's first-order lag as a filter, differences for δ̈."""
    model, data = robot.model, robot.model.createData()
    states = zip(motion.q, motion.dq, motion.ddq, strict=True)
    load = np.array([pin.rnea(model, data, *state) for state in states])
    torsion = np.zeros_like(load)
    for j in np.flatnonzero(robot.elastic):
        drive = robot.drives[j]
        lag = drive.damping / drive.stiffness / PERIOD
        decay = np.exp(-1 / lag)
        share = lag * (1 - decay)  # of the load's change over the period, which is on a straight line
        steady = load[0, j] / drive.stiffness
        moved = lfilter([1 - share, share - decay], [1, -decay], load[:, j] - load[0, j])
        torsion[:, j] = steady + moved / drive.stiffness
    rate = np.gradient(torsion, PERIOD, axis=0)
    inertia = np.array([drive.motor_inertia or 0.0 for drive in robot.drives])
    acceleration = motion.ddq + np.gradient(rate, PERIOD, axis=0)
    return load + inertia * acceleration + robot.motor_friction(motion.dq + rate)
