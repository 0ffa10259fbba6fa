"""A square path on a two-axis arm whose model is wrong, after Axelsson, Karlsson and Norrlöf (ICRA 2012).

The paper compares the tool's position by motors alone, by an extended Kalman filter and by a particle filter, along a
square of 0.2 m. Its robot is not published. Here a simulated arm of a similar size makes the recording; the model that
the filters use has a wrong stiffness, wrong damping, wrong masses and no payload, and its accelerometer has a low-pass
filter of which the model knows nothing. The same comparison runs on any recording with a truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from linkside.arrays import FloatArray
from linkside.control.controllers import State
from linkside.control.trajectories import rest_to_rest
from linkside.figures import COLOURS, finish
from linkside.kalman.jerk_driven import ExtendedKalmanFilter, RauchTungStriebelSmoother
from linkside.kalman.noise import Noise
from linkside.particle.filters import MarginalizedParticleFilter
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.simulation.simulator import Sensor, simulate
from linkside.text import Titled
from linkside.tuning import tune

from .reproduction import PaperComparison, Reproduction, verdict

EVERY = 10
"""Samples of 2 kHz for one of 200 Hz."""

NORMS = {"motors alone": 0.1666, "EKF": 0.1239, "particles": 0.0827}
"""The paper's 2-norms of the tool's error [m]. They grow with the number of samples, so only ratios compare."""

PARTICLES = 500
STYLES = {
    "motors alone": (COLOURS[1], ":"),
    "EKF, 2 kHz": (COLOURS[0], "-"),
    "EKF, 200 Hz": (COLOURS[5], "--"),
    "smoother": (COLOURS[2], "-"),
    "particles": (COLOURS[3], "-"),
}
RATE = 2000.0
CORNERS = np.array([[1.15, 0.8], [1.35, 0.8], [1.35, 1.0], [1.15, 1.0], [1.15, 0.8]])
"""Corners of the square, x and z of the tool [m]."""

SIDE_DURATION = 0.4
"""Time along one side [s]."""

BASE, UPPER, REACH = (0.175, 0.495), 0.9, 1.1
"""Place of the first axis in x and z, length of the upper arm, and distance of the tool from the second axis [m]."""

URDF = """<robot name="arm"><link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.42"/><mass value="95"/>
    <inertia ixx="7.5" ixy="0" ixz="0" iyy="7.5" iyz="0" izz="0.8"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0.38 0 0.06"/><mass value="120"/>
    <inertia ixx="1.5" ixy="0" ixz="0" iyy="14" iyz="0" izz="14"/></inertial></link>
  <joint name="axis2" type="continuous"><parent link="base"/><child link="upper"/>
    <origin xyz="0.175 0 0.495"/><axis xyz="0 1 0"/></joint>
  <joint name="axis3" type="continuous"><parent link="upper"/><child link="fore"/>
    <origin xyz="0 0 0.9"/><axis xyz="0 1 0"/></joint></robot>"""


@dataclass(frozen=True, eq=False)
class ToolError:
    """The tool's error by one method, at the instants that all methods have, its constant part removed (T, 3) [m]."""

    error: FloatArray

    @property
    def norm(self) -> float:
        """The error's 2-norm over the recording [m]."""
        return float(np.linalg.norm(self.error))

    @property
    def rms(self) -> float:
        """The error's root mean square [mm]."""
        return 1e3 * self.norm / float(np.sqrt(len(self.error)))


