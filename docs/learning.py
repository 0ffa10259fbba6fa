"""Draws learning.svg and prints the table of learning.md: a motion is learnt with each kind of estimate."""

from collections.abc import Callable
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from drawing import save, style

from linkside import (
    Estimate,
    ExtendedKalmanFilter,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    Simulation,
    demo,
    simulate,
)
from linkside.arrays import FloatArray
from linkside.control.controllers import JointPD
from linkside.figures import COLOURS, finish
from linkside.learning import Motion, PathLearning, wanted_motion

HERE = Path(__file__).parent
SQUARE = HERE.parent / "tests/data/arm2_square"
REPEATS = 10

Estimator = Callable[[Robot, Simulation], Estimate]

ESTIMATES: dict[str, Estimator] = {
    "motors alone": lambda known, run: told(run, run.log.theta),
    "EKF": lambda known, run: ExtendedKalmanFilter(known).run(run.log),
    "smoother": lambda known, run: RauchTungStriebelSmoother(known).run(run.log),
    "particles": lambda known, run: ParticleFilter(known, particles=500, collapse="reseed").run(run.log),
    "links as they are": lambda known, run: told(run, run.truth["q"]),
}


@style()
def draw_all() -> None:
    """Learn a square and a turn of the base, on robots that are as known and on others."""
    square, turn = Robot.load(SQUARE / "robot.yaml"), Robot.load(demo.ROBOT)
    motions = {
        "square, exact": (square, square, wanted_motion(SQUARE / "log.parquet", square)),
        "square, wrong": (square, wrong(square), wanted_motion(SQUARE / "log.parquet", square)),
        "turn, exact": (turn, turn, wanted_motion(demo.LOG, turn)),
        "turn, wrong": (turn, wrong(turn), wanted_motion(demo.LOG, turn)),
    }
    figure, panels = plt.subplots(1, len(motions), figsize=(10, 2.8), sharey=True, layout="constrained")
    for axes, (name, (known, true, motion)) in zip(panels, motions.items(), strict=True):
        for (method, estimator), colour in zip(ESTIMATES.items(), COLOURS, strict=False):
            errors = learn(known, true, motion, estimator)
            print(f"{name:15} {method:18} " + " ".join(f"{error:8.4f}" for error in errors), flush=True)
            axes.semilogy(errors, marker=".", color=colour, label=method)
        axes.set(title=name, xlabel="repeat", xticks=range(0, REPEATS + 1, 2))
        finish(axes, legend=False)
    panels[0].set_ylabel("tool error, rms [mm]")
    panels[-1].legend(fontsize="x-small")
    save(figure, HERE / "learning.svg")


def wrong(robot: Robot) -> Robot:
    """Springs 8 % softer, damping 40 % more, masses 5 % more than robot.yaml says."""
    return robot.scaled(stiffness=0.92, damping=1.4, mass=1.05)


def learn(known: Robot, true: Robot, motion: Motion, estimator: Estimator) -> list[float]:
    """Errors of the tool, rms [mm], in each repeat."""
    inertia = np.diag(known.mass_matrix(motion.q[0])) + [drive.motor_inertia or 0.0 for drive in known.drives]
    kp, kd = 900 * inertia, 42 * inertia  # motors follow at 30 rad/s
    hold = known.gravity_torque(motion.q[0])
    learning, errors = PathLearning(known, motion, kp, kd), []
    for trial in range(REPEATS + 1):
        control = JointPD(kp=kp, kd=kd, times=motion.t, theta=motion.q + learning.correction, tau=hold)
        rate = 1 / motion.period
        run = simulate(true, control, motion.t[-1], rate, q=motion.q[0], substeps=2, seed=trial)
        off = run.truth["tool"] - known.tool_position(motion.q)
        errors.append(1e3 * float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
        learning.learn(estimator(known, run))
    return errors


def told(run: Simulation, q: FloatArray) -> Estimate:
    """Positions as an estimate."""
    log = run.log
    return Estimate(log.t, q, run.truth["dq"], log.theta, log.dtheta, np.zeros(len(log), np.uint8), run.robot.names)
