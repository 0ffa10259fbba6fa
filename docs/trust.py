"""Prints how honest estimates are on recordings whose truth is known; draws trust.svg.

With folders that hold robot.yaml, log.parquet and truth.parquet, the table is of these; else of those in tests/data.
"""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import numpy.typing as npt
from drawing import save, style

from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.figures import COLOURS, finish
from linkside.recording.estimate import Status

HERE = Path(__file__).parent
DATA = HERE.parent / "tests/data"
THIN = 15  # rows of the recording for one of the figure
METHODS = {
    "ekf": ExtendedKalmanFilter,
    "smoother": RauchTungStriebelSmoother,
    "elastic": ElasticJointFilter,
    "observer": AccelerationObserver,
}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "folders", type=Path, nargs="*", default=sorted(log.parent for log in DATA.glob("*/log.parquet"))
    )
    parser.add_argument("--rows", type=int, default=3000)
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), default=list(METHODS))
    options = parser.parse_args()
    print(f"{'recording':24} {'method':10} {'rows off':>9} {'and good':>9}  error / q_std: median, largest")
    for folder in options.folders:
        for method in options.methods:
            say(folder, method, options.rows)


def say(folder: Path, method: str, rows: int) -> None:
    """One line: how often some joint is off by more than three standard deviations."""
    robot, log, truth = read(folder, rows)
    try:
        estimate = METHODS[method](robot).run(log)
    except EstimatorError as error:  # an observer without accelerometers
        print(f"{folder.name:24} {method:10} {error}", flush=True)
        return
    ratio = errors(estimate, truth)
    off = (ratio > 3).any(axis=1)
    silent = off & (estimate.status == Status.GOOD)
    shares = f"{100 * off.mean():7.2f} % {100 * silent.mean():7.2f} %"
    print(f"{folder.name:24} {method:10} {shares}  {np.nanmedian(ratio):.2f}, {np.nanmax(ratio):.1f}", flush=True)


def read(folder: Path, rows: int) -> tuple[Robot, Log, Estimate]:
    """A recording's first rows and its truth."""
    settings = folder / "robot.yaml"
    robot = Robot.load(settings if settings.exists() else folder.parent / "robot.yaml")
    return robot, Log.read(folder / "log.parquet", robot)[:rows], Estimate.read(folder / "truth.parquet")


def errors(estimate: Estimate, truth: Estimate) -> npt.NDArray[np.float64]:
    """Errors of the joints whose truth is known, in standard deviations."""
    rows = np.clip(np.searchsorted(truth.t, estimate.t - 1e-6), 0, len(truth) - 1)
    joints = [estimate.names.index(name) for name in truth.names]
    assert estimate.q_std is not None
    ratio: npt.NDArray[np.float64] = np.abs(estimate.q[:, joints] - truth.q[rows]) / estimate.q_std[:, joints]
    return ratio[:, ~np.isnan(ratio).all(axis=0)]


@style()
def draw_all() -> None:
    """A wrong model with and without tolerances; and a sensor whose sign turns."""
    figure, (above, below) = plt.subplots(2, 1, figsize=(8, 6), layout="constrained")
    model(above)
    fault(below)
    for axes in (above, below):
        finish(axes, legend=False)
    save(figure, HERE / "trust.svg")


def model(axes: Any) -> None:
    """Error of a joint whose spring and load are not those of robot.yaml, inside what is said of it."""
    robot, log, truth = read(DATA / "arm2_square_mismatch", 3000)
    for tolerances, color, label in ((True, COLOURS[0], "with tolerances"), (False, COLOURS[1], "noise alone")):
        estimate = ExtendedKalmanFilter(robot, tolerances=tolerances).run(log)
        assert estimate.q_std is not None
        width = 3e6 * estimate.q_std[:, 0]
        axes.fill_between(
            log.t[::THIN],
            -width[::THIN],
            width[::THIN],
            color=color,
            alpha=0.3 if tolerances else 0.9,
            label=f"3 σ, {label}",
        )
    error = 1e6 * (estimate.q - truth.q[: len(log)])[:, 0]
    axes.plot(log.t[::THIN], error[::THIN], "k", linewidth=1, label="error")
    axes.set(title="A spring 8 % softer than robot.yaml says, a payload that it lacks", ylabel="axis 2 [µrad]")
    axes.legend(loc="upper right", fontsize=8)


def fault(axes: Any) -> None:
    """Normalised innovation squared of a recording in which one axis of the accelerometer turns its sign."""
    robot, log, _ = read(DATA / "arm2_square", 1400)
    assert log.acceleration is not None
    acceleration = log.acceleration.copy()
    acceleration[900:, 0] *= -1
    estimate = ExtendedKalmanFilter(robot).run(replace(log, acceleration=acceleration))
    flagged = (estimate.status & Status.FAULTY) > 0
    axes.semilogy(log.t[::2], estimate.nis[::2], color=COLOURS[0], linewidth=1, label="NIS of every other row")
    edges = np.flatnonzero(np.diff(flagged, prepend=False, append=False))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        label = "status: faulty" if first == edges[0] else None
        axes.axvspan(log.t[first], log.t[end - 1], color=COLOURS[1], alpha=0.2, linewidth=0, label=label)
    finding = estimate.findings[0]
    axes.set(
        title=f"'{finding.channel}' looks {finding.kind} from row {finding.since} on", xlabel="t [s]", ylabel="NIS"
    )
    axes.legend(loc="upper left", fontsize=8)


if __name__ == "__main__":
    main()