def reproduce(recording: str | PathLike[str] | None = None, *, tuned: bool = False) -> Reproduction:
    """Compare the methods; takes a few seconds.

    Parameters
    ----------
    recording
        Folder with robot.yaml, log.parquet and truth.parquet. Without one the square is simulated.
    tuned
        Whether to compare with noise tuned to the recording, too, which takes half a minute.
    """
    robot, log, truth = simulated() if recording is None else read(Path(recording))
    true = centres(truth)
    by_noise = {"defaults": compare(robot, log, true, Noise())}
    if tuned:
        after = tune(robot, log).after
        assert isinstance(after, Noise)
        by_noise["tuned"] = compare(robot, log, true, after)
    found = by_noise["defaults"]
    short = {"motors alone": "motors alone", "EKF": "EKF, 2 kHz", "particles": "particles"}
    comparisons = []
    for one, other in (("EKF", "motors alone"), ("particles", "EKF"), ("particles", "motors alone")):
        ratio = found[short[one]].norm / found[short[other]].norm
        comparisons.append(
            PaperComparison(f"tool error, {one} over {other}", NORMS[one] / NORMS[other], ratio, verdict(ratio < 1))
        )
    slow = found["EKF, 200 Hz"].norm / found["EKF, 2 kHz"].norm
    comparisons.append(
        PaperComparison("tool error, EKF at 200 Hz over EKF at 2 kHz", "200 Hz is enough", slow, verdict(slow < 1.25))
    )
    t = centres(log.t)
    figures = {"error": error_figure(t, found), "path": path_figure(true, found), "sides": side_figure(true, found)}
    title = "Axelsson, Karlsson, Norrlöf 2012, on an arm whose model is wrong"
    return Reproduction(title, tuple(comparisons), tuple(error_table(*item) for item in by_noise.items()), figures)


def read(folder: Path) -> tuple[Robot, Log, FloatArray]:
    """Read the robot, the log and the true path of the tool of a recording."""
    robot = Robot.load(folder / "robot.yaml")
    truth = Estimate.read(folder / "truth.parquet").tool_position
    assert truth is not None
    return robot, Log.read(folder / "log.parquet", robot), truth


def arm(
    *, stiffness: float = 1.0, damping: float = 1.0, mass: float = 1.0, payload: float = 0.0, hardening: float = 0.0
) -> Robot:
    """Build the arm: factors on its springs, dampers and masses, a payload [kg] and cubic springs [N m/rad³]."""
    springs, dampers, inertias = (4.5e5, 3e5), (500.0, 320.0), (70.0, 40.0)
    joints = [
        {"name": name, "stiffness": k, "damping": d, "motor_inertia": b, "cubic_stiffness": hardening}
        for name, k, d, b in zip(("axis2", "axis3"), springs, dampers, inertias, strict=True)
    ]
    sensor = {"name": "tool_acc", "link": "fore", "xyz": [1.0, 0, 0.08], "rpy": [0, 0.35, 0], "noise_std": 0.05}
    robot = Robot.from_urdf(
        URDF,
        joints,
        accelerometers=[sensor],
        encoder={"resolution": 7e-7},
        tool={"link": "fore", "xyz": [REACH, 0, 0]},
        payload={"mass": payload / mass},
    )
    return robot.scaled(stiffness=stiffness, damping=damping, mass=mass)


def simulated() -> tuple[Robot, Log, FloatArray]:
    """Move the tool along the square; return the wrong model, the log and the true path of the tool."""
    square = rest_to_rest(CORNERS, SIDE_DURATION, 1 / RATE).held(0.2, 0.2)
    q, dq, ddq = joint_path(square.q, square.dq, square.ddq)
    specimen = arm(stiffness=0.92, damping=1.4, mass=1.05, payload=4.0, hardening=5e9)

    def controller(t: float, state: State) -> FloatArray:
        row = min(round(RATE * t), len(q) - 1)
        torque = specimen.gravity_torque(q[row])
        torque += [2e6, 1e6] * (q[row] - state.theta) + [3e4, 1.2e4] * (dq[row] - state.dtheta)
        return torque

    sensors = {"dtheta": Sensor(noise=1e-3), "acceleration": Sensor(noise=0.05, bias=0.1, corner_frequency=250.0)}
    run = simulate(specimen, controller, square.t[-1], RATE, q=q[0], feedback="sensors", sensors=sensors, substeps=4)
    robot = arm()
    signals = {"theta": run.log.theta, "dtheta": run.log.dtheta, "tau": run.log.tau, "ddqref": ddq}
    columns = {f"{signal}_{name}": x[:, j] for signal, x in signals.items() for j, name in enumerate(robot.names)}  # type: ignore[index]
    columns |= dict(zip(robot.acceleration_channels, run.log.acceleration.T, strict=True))  # type: ignore[union-attr]
    return robot, Log.from_table({"t": run.log.t, **columns}, robot, "simulated square"), run.truth["tool"]


