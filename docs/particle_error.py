"""Draws docs/particle_error.png and prints its table: the tool's error against the number of particles."""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt

from linkside import Estimate, ExtendedKalmanFilter, Log, MarginalizedParticleFilter, Noise, ParticleFilter, Robot
from linkside.tune import tune

FloatArray = npt.NDArray[np.float64]

HERE = Path(__file__).parent
RECORDINGS = ("arm2_square", "arm2_square_mismatch")
METHODS = {"plain": ParticleFilter, "marginalised": MarginalizedParticleFilter}
TUNED = ("transmission", "acceleration")


def main() -> None:
    """Estimate both recordings with every number of particles and seed, and draw the medians."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, nargs="+", default=[100, 250, 500, 1000, 2000])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--kernel", type=float, default=1.0)
    options = parser.parse_args()
    figure, all_axes = plt.subplots(2, 2, figsize=(7, 5.5), sharex=True, layout="constrained")
    for name, axes in zip(RECORDINGS, all_axes.T, strict=True):
        draw(axes, name, options)
    figure.savefig(HERE / "particle_error.png", dpi=80)


def draw(axes: Any, name: str, options: argparse.Namespace) -> None:
    """One recording: errors above, below them how far from the Kalman filter."""
    folder = HERE.parent / "tests/data" / name
    robot = Robot.load(folder / "robot.yaml")
    log = Log.read(folder / "log.parquet", robot)
    truth = Estimate.read(folder / "truth.parquet").tool_position
    motors = apart(robot.tool_position(log.theta), truth)
    axes[0].axhline(motors, color="grey", linewidth=1, label="motor positions")
    print(f"{name}: motor positions {motors:.4f} mm, then medians over seeds (and the worst)")
    for label, noise, style in noises(robot, log):
        kalman = ExtendedKalmanFilter(robot, noise).run(log).tool_position
        level = apart(kalman, truth)
        axes[0].axhline(level, color="black", linestyle=style, linewidth=1, label=f"Kalman filter{label}")
        print(f"  Kalman filter{label} {level:.4f}, {noise.transmission=}, {noise.acceleration=}")
        for color, method in enumerate(METHODS):
            tools = estimated(method, robot, noise, log, options)
            for one, what, other in zip(axes, ("error", "distance to it"), (truth, kalman), strict=True):
                found = np.array([[apart(tool, other) for tool in row] for row in tools])
                say(f"  {method}, {what}", options.particles, found)
                curve = one.loglog(options.particles, np.median(found, axis=1), f"C{color}.", linestyle=style)
                curve[0].set_label(f"{method}{label}")
    finish(axes, name, options.particles)


def noises(robot: Robot, log: Log) -> Iterator[tuple[str, Noise, str]]:
    """The defaults, and what tuning makes of them; with a style of line."""
    yield "", Noise(), "-"
    yield ", tuned", tune(robot, log, free=TUNED).after, "--"


def estimated(
    method: str, robot: Robot, noise: Noise, log: Log, options: argparse.Namespace
) -> list[list[FloatArray | None]]:
    """Where the tool was, by number of particles and seed."""
    return [
        [
            METHODS[method](robot, noise, particles=count, seed=seed, kernel=options.kernel).run(log).tool_position
            for seed in range(options.seeds)
        ]
        for count in options.particles
    ]


def apart(tool: FloatArray | None, other: FloatArray | None) -> float:
    """RMS distance of two paths (T, 3), their constant offset out [mm]."""
    assert tool is not None
    assert other is not None
    difference = tool - other
    return float(1e3 * np.sqrt(np.mean(np.sum((difference - difference.mean(axis=0)) ** 2, axis=1))))


def say(what: str, counts: list[int], found: FloatArray) -> None:
    """Medians over seeds, the worst in brackets, and the power of N with which the median falls."""
    medians = np.median(found, axis=1)
    power = np.polyfit(np.log(counts), np.log(medians), 1)[0]
    row = "  ".join(f"{n}: {m:.4f} ({f.max():.3f})" for n, m, f in zip(counts, medians, found, strict=True))
    print(f"  {what:30} {row}  N^{power:.2f}", flush=True)


def finish(axes: Any, name: str, counts: list[int]) -> None:
    """Labels, and the slope of chance."""
    axes[0].set(title=name, ylabel="tool error [mm]")
    start = axes[1].lines[0].get_ydata()[0]
    axes[1].loglog(counts, start * np.sqrt(counts[0] / np.array(counts)), ":", color="grey", label="1/√N")
    axes[1].set(xlabel="particles", ylabel="from the Kalman filter [mm]")
    axes[1].legend(fontsize=7)
    if name == RECORDINGS[0]:
        axes[0].legend(fontsize=7)
    for one in axes:
        one.grid(alpha=0.3)


if __name__ == "__main__":
    main()
