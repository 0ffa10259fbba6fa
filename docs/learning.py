"""Draws learning.svg and prints the table of learning.md: a motion is learnt with each kind of estimate."""

import shutil
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from drawing import save, style
from matplotlib.axes import Axes

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
from linkside.calibration import calibrate
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

CALIBRATED = "smoother, calibrated"
"""Learning by a robot that was calibrated to the recording of the motion before learning."""


@style()
def draw_all() -> None:
    """Learn a square and a turn of the base, on robots that are as known and on others."""
    cases = {"square": SQUARE, "turn": demo.FOLDER}
    figure, panels = plt.subplots(1, 2 * len(cases), figsize=(10, 2.8), sharey=True, layout="constrained")
    colours = dict(zip((*ESTIMATES, CALIBRATED), COLOURS, strict=False))
    titles = [(case, specimen) for case in cases for specimen in ("exact", "wrong")]
    for axes, (case, specimen) in zip(panels, titles, strict=True):
        known = Robot.load(cases[case] / "robot.yaml")
        true = known if specimen == "exact" else wrong(known)
        motion = wanted_motion(cases[case] / "log.parquet", known)
        for method, estimator in ESTIMATES.items():
            plot(axes, f"{case}, {specimen}", method, colours, learn(known, known, true, motion, estimator))
        if specimen == "wrong":
            errors = learn(calibrated(cases[case], known, true, motion), known, true, motion, ESTIMATES["smoother"])
            plot(axes, f"{case}, {specimen}", CALIBRATED, colours, errors)
        axes.set(title=f"{case}, {specimen}", xlabel="repeat", xticks=range(0, REPEATS + 1, 2))
        finish(axes, legend=False)
    panels[0].set_ylabel("tool error, rms [mm]")
    panels[-1].legend(fontsize="x-small")
    save(figure, HERE / "learning.svg")


def plot(axes: Axes, case: str, method: str, colours: dict[str, str], errors: list[float]) -> None:
    """Draw and print one course of errors."""
    print(f"{case:15} {method:20} " + " ".join(f"{error:8.4f}" for error in errors), flush=True)
    axes.semilogy(errors, marker=".", color=colours[method], label=method)


def wrong(robot: Robot) -> Robot:
    """Springs 8 % softer, damping 40 % more, masses 5 % more than robot.yaml says."""
    return robot.scaled(stiffness=0.92, damping=1.4, mass=1.05)


def calibrated(folder: Path, known: Robot, true: Robot, motion: Motion) -> Robot:
    """The robot as a recording of the motion without a correction says that it is."""
    kp, kd = gains(known, motion)
    result = calibrate(known, [repeat(known, true, motion, kp, kd, np.zeros_like(motion.q), 100).log])
    with TemporaryDirectory() as place:
        for file in ("robot.yaml", "robot.urdf"):
            shutil.copy(folder / file, place)
        result.write(Path(place) / "robot.yaml", Path(place) / "calibrated.yaml")
        return Robot.load(Path(place) / "calibrated.yaml")


def learn(told_of: Robot, known: Robot, true: Robot, motion: Motion, estimator: Estimator) -> list[float]:
    """Errors of the tool, rms [mm], in each repeat, until learning stops by itself."""
    kp, kd = gains(known, motion)
    learning, errors = PathLearning(told_of, motion, kp, kd), []
    for number in range(REPEATS + 1):
        run = repeat(known, true, motion, kp, kd, learning.correction, number)
        off = run.truth["tool"] - known.tool_position(motion.q)
        errors.append(1e3 * float(np.sqrt(np.mean(np.sum(off**2, axis=1)))))
        if learning.learn(estimator(told_of, run)).reached:
            break
    return errors


def gains(known: Robot, motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Motors follow at 30 rad/s."""
    inertia = np.diag(known.mass_matrix(motion.q[0])) + [drive.motor_inertia or 0.0 for drive in known.drives]
    return 900 * inertia, 42 * inertia


def repeat(
    known: Robot, true: Robot, motion: Motion, kp: FloatArray, kd: FloatArray, correction: FloatArray, seed: int
) -> Simulation:
    """One repeat of the motion, by the robot as it is."""
    hold = known.gravity_torque(motion.q[0])
    control = JointPD(kp=kp, kd=kd, times=motion.t, theta=motion.q + correction, tau=hold)
    return simulate(true, control, motion.t[-1], 1 / motion.period, q=motion.q[0], substeps=2, seed=seed)


def told(run: Simulation, q: FloatArray) -> Estimate:
    """Positions as an estimate."""
    log = run.log
    return Estimate(log.t, q, run.truth["dq"], log.theta, log.dtheta, np.zeros(len(log), np.uint8), run.robot.names)
