"""The three examples of Cristofaro and De Luca's paper on a reduced-order velocity observer, on their two-link arm.

1. A bounded velocity and a constant gain, beside the observer of Nicosia and Tomei with the same gain.
2. A velocity beyond the bound: the level of the gain follows the estimate.
3. A position controller on the estimated velocity.

Gravity is compensated exactly in all three, so the arm has none here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, pi, sin
from typing import TypeAlias

import numpy as np
from matplotlib.figure import Figure

from linkside.arrays import FloatArray
from linkside.figures import COLOURS, finish
from linkside.robot import Robot
from linkside.text import Titled
from linkside.velocity.gain_design import GainDesign, design_gain
from linkside.velocity.observers import NicosiaTomeiObserver, ReducedOrderObserver

from .reproduction import PaperComparison, Reproduction, verdict

State: TypeAlias = tuple[float, float, float, float]
"""Positions [rad] and velocities [rad/s] of both joints."""

Pair: TypeAlias = tuple[float, float]
Torque: TypeAlias = Callable[[float, State, Pair], Pair]
"""Torques [N m] by time, state and estimated velocities."""

PERIOD = 1e-3
"""Time between samples [s]."""

FRICTION = (0.1, 0.3)
"""Viscous friction [N m s/rad]."""

START = (-2 * pi / 3, pi / 10, -0.5, 1.0)
TARGET = (pi / 4, -pi / 3)
SPEED, MARGIN = 1.5, 1.0
"""Bounds on the speed, v̄, and on the error, η [rad/s]."""

SPRINGS = (10.0, 100.0, 500.0, 2000.0)
"""Gains K_P of the observer of Nicosia and Tomei; the paper does not state its own [1/s²]."""

LINK = """<link name="{name}"><inertial><origin xyz="{half} 0 0"/><mass value="{mass}"/>
  <inertia ixx="1e-9" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{inertia}"/></inertial></link>"""
ARM = f"""<robot name="rods"><link name="base"/>
  {LINK.format(name="upper", half=0.5, mass=10, inertia=10 / 12)}
  {LINK.format(name="fore", half=0.75, mass=20, inertia=3.75)}
  <joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 1"/></joint>
  <joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="1 0 0"/>
    <axis xyz="0 0 1"/></joint></robot>"""


@dataclass(frozen=True, eq=False)
class ObservedMotion:
    """A motion of the arm and an observer's estimate.

    Attributes
    ----------
    t : (T,)
        Time [s].
    x : (T, 4)
        True positions and velocities [rad, rad/s].
    velocity : (T, 2)
        Estimated velocities [rad/s].
    level : (T,)
        Level of the gain.
    """

    t: FloatArray
    x: FloatArray
    velocity: FloatArray
    level: FloatArray

    @property
    def error(self) -> FloatArray:
        """Norm of the velocities' error (T,) [rad/s]."""
        return np.asarray(np.linalg.norm(self.x[:, 2:] - self.velocity, axis=1))

    def settling(self, threshold: float) -> float:
        """Return from when on the error stays below a threshold [rad/s], in s."""
        above = np.flatnonzero(self.error > threshold)
        return float(self.t[min(above[-1] + 1, len(self.t) - 1)]) if len(above) else 0.0

    @property
    def jumps(self) -> list[tuple[float, float]]:
        """Times of the level's jumps [s], and the levels they lead to."""
        at = np.flatnonzero(np.diff(self.level)) + 1
        return [(float(self.t[i]), float(self.level[i])) for i in at]


def reproduce() -> Reproduction:
    """Run the three examples; takes some seconds."""
    robot = arm()
    design = design_gain(robot, speed=SPEED, margin=MARGIN)
    bounded = example_1(robot, design.gain)
    hybrid = design.hybrid(bound=SPEED, levels=6)
    beyond, regulation = (
        simulate(ReducedOrderObserver(robot, hybrid, period=PERIOD, start="rest"), torque)
        for torque in (driven, regulated)
    )
    table = Titled("Settling of the velocity's error", ("observer", "5 % [s]", "1 % [s]", "1e-3 rad/s [s]"))
    for name, motion in [*bounded.items(), ("example 2", beyond), ("example 3", regulation)]:
        initial = motion.error[0]
        times = (motion.settling(limit) for limit in (0.05 * initial, 0.01 * initial, 1e-3))
        table.add_row(name, *(f"{seconds:.3f}" for seconds in times))
    figures = {
        "bounded": error_figure(bounded),
        "beyond": velocity_figure(beyond),
        "regulation": velocity_figure(regulation),
    }
    title = "Cristofaro, De Luca 2023, on the paper's two-link arm"
    return Reproduction(
        title, compared(design, bounded, beyond, regulation), (table, jump_table(beyond, regulation)), figures
    )


