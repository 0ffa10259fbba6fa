"""A space robot with elastic joints, controlled on estimates from its motors, after Ulrich and Sasiadek (ACC 2011).

Two rods of 4.5 m follow a square of 12.6 m in a minute. Encoders and tachometers of the motors have noise of 1° and
1°/s. An extended Kalman filter on the elastic-joint model estimates eight states from them, and a direct adaptive
controller moves the tool by the estimate. Both joint models of the paper are run: linear springs, and hardening springs
with soft wind-up, friction and inertial coupling. Finally the filter for linear springs is run on the nonlinear robot.
The paper reports that it diverges; that depends on the process noise, which the paper does not state.
"""

from __future__ import annotations

import re

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import lsim

from linkside.arrays import FloatArray
from linkside.control.controllers import SimpleAdaptive
from linkside.errors import LinksideError
from linkside.figures import COLOURS, finish
from linkside.kalman.elastic_joint import ElasticJointFilter, ElasticNoise
from linkside.robot import Robot
from linkside.simulation.simulator import Sensor, Simulation, simulate
from linkside.text import Titled

from .reproduction import PaperComparison, Reproduction, verdict

LENGTH, MASS, HALF, SPEED = 4.5, 1.5075, 6.3, 0.84
"""Length [m] and mass [kg] of a rod, half the side of the square [m], speed along it [m/s]."""

INERTIA = MASS * LENGTH**2 / 12
"""Inertia of a slender rod; the paper gives masses and lengths only [kg m²]."""

DEGREE = np.pi / 180
KEPT = 1000.0
"""Samples that are kept in a second."""

FASTEST_MISMATCHED = 1e4
"""Highest rate of the runs with the wrong filter [Hz]."""

SETTLED = 5.0
"""From when on the estimate is judged [s]."""

CORNERS = HALF * np.array([[1, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]])
TIMES = np.arange(5) * 2 * HALF / SPEED
JOINTS = {
    "linear": {},
    "nonlinear": {
        "cubic_stiffness": 500.0,
        "soft_windup": {"stiffness": 10.0, "shape": 3000.0},
        "link_friction": [0.5, 150.0, 50.0, 2.0, 100.0, 0.5],
    },
}
STATES = [f"{side} {j} [{unit}]" for side in ("link", "motor") for unit in ("°", "°/s") for j in (1, 2)]
ROD = """<link name="{name}"><inertial><origin xyz="2.25 0 0"/><mass value="1.5075"/>
  <inertia ixx="1e-9" ixy="0" ixz="0" iyy="{i}" iyz="0" izz="{i}"/></inertial></link>
<joint name="{joint}" type="continuous"><parent link="{parent}"/><child link="{name}"/>
  <origin xyz="{x} 0 0"/><axis xyz="0 0 1"/></joint>"""
URDF = (
    '<robot name="space"><link name="base"/>'
    + ROD.format(name="upper", joint="one", parent="base", x=0, i=INERTIA)
    + ROD.format(name="fore", joint="two", parent="upper", x=LENGTH, i=INERTIA)
    + "</robot>"
)


