"""A square path on a two-axis arm whose model is wrong: how far off are motors, filters and smoother?

The experiment of Axelsson, Karlsson and Norrlöf, "Tool position estimation of a flexible industrial robot using
recursive Bayesian methods" (ICRA 2012), on a simulated arm: stiffness and masses in robot.yaml are not those that made
the recording.

    python examples/square_path.py [recording] [--out square_path]
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

import linkside
from linkside.figures import COLOURS
from linkside.tuning import tune

Array = npt.NDArray[np.float64]

RECORDING = Path(__file__).parents[1] / "tests/data/arm2_square_mismatch"
EVERY = 10  # samples of 2 kHz for one of 200 Hz
PAPER = {"motors alone": 0.1666, "EKF": 0.1239, "particles": 0.0827}  # 2-norms of the error [m], from another robot
STYLES = {
    "motors alone": (COLOURS[1], ":"),
    "EKF, 2 kHz": (COLOURS[0], "-"),
    "EKF, 200 Hz": (COLOURS[5], "--"),
    "smoother": (COLOURS[2], "-"),
    "particles": (COLOURS[3], "-"),
}
PARTICLES = 500


@dataclass
class Result:
    """The tool's error by one method, at the instants that all methods have, its constant part out (T, 3) [m]."""

    error: Array

    @property
    def norm(self) -> float:
        """The error's 2-norm over the recording, offset out [m]."""
        return float(np.linalg.norm(self.error))

    @property
    def rms(self) -> float:
        """The error's root mean square, offset out [mm]."""
        return 1e3 * self.norm / np.sqrt(len(self.error))


def main() -> None:
    """Estimate, compare, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("recording", type=Path, nargs="?", default=RECORDING, help="its folder")
    parser.add_argument("--out", type=Path, default=Path("square_path"), help="folder for the figures")
    arguments = parser.parse_args()
    robot = linkside.Robot.load(arguments.recording / "robot.yaml")
    log = linkside.Log.read(arguments.recording / "log.parquet", robot)
    truth = linkside.Estimate.read(arguments.recording / "truth.parquet")
    tuned = tune(robot, log)
    print(f"noise tuned to the recording, without the truth:\n{tuned.to_text()}")
    true = centres(truth.tool_position)
    results = compare(robot, log, true, tuned.after)
    print(table({"defaults": compare(robot, log, true, linkside.Noise()), "tuned": results}))
    arguments.out.mkdir(parents=True, exist_ok=True)
    t = centres(log.t)
    for name, figure in (("path", path(true, results)), ("sides", sides(true, results)), ("error", errors(t, results))):
        figure.savefig(arguments.out / f"{name}.png", dpi=150)
        print(f"figure: {arguments.out / name}.png")


def compare(robot: linkside.Robot, log: linkside.Log, true: Array, noise: linkside.Noise) -> dict[str, Result]:
    """Estimate by every method; all are looked at at the instants of the 200 Hz filter."""
    fast = linkside.ExtendedKalmanFilter(robot, noise).run(log)
    slow = linkside.ExtendedKalmanFilter(robot, averaged_noise(noise)).run(decimated(robot, log))
    smooth = linkside.RauchTungStriebelSmoother(robot, noise).run(log)
    cloud = linkside.MarginalizedParticleFilter(robot, noise, particles=PARTICLES).run(log)
    tools = {
        "motors alone": centres(robot.tool_position(log.theta)),
        "EKF, 2 kHz": centres(fast.tool_position),
        "EKF, 200 Hz": slow.tool_position,
        "smoother": centres(smooth.tool_position),
        "particles": centres(cloud.tool_position),
    }
    return {name: Result(centred(tool - true)) for name, tool in tools.items()}


def centres(signal: Array) -> Array:
    """A signal in the middle of each group of samples."""
    whole = len(signal) // EVERY * EVERY
    groups = signal[:whole].reshape(-1, EVERY, *signal.shape[1:])
    return 0.5 * (groups[:, EVERY // 2 - 1] + groups[:, EVERY // 2])


def averages(signal: Array) -> Array:
    """A signal averaged over each group of samples, against aliasing."""
    whole = len(signal) // EVERY * EVERY
    return signal[:whole].reshape(-1, EVERY, *signal.shape[1:]).mean(axis=1)


def decimated(robot: linkside.Robot, log: linkside.Log) -> linkside.Log:
    """A tenth of the samples; the filter takes its step of time from them."""
    columns = dict(zip((f"theta_{joint}" for joint in robot.names), centres(log.theta).T, strict=True))
    columns |= dict(zip(robot.acceleration_channels, averages(log.acceleration).T, strict=True))
    for signal in ("dtheta", "ddqref"):
        if (values := getattr(log, signal)) is not None:
            columns |= dict(zip((f"{signal}_{joint}" for joint in robot.names), centres(values).T, strict=True))
    return linkside.Log.from_table({"t": centres(log.t), **columns}, robot)


def averaged_noise(noise: linkside.Noise) -> linkside.Noise:
    """The mean of n readings is less noisy; the error of a transmission, which lasts, is then met less often.

    Ten errors in a row that are one and the same weigh as much in one sample as in ten: its variance is a tenth.
    """
    share = 1 / np.sqrt(EVERY)
    transmission = tuple(share * np.broadcast_to(noise.transmission, len(np.atleast_1d(noise.transmission))))
    return noise.updated(acceleration=share * noise.acceleration, transmission=transmission)


def centred(error: Array) -> Array:
    """Error without its constant part: aligned by a translation, as in the paper."""
    return error - error.mean(axis=0)


def table(by_noise: dict[str, dict[str, Result]]) -> str:
    """2-norm, RMS and ratio to the motors, beside the paper's."""
    lines = [f"{'offset out':16}" + "".join(f"{noise:>34}" for noise in by_noise)]
    lines.append(f"{'':16}" + f"{'2-norm [m]':>12}{'RMS [mm]':>11}{'ratio':>11}" * len(by_noise))
    for name in STYLES:
        cells = ""
        for results in by_noise.values():
            one, motors = results[name], results["motors alone"]
            cells += f"{one.norm:12.5f}{one.rms:11.4f}{one.norm / motors.norm:11.3f}"
        lines.append(f"{name:16}{cells}")
    for one, other in (("EKF", "motors alone"), ("particles", "EKF"), ("particles", "motors alone")):
        ratio = PAPER[one] / PAPER[other]
        lines.append(f"the paper, on its robot: {one}/{other} = {PAPER[one]}/{PAPER[other]} = {ratio:.3f}")
    return "\n".join(lines) + "\n"