def compared(
    design: GainDesign, bounded: dict[str, ObservedMotion], beyond: ObservedMotion, regulation: ObservedMotion
) -> tuple[PaperComparison, ...]:
    """Set what the paper says beside what was found."""
    first, *others = bounded.values()
    ours, theirs = first.settling(0.01 * first.error[0]), [m.settling(0.01 * m.error[0]) for m in others]
    speed, high = (float(np.linalg.norm(m.x[:, 2:], axis=1).max()) for m in (first, beyond))
    left = float(np.linalg.norm(regulation.x[-1, :2] - TARGET))
    return (
        PaperComparison("gain k₀ of (11) [1/s]", "formula (11)", design.gain, "not stated"),
        PaperComparison("example 1: largest speed [rad/s]", f"at most {SPEED:g}", speed, verdict(speed <= SPEED)),
        PaperComparison("example 1: settling to 1 %, reduced order [s]", "faster", ours, verdict(ours < min(theirs))),
        PaperComparison(
            "example 1: settling to 1 %, best of Nicosia and Tomei [s]",
            "slower",
            min(theirs),
            verdict(ours < min(theirs)),
        ),
        PaperComparison("example 2: largest speed [rad/s]", f"beyond {SPEED:g}", high, verdict(high > SPEED)),
        PaperComparison(
            "example 2: error at 20 s [rad/s]", "converges", float(beyond.error[-1]), verdict(beyond.error[-1] < 1e-3)
        ),
        PaperComparison("example 3: distance from the target at 20 s [rad]", "converges", left, verdict(left < 1e-2)),
        PaperComparison(
            "example 3: level of the gain at 20 s", 1.0, float(regulation.level[-1]), verdict(regulation.level[-1] == 1)
        ),
    )


def arm() -> Robot:
    """Thin rods of 10 and 20 kg, 1 and 1.5 m long."""
    joints = [
        {"name": name, "elastic": False, "link_friction": [0, 0, 0, 0, 0, viscous]}
        for name, viscous in zip(("shoulder", "elbow"), FRICTION, strict=True)
    ]
    return Robot.from_urdf(ARM, joints, gravity=[0, 0, 0])


def slope(x: State, torque: Pair) -> State:
    """Motion of the true arm, in closed form."""
    _, q, v, w = x
    cosine, sine = cos(q), 15 * sin(q)
    a, b, c = 115 / 3 + 30 * cosine, 15 + 15 * cosine, 15.0
    one = torque[0] + sine * w * (2 * v + w) - FRICTION[0] * v
    two = torque[1] - sine * v**2 - FRICTION[1] * w
    determinant = a * c - b * b
    return v, w, (c * one - b * two) / determinant, (a * two - b * one) / determinant


def advance(x: State, torque: Callable[[float, State], Pair], t: float) -> State:
    """One period by Runge and Kutta's method."""

    def moved(k: State, h: float) -> State:
        return x[0] + h * k[0], x[1] + h * k[1], x[2] + h * k[2], x[3] + h * k[3]

    k1 = slope(x, torque(t, x))
    half = moved(k1, PERIOD / 2)
    k2 = slope(half, torque(t + PERIOD / 2, half))
    half = moved(k2, PERIOD / 2)
    k3 = slope(half, torque(t + PERIOD / 2, half))
    whole = moved(k3, PERIOD)
    k4 = slope(whole, torque(t + PERIOD, whole))
    return moved(tuple((a + 2 * b + 2 * c + d) / 6 for a, b, c, d in zip(k1, k2, k3, k4, strict=True)), PERIOD)  # type: ignore[arg-type]