def reproduce(rate: float = 1000.0, duration: float = 60.0) -> Reproduction:
    """Run both joint models, with the true state and the estimate fed back, and the wrong filter.

    Parameters
    ----------
    rate
        Rate of the whole loop [Hz]. The paper's is 100 kHz, which takes minutes.
    duration
        Of each run [s].
    """
    head = f"Distance of the tool from its reference model, {rate:g} Hz"
    tracked = Titled(head, ("joints", "fed back", "rms [m]", "largest [m]"))
    runs, overshoot = dict[str, Simulation](), dict[str, float]()
    for joints in JOINTS:
        robot = space_robot(joints)
        for name, feedback in (("true state", "truth"), ("estimate", estimator(robot))):
            runs[joints] = run(robot, feedback, rate, duration)
            distance = tracking(runs[joints])[1]
            tracked.add_row(joints, name, f"{rms(distance):.4f}", f"{distance.max():.3f}")
        overshoot[joints] = float(beyond_square(runs[joints]).max())
    name = "largest distance outside the square, {} joints [m]"
    more = verdict(overshoot["nonlinear"] > overshoot["linear"])
    comparisons = [
        PaperComparison(name.format("linear"), "minimal, no number", overshoot["linear"], "not stated"),
        PaperComparison(name.format("nonlinear"), "slightly more", overshoot["nonlinear"], more),
    ]
    wrong, diverging = mismatched(min(rate, FASTEST_MISMATCHED), duration)
    comparisons.append(
        PaperComparison(
            "largest process noise with which the linear filter diverges [rad²/s³]",
            "diverges (noise not stated)",
            diverging,
            verdict(diverging > 0),
        )
    )
    errors = {name: (s.truth["t"], estimation_errors(s)) for name, s in runs.items()}
    figures = {
        "tool_path": path_figure({f"{name} joints": s.truth["tool"][:, :2] for name, s in runs.items()}),
        "estimation_errors": error_figure(errors),
    }
    title = "Ulrich, Sasiadek 2011, with the links' inertia, the process noise and the controller reconstructed"
    return Reproduction(title, tuple(comparisons), (tracked, error_table(errors), wrong), figures)


def space_robot(joints: str) -> Robot:
    """Both rods, with one of the paper's joint models; there is no gravity."""
    drives = [{"name": name, "stiffness": 500.0, "motor_inertia": 1.0, **JOINTS[joints]} for name in ("one", "two")]
    coupling = {"one": {"two": 1.0}} if joints == "nonlinear" else {}
    tool = {"link": "fore", "xyz": [LENGTH, 0, 0]}
    return Robot.from_urdf(URDF, drives, gravity=[0, 0, 0], coupling=coupling, tool=tool)


def estimator(robot: Robot, acceleration: float = 1e-4) -> ElasticJointFilter:
    """Filter of the paper; `acceleration` is the growth of the velocities' variance in a second [rad²/s³]."""
    noise = ElasticNoise(
        link_acceleration=acceleration**0.5,
        motor_acceleration=acceleration**0.5,
        transmission=DEGREE,
        motor_velocity=DEGREE,
        torque=0.0,
    )
    return ElasticJointFilter(robot, noise, disturbances=False, biases=(), transition="first-order")


def run(robot: Robot, feedback: ElasticJointFilter | str, rate: float, duration: float) -> Simulation:
    """Follow the square."""
    elbow = np.arccos(HALF**2 / LENGTH**2 - 1)
    return simulate(
        robot,
        SimpleAdaptive(TIMES, CORNERS, axes="xy"),
        duration,
        rate,
        q=[-np.pi / 4 - elbow / 2, elbow],
        tau=[0, 0],
        feedback=feedback,  # type: ignore[arg-type]  # "truth"
        sensors={"theta": Sensor(noise=DEGREE), "dtheta": Sensor(noise=DEGREE)},
        keep_every=max(1, round(rate / KEPT)),
    )


def tracking(simulation: Simulation) -> tuple[FloatArray, FloatArray]:
    """Position of the reference model (T, 2), and distance of the tool from it (T,) [m]."""
    t, tool = simulation.truth["t"], simulation.truth["tool"][:, :2]
    control = SimpleAdaptive(TIMES, CORNERS)
    w, z = control.bandwidth, control.damping_ratio
    model = ([w * w], [1, 2 * z * w, w * w])
    command = np.column_stack([np.interp(t, TIMES, axis) for axis in CORNERS.T])
    reference = np.column_stack([lsim(model, axis - axis[0], t)[1] + axis[0] for axis in command.T])
    return reference, np.sqrt(((tool - reference) ** 2).sum(axis=1))


def beyond_square(simulation: Simulation) -> FloatArray:
    """Distance of the tool outside the square, 0 inside (T,) [m]."""
    outside = np.maximum(np.abs(simulation.truth["tool"][:, :2]) - HALF, 0.0)
    distance: FloatArray = np.linalg.norm(outside, axis=1)
    return distance


