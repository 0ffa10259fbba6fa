"""A space robot with elastic joints, controlled on what its motors tell, after Ulrich and Sasiadek (ACC 2011).

Two rods of 4.5 m follow a square of 12.6 m in a minute. Encoders and tachometers of the motors are noisy by 1° and
1°/s; an extended Kalman filter on the elastic-joint model makes eight states of them, and a direct adaptive controller
moves the tool by these. Both joint models of the paper: linear springs; hardening springs with soft wind-up, friction
and inertial coupling. Last, the linear filter on the nonlinear robot: the paper reports that it diverges, which depends
on the process noise that the paper does not state.

    python examples/space_robot.py --rate 100000 --out figures
"""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.signal import lsim

import linkside
from linkside import ElasticJointFilter, ElasticNoise, Robot
from linkside.control.controllers import SimpleAdaptive
from linkside.simulation import Sensor, Simulation, simulate

LENGTH, MASS, HALF, SPEED = 4.5, 1.5075, 6.3, 0.84  # m, kg, m, m/s
INERTIA = MASS * LENGTH**2 / 12  # slender rods: the paper gives masses and lengths only [kg m²]
DEGREE = np.pi / 180
KEPT = 1000.0  # samples that are looked at, a second
SETTLED = 5.0  # from when on the estimate is judged [s]
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


def space_robot(joints: str) -> Robot:
    """Both rods, with one of the paper's joint models; there is no gravity."""
    drives = [{"name": name, "stiffness": 500.0, "motor_inertia": 1.0, **JOINTS[joints]} for name in ("one", "two")]
    coupling = {"one": {"two": 1.0}} if joints == "nonlinear" else {}
    tool = {"link": "fore", "xyz": [LENGTH, 0, 0]}
    return Robot.from_urdf(URDF, drives, gravity=[0, 0, 0], coupling=coupling, tool=tool)


def estimator(robot: Robot, acceleration: float = 1e-4) -> ElasticJointFilter:
    """Filter of the paper; `acceleration` is by how much velocities' variance grows in a second [rad²/s³]."""
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
        feedback=feedback,
        sensors={"theta": Sensor(noise=DEGREE), "dtheta": Sensor(noise=DEGREE)},
        keep_every=round(rate / KEPT),
    )


def tracking(simulation: Simulation) -> tuple[np.ndarray, np.ndarray]:
    """Where the reference model is, and how far the tool is from it (T,) [m]."""
    t, tool = simulation.truth["t"], simulation.truth["tool"][:, :2]
    control = SimpleAdaptive(TIMES, CORNERS)
    w, z = control.bandwidth, control.damping_ratio
    model = ([w * w], [1, 2 * z * w, w * w])
    command = np.column_stack([np.interp(t, TIMES, axis) for axis in CORNERS.T])
    reference = np.column_stack([lsim(model, axis - axis[0], t)[1] + axis[0] for axis in command.T])
    return reference, np.linalg.norm(tool - reference, axis=1)


def estimation_errors(simulation: Simulation) -> np.ndarray:
    """Of all eight states (T, 8) [°, °/s]."""
    known, truth = simulation.known, simulation.truth
    return np.hstack([getattr(known, name) - truth[name] for name in ("q", "dq", "theta", "dtheta")]) / DEGREE


def report(name: str, simulation: Simulation, seconds: float) -> None:
    """Print errors of tracking, and of the estimate where there is one."""
    distance = tracking(simulation)[1]
    print(f"{name:32}{rms(distance):9.4f}{distance.max():9.3f}{seconds:9.1f}")


def rms(x: np.ndarray) -> np.ndarray:
    """Along time."""
    return np.sqrt((x**2).mean(axis=0))