def simulate(observer: ReducedOrderObserver, torque: Torque, seconds: float = 20) -> ObservedMotion:
    """Move the arm under a torque, which may depend on the observer's estimate."""
    count = round(seconds / PERIOD) + 1
    t = np.arange(count) * np.float64(PERIOD)
    states, found, level = np.empty((count, 4)), np.zeros((count, 2)), np.empty(count)
    x: State = START
    estimate, ahead = (0.0, 0.0), (0.0, 0.0)
    for i in range(count):
        states[i] = x

        def applied(at: float, x: State, start: float = t[i] - PERIOD, dq: Pair = estimate, ddq: Pair = ahead) -> Pair:
            """Torque by the estimate of the sample before, extrapolated."""
            h = at - start
            return torque(at, x, (dq[0] + h * ddq[0], dq[1] + h * ddq[1]))

        held = applied(t[i] + PERIOD / 2, x)  # the torque in the middle of the period
        state = observer.step(q=states[i, :2], tau=np.array(held))
        found[i], level[i] = state.dq, state.level
        if i + 1 < count:
            x = advance(x, applied, t[i])
        estimate, ahead = tuple(state.dq.tolist()), tuple(state.ddq.tolist())
    return ObservedMotion(t, states, found, level)


def example_1(robot: Robot, gain: float) -> dict[str, ObservedMotion]:
    """Run all observers with constant gains."""
    observers: dict[str, ReducedOrderObserver] = {
        "reduced order": ReducedOrderObserver(robot, gain, period=PERIOD, start="rest")
    }
    for spring in SPRINGS:
        name = f"Nicosia and Tomei, K_P = {spring:g}"
        observers[name] = NicosiaTomeiObserver(robot, gain, spring, period=PERIOD, start="rest")
    return {name: simulate(one, lambda t, x, dq: (cos(t / 2), -cos(t))) for name, one in observers.items()}


def driven(t: float, x: State, dq: Pair) -> Pair:
    """Torque of the second example."""
    return sin(t), 1 + sin(2 * t)


def regulated(t: float, x: State, dq: Pair) -> Pair:
    """Torque of the third example: a position controller on the estimated velocity."""
    return 40 * (TARGET[0] - x[0]) - 60 * dq[0], 20 * (TARGET[1] - x[1]) - 30 * dq[1]


def jump_table(beyond: ObservedMotion, regulation: ObservedMotion) -> Titled:
    """List the jumps of the gain's level."""
    table = Titled("Jumps of the gain's level", ("example", "jumps"))
    for name, motion in (("2", beyond), ("3", regulation)):
        table.add_row(name, ", ".join(f"{at:.3f} s to {level:g}" for at, level in motion.jumps))
    return table


def error_figure(motions: dict[str, ObservedMotion]) -> Figure:
    """Draw the error of each observer over the first five seconds."""
    figure = Figure(figsize=(8, 4.5), layout="constrained")
    axes = figure.subplots()
    for (name, motion), colour in zip(motions.items(), COLOURS, strict=False):
        shown = slice(0, round(5 / PERIOD), 5)
        axes.semilogy(motion.t[shown], motion.error[shown] + 1e-12, color=colour, label=name)
    axes.set(xlabel="time [s]", ylabel="error of the velocity [rad/s]", ylim=(1e-5, 2))
    finish(axes, legend=False)
    axes.legend(frameon=False)
    return figure


def velocity_figure(motion: ObservedMotion) -> Figure:
    """Draw velocities and their estimates, and the level of the gain."""
    figure = Figure(figsize=(8, 5), layout="constrained")
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1))
    for j in range(2):
        upper.plot(motion.t[::20], motion.x[::20, 2 + j], color=COLOURS[j], label=f"joint {j + 1}")
        upper.plot(motion.t[::20], motion.velocity[::20, j], "--", color="0.4", label="estimate" if j else None)
    upper.set(ylabel="velocity [rad/s]")
    upper.legend(frameon=False)
    lower.step(motion.t[::20], motion.level[::20], where="post", color=COLOURS[0])
    lower.set(xlabel="time [s]", ylabel="level r")
    for axes in (upper, lower):
        finish(axes, legend=False)
    return figure