def joint_path(tool: FloatArray, velocity: FloatArray, acceleration: FloatArray) -> tuple[FloatArray, ...]:
    """Positions, velocities and accelerations of both joints (T, 2) for a path of the tool in x and z, elbow up."""
    x, z = (tool - BASE).T
    bend = np.arccos((x**2 + z**2 - UPPER**2 - REACH**2) / (2 * UPPER * REACH))
    upper = np.arctan2(x, z) - np.arctan2(REACH * np.sin(bend), UPPER + REACH * np.cos(bend))
    angles = np.stack([upper, upper + bend], axis=1)  # of both links from the vertical
    lengths = np.array([UPPER, REACH])
    jacobian = np.stack([lengths * np.cos(angles), -lengths * np.sin(angles)], axis=1)
    rates = np.linalg.solve(jacobian, velocity[:, :, None])[:, :, 0]
    outward = np.stack([lengths * np.sin(angles), lengths * np.cos(angles)], axis=1)
    drift = np.einsum("tij,tj->ti", outward, rates**2)
    accelerations = np.linalg.solve(jacobian, (acceleration + drift)[:, :, None])[:, :, 0]
    joints = np.array([[1.0, 0.0], [-1.0, 1.0]])  # from angles of links to those of joints
    return angles @ joints.T - [0, np.pi / 2], rates @ joints.T, accelerations @ joints.T


def compare(robot: Robot, log: Log, true: FloatArray, noise: Noise) -> dict[str, ToolError]:
    """Estimate by every method; all are compared at the instants of the 200 Hz filter."""
    fast = ExtendedKalmanFilter(robot, noise).run(log)
    slow = ExtendedKalmanFilter(robot, averaged_noise(noise)).run(decimated(robot, log))
    smooth = RauchTungStriebelSmoother(robot, noise).run(log)
    cloud = MarginalizedParticleFilter(robot, noise, particles=PARTICLES).run(log)
    tools = {
        "motors alone": centres(robot.tool_position(log.theta)),
        "EKF, 2 kHz": centres(fast.tool_position),
        "EKF, 200 Hz": slow.require("tool_position")[0],
        "smoother": centres(smooth.tool_position),
        "particles": centres(cloud.tool_position),
    }
    return {name: ToolError(centred(tool - true)) for name, tool in tools.items()}