def mismatched(rate: float, duration: float) -> None:
    """Estimate the nonlinear robot's state by the linear robot's filter, for several process noises."""
    print(f"\nlinear filter on the nonlinear robot, {rate:g} Hz")
    print(f"{'process noise [rad²/s³]':52}{'tool [m]':>8}{'link [°/s]':>12}")
    robot, model = space_robot("nonlinear"), space_robot("linear")
    for noise in (1e-10, 1e-8, 1e-6, 1e-4, 1e-2):
        try:
            simulation = run(robot, estimator(model, noise), rate, duration)
        except linkside.LinksideError as error:  # the estimate, or the motion, is no longer finite
            print(f"{noise:<28g}diverges {re.search(r'at t = [0-9.]+', str(error))[0][:-6]} s")
            continue
        t, distance = simulation.truth["t"], tracking(simulation)[1]
        lost = np.flatnonzero(distance > LENGTH)
        verdict = f"diverges, lost at {t[lost[0]]:.1f} s" if lost.size else "stays"
        rates = rms(estimation_errors(simulation)[t > SETTLED, 2:4])
        print(f"{noise:<28g}{verdict:24}{rms(distance):8.4f}{rates.max():12.3f}")


def error_figure(errors: dict[str, tuple[np.ndarray, np.ndarray]]) -> Figure:
    """Estimation errors of all states."""
    figure = Figure(figsize=(10, 10), layout="constrained")
    for j, (axes, label) in enumerate(zip(figure.subplots(4, 2, sharex=True).flat, STATES, strict=True)):
        for (name, (t, error)), colour in zip(errors.items(), ("#0072B2", "#D55E00"), strict=True):
            axes.plot(t, error[:, j], color=colour, linewidth=0.6, label=name)
        axes.set(ylabel=label)
        axes.grid(True, color="0.9")
    axes.set(xlabel="time [s]")
    axes.legend(frameon=False)
    return figure


def path_figure(paths: dict[str, np.ndarray]) -> Figure:
    """Paths of the tool."""
    figure = Figure(figsize=(6, 6), layout="constrained")
    axes = figure.subplots()
    axes.plot(*CORNERS.T, color="0.6", linewidth=3, label="square")
    for (name, path), colour in zip(paths.items(), ("#0072B2", "#D55E00"), strict=True):
        axes.plot(*path.T, color=colour, linewidth=1, label=name)
    axes.set(xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.grid(True, color="0.9")
    axes.legend(frameon=False)
    return figure


def main() -> None:
    """Run everything, print the tables, draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=float, default=1000.0, help="of the whole loop; 100000 in the paper")
    parser.add_argument("--duration", type=float, default=60.0)
    parser.add_argument("--out", type=Path, default=Path("figures"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"{'tool to reference model':32}{'rms [m]':>9}{'max [m]':>9}{'CPU [s]':>9}")
    runs = {}
    for joints in JOINTS:
        robot = space_robot(joints)
        for name, feedback in (("true state", "truth"), ("estimate", estimator(robot))):
            start = time.process_time()
            simulation = run(robot, feedback, options.rate, options.duration)
            report(f"{joints}, {name}", simulation, time.process_time() - start)
        runs[joints] = simulation
    errors = {name: (s.truth["t"], estimation_errors(s)) for name, s in runs.items()}
    print(f"\n{f'estimate after {SETTLED:g} s':16}" + "".join(f"{f'{name}, rms':>16}{'max':>10}" for name in runs))
    late = {name: error[t > SETTLED] for name, (t, error) in errors.items()}
    for j, label in enumerate(STATES):
        cells = (f"{rms(error[:, j]):16.5f}{np.abs(error[:, j]).max():10.5f}" for error in late.values())
        print(f"{label:16}" + "".join(cells))
    mismatched(min(options.rate, 10_000), options.duration)
    error_figure(errors).savefig(options.out / "estimation_errors.png")
    path_figure({name: s.truth["tool"][:, :2] for name, s in runs.items()}).savefig(options.out / "tool_path.png")


if __name__ == "__main__":
    main()