def path(true: Array, results: dict[str, Result]) -> Figure:
    """Draw the square, each deviation from the true path magnified."""
    factor = 10
    figure = Figure(figsize=(6.5, 7.5), layout="constrained")
    axes = figure.subplots()
    axes.plot(true[:, 0], true[:, 2], color="0.75", linewidth=5, label="true")
    for name, result in results.items():
        colour, dash = STYLES[name]
        shown = true + factor * result.error
        axes.plot(shown[:, 0], shown[:, 2], color=colour, linestyle=dash, linewidth=1.3, label=name)
    axes.set(
        xlabel="x [m]", ylabel="z [m]", aspect="equal", title=f"Path of the tool; deviations × {factor}, offset out"
    )
    finish(axes)
    return figure


def sides(true: Array, results: dict[str, Result]) -> Figure:
    """Draw the four sides, magnified across."""
    low, high = true.min(axis=0), true.max(axis=0)
    margin = 0.1 * (high - low)
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    grid = figure.subplots(2, 2)
    for axes, (name, across, along, edge) in zip(grid.flat, edges(low, high), strict=True):
        near = np.abs(true[:, across] - edge) < 0.02
        near &= (true[:, along] > low[along] + margin[along]) & (true[:, along] < high[along] - margin[along])
        axes.plot(true[near, along], 1e3 * (true[near, across] - edge), color="0.75", linewidth=4, label="true")
        for method, result in results.items():
            colour, dash = STYLES[method]
            offset = 1e3 * (true + result.error)[near, across] - 1e3 * edge
            axes.plot(true[near, along], offset, color=colour, linestyle=dash, linewidth=1.3, label=method)
        axes.set(title=f"{name} side", xlabel=f"{'xyz'[along]} [m]", ylabel=f"{'xyz'[across]} − {edge:.2f} m [mm]")
        finish(axes, legend=axes is grid[0, 0])
    return figure


def edges(low: Array, high: Array) -> list[tuple[str, int, int, float]]:
    """Name, axis across, axis along, and nominal place of each side of the square in x and z."""
    return [
        ("lower", 2, 0, round(low[2], 2)),
        ("right", 0, 2, round(high[0], 2)),
        ("upper", 2, 0, round(high[2], 2)),
        ("left", 0, 2, round(low[0], 2)),
    ]


def errors(t: Array, results: dict[str, Result]) -> Figure:
    """Draw the size of each error over time."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for name, result in results.items():
        colour, dash = STYLES[name]
        label = f"{name}: {result.rms:.2f} mm RMS"
        size = 1e3 * np.linalg.norm(result.error, axis=1)
        axes.plot(t, size, color=colour, linestyle=dash, linewidth=1.3, label=label)
    axes.set(xlabel="time [s]", ylabel="error of the tool, offset out [mm]", ylim=(0, None))
    finish(axes)
    return figure


def finish(axes, legend: bool = True) -> None:
    """Grid, no frame, legend."""
    axes.grid(True, color="0.92")
    axes.spines[["top", "right"]].set_visible(False)
    if legend:
        axes.legend(frameon=False)


if __name__ == "__main__":
    main()