def centres(signal: FloatArray | None) -> FloatArray:
    """Return a signal in the middle of each group of samples."""
    assert signal is not None
    whole = len(signal) // EVERY * EVERY
    groups = signal[:whole].reshape(-1, EVERY, *signal.shape[1:])
    return 0.5 * (groups[:, EVERY // 2 - 1] + groups[:, EVERY // 2])


def averages(signal: FloatArray | None) -> FloatArray:
    """Return a signal averaged over each group of samples, against aliasing."""
    assert signal is not None
    whole = len(signal) // EVERY * EVERY
    return np.asarray(signal[:whole].reshape(-1, EVERY, *signal.shape[1:]).mean(axis=1))


def decimated(robot: Robot, log: Log) -> Log:
    """Keep a tenth of the samples; the filter takes its time step from them."""
    columns = dict(zip((f"theta_{joint}" for joint in robot.names), centres(log.theta).T, strict=True))
    columns |= dict(zip(robot.acceleration_channels, averages(log.acceleration).T, strict=True))
    for signal in ("dtheta", "ddqref"):
        if (values := getattr(log, signal)) is not None:
            columns |= dict(zip((f"{signal}_{joint}" for joint in robot.names), centres(values).T, strict=True))
    return Log.from_table({"t": centres(log.t), **columns}, robot, check=False)  # the rate is not that of robot.yaml


def averaged_noise(noise: Noise) -> Noise:
    """Noise of averages of ten readings.

    The mean of n readings has less noise. An error of the transmission that lasts ten samples is the same in all of
    them, so one sample in place of ten must weigh as much as the ten did: its variance is a tenth.
    """
    share = 1 / np.sqrt(EVERY)
    smaller = {name: getattr(noise, name) for name in ("acceleration", "transmission")}
    return noise.updated(**{name: tuple(share * np.atleast_1d(value)) for name, value in smaller.items()})


def centred(error: FloatArray) -> FloatArray:
    """Remove an error's constant part: alignment by a translation, as in the paper."""
    return np.asarray(error - error.mean(axis=0))


def error_table(noise: str, found: dict[str, ToolError]) -> Titled:
    """2-norm, RMS and ratio to the motors of each method."""
    table = Titled(
        f"Error of the tool, offset removed, noise: {noise}", ("method", "2-norm [m]", "RMS [mm]", "over motors")
    )
    motors = found["motors alone"].norm
    for name, one in found.items():
        table.add_row(name, f"{one.norm:.5f}", f"{one.rms:.4f}", f"{one.norm / motors:.3f}")
    return table


def error_figure(t: FloatArray, found: dict[str, ToolError]) -> Figure:
    """Draw the size of each error over time."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, one in found.items():
        colour, dash = STYLES[name]
        size = 1e3 * np.linalg.norm(one.error, axis=1)
        axes.plot(t, size, color=colour, linestyle=dash, linewidth=1.3, label=f"{name}: {one.rms:.2f} mm RMS")
    axes.set(xlabel="time [s]", ylabel="error of the tool, offset removed [mm]", ylim=(0, None))
    finish(axes, legend=False)
    axes.legend(frameon=False)
    return figure


def path_figure(true: FloatArray, found: dict[str, ToolError]) -> Figure:
    """Draw the square, each deviation from the true path magnified."""
    factor = 10
    figure = Figure(figsize=(6.5, 7.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(true[:, 0], true[:, 2], color="0.75", linewidth=5, label="true")
    for name, one in found.items():
        colour, dash = STYLES[name]
        shown = true + factor * one.error
        axes.plot(shown[:, 0], shown[:, 2], color=colour, linestyle=dash, linewidth=1.3, label=name)
    title = f"Path of the tool; deviations × {factor}, offset removed"
    axes.set(xlabel="x [m]", ylabel="z [m]", aspect="equal", title=title)
    finish(axes, legend=False)
    axes.legend(frameon=False)
    return figure


def side_figure(true: FloatArray, found: dict[str, ToolError]) -> Figure:
    """Draw the four sides, magnified across."""
    low, high = true.min(axis=0), true.max(axis=0)
    margin = 0.1 * (high - low)
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    grid = figure.subplots(2, 2)
    sides = (("lower", 2, 0, low[2]), ("right", 0, 2, high[0]), ("upper", 2, 0, high[2]), ("left", 0, 2, low[0]))
    for axes, (name, across, along, at) in zip(grid.flat, sides, strict=True):
        edge = round(float(at), 2)
        near = np.abs(true[:, across] - edge) < 0.02
        near &= (true[:, along] > low[along] + margin[along]) & (true[:, along] < high[along] - margin[along])
        axes.plot(true[near, along], 1e3 * (true[near, across] - edge), color="0.75", linewidth=4, label="true")
        for method, one in found.items():
            colour, dash = STYLES[method]
            offset = 1e3 * (true + one.error)[near, across] - 1e3 * edge
            axes.plot(true[near, along], offset, color=colour, linestyle=dash, linewidth=1.3, label=method)
        axes.set(title=f"{name} side", xlabel=f"{'xyz'[along]} [m]", ylabel=f"{'xyz'[across]} − {edge:.2f} m [mm]")
        finish(axes, legend=False)
    grid[0, 0].legend(frameon=False)
    return figure
