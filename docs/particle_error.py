"""Prints the error of the tool against the number of particles, and draws particle_error.svg.

The figure of the pages has fewer particles and seeds than the table, which takes ten minutes.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from drawing import save, style

from linkside import Estimate, ExtendedKalmanFilter, Log, MarginalizedParticleFilter, Noise, ParticleFilter, Robot
from linkside.figures import COLOURS, finish
from linkside.tuning import tune

FloatArray = npt.NDArray[np.float64]

HERE = Path(__file__).parent
RECORDINGS = ("arm2_square", "arm2_square_mismatch")
COUNTS = [100, 250, 500, 1000, 2000, 4000, 8000]
METHODS = {"plain": ParticleFilter, "marginalised": MarginalizedParticleFilter}
MEASURES = ("error", "from the Kalman filter", "q_std / its q_std")
TUNED = ("transmission", "acceleration")


def main() -> None:
    """Estimate both recordings with every number of particles and seed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--particles", type=int, nargs="+", default=COUNTS, help="two at least")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--kernel", type=float, default=1.0)
    compare(parser.parse_args())


@style()
def draw_all() -> None:
    """Draw the figure of the pages."""
    compare(argparse.Namespace(particles=[100, 250, 500, 1000], seeds=3, kernel=1.0), HERE / "particle_error.svg")


def compare(options: argparse.Namespace, path: Path | None = None) -> None:
    """Estimate both recordings, and draw the medians where a path is given."""
    figure, all_axes = plt.subplots(2, 2, figsize=(8, 6), sharex=True, layout="constrained")
    for name, axes in zip(RECORDINGS, all_axes.T, strict=True):
        draw(axes, name, options)
    if path is not None:
        save(figure, path)


def draw(axes: Any, name: str, options: argparse.Namespace) -> None:
    """One recording: errors above, below them how far from the Kalman filter."""
    folder = HERE.parent / "tests/data" / name
    robot = Robot.load(folder / "robot.yaml")
    log = Log.read(folder / "log.parquet", robot)
    truth = Estimate.read(folder / "truth.parquet").tool_position
    motors = apart(robot.tool_position(log.theta), truth)
    axes[0].axhline(motors, color="grey", linewidth=1, label="motor positions")
    print(f"{name}: motor positions {motors:.4f} mm, then medians over seeds (and the worst)")
    for tuned, noise, dash in noises(robot, log):
        kalman = ExtendedKalmanFilter(robot, noise).run(log)
        level = apart(kalman.tool_position, truth)
        axes[0].axhline(level, color="black", linestyle=dash, linewidth=1, label=f"Kalman filter{tuned}")
        print(f"  Kalman filter{tuned} {level:.4f}, {noise.transmission=}, {noise.acceleration=}")
        for index, method in enumerate(METHODS):
            found = compared(method, robot, noise, log, options, truth, kalman)
            for what, values in zip(MEASURES, found, strict=True):
                say(f"{method}, {what}", options.particles, values)
            for one, values in zip(axes, found, strict=False):
                (curve,) = one.loglog(
                    options.particles, np.median(values, axis=1), ".", color=COLOURS[index], linestyle=dash
                )
                curve.set_label(f"{method}{tuned}")
    label(axes, name, options.particles)


def noises(robot: Robot, log: Log) -> Iterator[tuple[str, Noise, str]]:
    """The defaults, and what tuning makes of them; with a style of line."""
    yield "", Noise(), "-"
    yield ", tuned", tune(robot, log, free=TUNED).after, "--"


def compared(
    method: str,
    robot: Robot,
    noise: Noise,
    log: Log,
    options: argparse.Namespace,
    truth: FloatArray | None,
    kalman: Estimate,
) -> FloatArray:
    """Each of `MEASURES`, by number of particles and by seed."""
    found = np.empty((len(MEASURES), len(options.particles), options.seeds))
    for i, count in enumerate(options.particles):
        for seed in range(options.seeds):
            estimator = METHODS[method](robot, noise, particles=count, seed=seed, kernel=options.kernel)
            estimate = estimator.run(log)
            tool = estimate.tool_position
            found[:, i, seed] = apart(tool, truth), apart(tool, kalman.tool_position), spread(estimate, kalman)
    return found


def spread(estimate: Estimate, kalman: Estimate) -> float:
    """Ratio of the standard deviations of link positions to those of the Kalman filter, median over time."""
    assert estimate.q_std is not None
    assert kalman.q_std is not None
    return float(np.median(estimate.q_std / kalman.q_std))


def apart(tool: FloatArray | None, other: FloatArray | None) -> float:
    """RMS distance of two paths (T, 3), their constant offset out [mm]."""
    assert tool is not None
    assert other is not None
    difference = tool - other
    return float(1e3 * np.sqrt(np.mean(np.sum((difference - difference.mean(axis=0)) ** 2, axis=1))))


def say(what: str, counts: list[int], found: FloatArray) -> None:
    """Medians over seeds, the worst in brackets, and the power of N with which the median goes in the upper half."""
    medians = np.median(found, axis=1)
    upper = slice(len(counts) // 2, None)
    power = np.polyfit(np.log(counts[upper]), np.log(medians[upper]), 1)[0]
    row = "  ".join(f"{n}: {m:.4f} ({f.max():.3f})" for n, m, f in zip(counts, medians, found, strict=True))
    print(f"  {what:36} {row}  N^{power:.2f}", flush=True)


def label(axes: Any, name: str, counts: list[int]) -> None:
    """Labels, and the slope of chance."""
    axes[0].set(title=name, ylabel="tool error [mm]")
    end = axes[1].lines[0].get_ydata()[-1]
    axes[1].loglog(counts, end * np.sqrt(counts[-1] / np.array(counts)), ":", color="grey", label="1/√N")
    axes[1].set(xlabel="particles", ylabel="from the Kalman filter [mm]")
    if name == RECORDINGS[-1]:
        axes[0].legend(fontsize=7)
        axes[1].legend(fontsize=7)
    for one in axes:
        finish(one, legend=False)


if __name__ == "__main__":
    main()
