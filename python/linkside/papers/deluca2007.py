"""Estimation and control of a KR15-like robot's first joint, after De Luca, Schröder and Thümmel (ICRA 2007).

Joint 1 moves by 5° and by 30°. Figures 3 and 4 of the paper compare observed with true states, Figures 5 and 6
full-state feedback on the estimate with feedback of the motors alone. The paper's robot is not published, and its
curves have no numbers. Here the simulated robot differs from the model that the controller uses: springs are 5 %
softer; motors, links and damping are 5 % larger. Encoders are quantised and accelerometers noisy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure

from linkside import demo
from linkside.arrays import FloatArray
from linkside.control import inverse_dynamics
from linkside.control.feedback import StateFeedback, motor_only, pole_placement
from linkside.control.trajectories import rest_to_rest
from linkside.figures import COLOURS, finish
from linkside.observers.acceleration import AccelerationObserver
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.simulation.simulator import simulate
from linkside.statistics import rms
from linkside.text import Titled

from .reproduction import PaperComparison, Reproduction, verdict

PERIOD = 5e-4
"""Time between samples [s]."""

MOTIONS = {"short": (5.0, 0.2), "long": (30.0, 0.4)}
"""Angle [°] and duration [s] of each motion."""

BEFORE = 0.05
"""Time at rest before a motion [s]."""

AFTER = 1.0
"""Time that is looked at after a motion [s]."""


@dataclass(frozen=True, eq=False)
class JointMotion:
    """One motion of joint 1.

    Attributes
    ----------
    t : (T,)
        Time [s].
    desired : (T,)
        Planned link position [rad].
    true, observed : (T, 4)
        States θ, q, θ̇, q̇ of the joint [rad, rad/s].
    """

    t: FloatArray
    desired: FloatArray
    true: FloatArray
    observed: FloatArray

    def settling(self, duration: float) -> tuple[float, float]:
        """Overshoot beyond the goal, and residual vibration peak to peak, after a motion of this duration [mrad]."""
        after = 1e3 * (self.true[self.t >= BEFORE + duration, 1] - self.desired[-1])
        return max(float(after.max()), 0.0), float(np.ptp(after[len(after) // 10 :]))

    @property
    def torsion_error(self) -> float:
        """Error of the observed torsion, RMS [mrad]."""
        return 1e3 * rms((self.true - self.observed) @ [1, -1, 0, 0])


def reproduce() -> Reproduction:
    """Run both motions with both kinds of feedback; takes a few seconds."""
    robot = Robot.load(demo.ROBOT)
    start = Log.read(demo.LOG, robot).theta[0]
    gains = {"full state": pole_placement(robot, start), "motors only": motor_only(robot, start)}
    table = Titled(
        "Joint 1 after the motion",
        ("motion", "overshoot [mrad]", "vibration [mrad]", "torsion error [mrad]"),
    )
    comparisons, figures = [], {}
    for name, (angle, duration) in MOTIONS.items():
        found = {fed_back: experiment(robot, start, angle, duration, gain) for fed_back, gain in gains.items()}
        merits = {fed_back: motion.settling(duration) for fed_back, motion in found.items()}
        for fed_back, (overshoot, residual) in merits.items():
            cells = (f"{overshoot:.2f}", f"{residual:.3f}", f"{found[fed_back].torsion_error:.3f}")
            table.add_row(f"{angle:g}° in {duration:g} s, {fed_back}", *cells)
        for what, full, motors in zip(("overshoot", "vibration"), *merits.values(), strict=True):
            quantity = f"{what}, full state over motors only, {angle:g}°"
            comparisons.append(PaperComparison(quantity, "smaller (Figs. 5, 6)", full / motors, verdict(full < motors)))
        error = found["full state"].torsion_error
        largest = 1e3 * float(np.ptp(found["full state"].true @ [1, -1, 0, 0]))
        comparisons.append(
            PaperComparison(
                f"torsion error over torsion, {angle:g}°",
                "small (Figs. 3, 4)",
                error / largest,
                verdict(error < 0.1 * largest),
            )
        )
        figures[f"observed_{name}"] = observed_figure(
            found["full state"], f"Joint 1 by {angle:g}°: observed and true states"
        )
        figures[f"control_{name}"] = control_figure(
            found, f"Joint 1 by {angle:g}°: feedback of all states or of motors only"
        )
    title = "De Luca, Schröder, Thümmel 2007, on a KR15-like robot whose parameters are 5 % wrong"
    return Reproduction(title, tuple(comparisons), (table,), figures)


def experiment(
    robot: Robot,
    start: FloatArray,
    angle: float,
    duration: float,
    gains: FloatArray,
    poles: float = 250.0,
    period: float = PERIOD,
) -> JointMotion:
    """Move joint 1 of the specimen by an angle [°] under feedback on the observer's estimate.

    Parameters
    ----------
    robot
        The model that controller and observer use; the specimen differs from it by 5 %.
    start : (n,)
        Posture at the start [rad].
    angle, duration
        Of the motion [°, s].
    gains
        Feedback gains.
    poles
        Frequency of the observer's poles [rad/s].
    period
        Time between samples [s].
    """
    goal = start + np.radians(angle) * np.eye(robot.n)[0]
    motion = rest_to_rest([start, goal], duration, period).held(BEFORE, AFTER)
    desired = inverse_dynamics(robot, motion)
    controller = StateFeedback(robot, desired, gains, AccelerationObserver(robot, poles, period=period))
    specimen = robot.scaled(stiffness=0.95, damping=1.05, motor_inertia=1.05, mass=1.05)
    steps = int(np.ceil(period / 2.5e-4))
    run = simulate(
        specimen, controller, motion.t[-1], 1 / period, q=start, feedback=controller.observer, substeps=steps
    )
    names = ("theta", "q", "dtheta", "dq")
    true = np.stack([run.truth[name][:, 0] for name in names], axis=1)
    observed = np.stack([getattr(run.known, name)[:, 0] for name in names], axis=1)
    return JointMotion(motion.t, desired.q[:, 0], true, observed)


def observed_figure(motion: JointMotion, title: str) -> Figure:
    """Draw motor position and velocity, torsion and link velocity, true and observed."""
    figure = Figure(figsize=(10, 6), layout="constrained")
    figure.suptitle(title)
    degrees = float(np.degrees(1.0))
    panels = [
        ("motor position [°]", degrees * np.array([1, 0, 0, 0])),
        ("motor velocity [°/s]", degrees * np.array([0, 0, 1, 0])),
        ("torsion [mrad]", 1e3 * np.array([1, -1, 0, 0])),
        ("link velocity [°/s]", degrees * np.array([0, 0, 0, 1])),
    ]
    for axes, (label, weights) in zip(figure.subplots(2, 2, sharex=True).flat, panels, strict=True):
        axes.plot(motion.t, motion.true @ weights, color="0.6", linewidth=3, label="true")
        axes.plot(motion.t, motion.observed @ weights, color=COLOURS[0], linewidth=1, label="observed")
        axes.set(ylabel=label, xlabel="time [s]")
        finish(axes, legend=False)
    axes.legend(frameon=False)
    return figure


def control_figure(motions: dict[str, JointMotion], title: str) -> Figure:
    """Draw the link's position, and its deviation from the plan."""
    figure = Figure(figsize=(10, 4), layout="constrained")
    figure.suptitle(title)
    left, right = figure.subplots(1, 2)
    first = next(iter(motions.values()))
    left.plot(first.t, np.degrees(first.desired), color="0.6", linewidth=3, label="desired")
    for (name, motion), colour in zip(motions.items(), COLOURS, strict=False):
        left.plot(motion.t, np.degrees(motion.true[:, 1]), color=colour, label=name)
        right.plot(motion.t, 1e3 * (motion.true[:, 1] - motion.desired), color=colour, label=name)
    left.set(xlabel="time [s]", ylabel="link position [°]")
    right.set(xlabel="time [s]", ylabel="deviation of the link [mrad]")
    for axes in (left, right):
        finish(axes, legend=False)
        axes.legend(frameon=False)
    return figure