def estimation_errors(simulation: Simulation) -> FloatArray:
    """Of all eight states (T, 8) [°, °/s]."""
    known, truth = simulation.known, simulation.truth
    return np.hstack([getattr(known, name) - truth[name] for name in ("q", "dq", "theta", "dtheta")]) / DEGREE


def rms(x: FloatArray) -> FloatArray:
    """Root mean square along time."""
    return np.asarray(np.sqrt((x**2).mean(axis=0)))


def mismatched(rate: float, duration: float) -> tuple[Titled, float]:
    """Estimate the nonlinear robot's state by the linear robot's filter, for several process noises.

    Returns
    -------
    table : Titled
        A row for each process noise.
    diverging : float
        The largest process noise with which the loop diverges [rad²/s³], 0 if with none.
    """
    head = f"Filter for linear springs on the nonlinear robot, {rate:g} Hz"
    table = Titled(head, ("process noise [rad²/s³]", "loop", "tool, rms [m]", "link velocity, rms [°/s]"))
    robot, model = space_robot("nonlinear"), space_robot("linear")
    diverging = 0.0
    for noise in (1e-10, 1e-8, 1e-6, 1e-4, 1e-2):
        try:
            simulation = run(robot, estimator(model, noise), rate, duration)
        except LinksideError as error:  # the estimate, or the motion, is no longer finite
            when = re.search(r"at t = ([0-9.]+)", str(error))
            table.add_row(f"{noise:g}", f"diverges at {float(when[1]):.1f} s" if when else "diverges", "", "")
            diverging = noise
            continue
        t, distance = simulation.truth["t"], tracking(simulation)[1]
        lost = np.flatnonzero(distance > LENGTH)
        if lost.size:
            diverging = noise
        rates = rms(estimation_errors(simulation)[t > SETTLED, 2:4])
        loop = f"diverges, tool lost at {t[lost[0]]:.1f} s" if lost.size else "stable"
        table.add_row(f"{noise:g}", loop, f"{rms(distance):.4f}", f"{rates.max():.3f}")
    return table, diverging


def error_table(errors: dict[str, tuple[FloatArray, FloatArray]]) -> Titled:
    """RMS and largest error of each state after the start."""
    heads = ("state", *(f"{name}, {what}" for name in errors for what in ("rms", "largest")))
    table = Titled(f"Error of the estimate after {SETTLED:g} s", heads)
    late = [error[t > SETTLED] for t, error in errors.values()]
    for j, label in enumerate(STATES):
        cells = (f"{value:.4f}" for error in late for value in (rms(error[:, j]), np.abs(error[:, j]).max()))
        table.add_row(label, *cells)
    return table


def path_figure(paths: dict[str, FloatArray]) -> Figure:
    """Draw the square and the paths of the tool."""
    figure = Figure(figsize=(6, 6), layout="constrained")
    axes = figure.subplots()
    axes.plot(*CORNERS.T, color="0.6", linewidth=3, label="square")
    for (name, path), colour in zip(paths.items(), COLOURS, strict=False):
        axes.plot(*path[:: round(KEPT / 50)].T, color=colour, linewidth=1, label=name)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    finish(axes, legend=False)
    axes.legend(frameon=False)
    return figure


def error_figure(errors: dict[str, tuple[FloatArray, FloatArray]]) -> Figure:
    """Draw the estimation errors of all states."""
    figure = Figure(figsize=(10, 10), layout="constrained")
    for j, (axes, label) in enumerate(zip(figure.subplots(4, 2, sharex=True).flat, STATES, strict=True)):
        for (name, (t, error)), colour in zip(errors.items(), COLOURS, strict=False):
            axes.plot(t[::20], error[::20, j], color=colour, linewidth=0.6, label=f"{name} joints")
        axes.set(ylabel=label)
        finish(axes, legend=False)
    axes.set(xlabel="time [s]")
    axes.legend(frameon=False)
    return figure
