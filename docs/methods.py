"""The tables of docs/methods.md: all methods on all recordings. Some minutes; names of methods: only theirs."""

from __future__ import annotations

import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from linkside import (
    AccelerationObserver,
    CubatureKalmanFilter,
    CubatureSmoother,
    ElasticJointFilter,
    ElasticJointIteratedSmoother,
    ElasticJointSmoother,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    IteratedSmoother,
    Log,
    MarginalizedParticleFilter,
    Noise,
    ParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    Sensor,
    Status,
    UnscentedKalmanFilter,
    UnscentedSmoother,
    demo,
    simulate,
)
from linkside.kalman import FixedLagSmoother

DATA = Path(__file__).parents[1] / "tests/data"
FOLDERS = {
    "kr15_short": demo.FOLDER,
    "kr15_six_axes": DATA / "kr15_six_axes",
    "arm2_square": DATA / "arm2_square",
    "arm2_square_mismatch": DATA / "arm2_square_mismatch",
}
SIMULATED: dict[str, tuple[dict[str, Any], float]] = {
    "play": ({"backlash": {"half_gap": 3e-4}}, 6.8e-7),
    "friction in the spring": ({"hysteresis": [{"stiffness": 2e5, "limit": 150.0}]}, 6.8e-7),
    "coarse encoder": ({}, 1e-3),
}
"""Keys of both joints of arm2_square, and steps of the motors' encoders [rad]."""

METHODS: dict[str, Callable[[Robot, dict[str, Any]], Any]] = {
    "ekf": lambda robot, _: ExtendedKalmanFilter(robot),
    "observer": lambda robot, _: AccelerationObserver(robot),
    "ukf": lambda robot, _: UnscentedKalmanFilter(robot),
    "ckf": lambda robot, _: CubatureKalmanFilter(robot),
    "smoother": lambda robot, _: RauchTungStriebelSmoother(robot),
    "ukf-smoother": lambda robot, _: UnscentedSmoother(robot),
    "ckf-smoother": lambda robot, _: CubatureSmoother(robot),
    "map": lambda robot, _: IteratedSmoother(robot),
    "elastic-ekf": lambda robot, held: ElasticJointFilter(robot, **held),
    "elastic-ukf": lambda robot, held: ElasticJointFilter(robot, linearisation="unscented", **held),
    "elastic-smoother": lambda robot, held: ElasticJointSmoother(robot, **held),
    "elastic-ukf-smoother": lambda robot, held: ElasticJointSmoother(robot, linearisation="unscented", **held),
    "elastic-map": lambda robot, held: ElasticJointIteratedSmoother(robot, **held),
    "particle": lambda robot, _: ParticleFilter(robot, particles=500),
    "marginalized": lambda robot, _: MarginalizedParticleFilter(robot, particles=500),
}
LAGS = (1, 2, 5, 10, 20, 50, 100)
FIRST = 200
"""Rows that are not counted: estimates settle."""


def recorded() -> Iterator[tuple[str, Robot, Log, Estimate, dict[str, Any]]]:
    """Recordings with their truth, and how their torques act between samples."""
    for name, folder in FOLDERS.items():
        robot = Robot.load(folder / "robot.yaml")
        yield name, robot, Log.read(folder / "log.parquet", robot), Estimate.read(folder / "truth.parquet"), {}
    for name, (keys, step) in SIMULATED.items():
        robot = changed(keys, step)
        log, truth = moved(robot, step)
        yield name, robot, log, truth, {"motor_torque": "held"}


def changed(keys: dict[str, Any], step: float) -> Robot:
    """The arm of two joints with other drives."""
    settings = Robot.load(FOLDERS["arm2_square"] / "robot.yaml").config.model_dump(
        exclude={"urdf"}, exclude_defaults=True
    )
    for joint in settings["joints"]:
        joint.update(keys)
    settings["encoder"] = {"resolution": step}
    return Robot.from_urdf(FOLDERS["arm2_square"] / "robot.urdf", **settings)


def moved(robot: Robot, step: float) -> tuple[Log, Estimate]:
    """Two seconds to and fro, through zero load where there is one."""
    home, size, rate = np.array([0.6, -1.2]), np.array([0.15, 0.25]), 2 * np.pi * np.array([1.1, 1.7])
    inertia = np.diag(robot.mass_matrix(home)) + [drive.motor_inertia for drive in robot.drives]

    def control(t: float, state: Any) -> Any:
        goal, speed = home + size * np.sin(rate * t) * (1 - np.exp(-8 * t)), size * rate * np.cos(rate * t)
        speed = speed * (1 - np.exp(-8 * t)) + size * np.sin(rate * t) * 8 * np.exp(-8 * t)
        return robot.gravity_torque(state.theta) + inertia * (900 * (goal - state.theta) + 60 * (speed - state.dtheta))

    sensors = {"theta": Sensor(resolution=step), "acceleration": Sensor(noise=0.05)}
    run = simulate(robot, control, 2.0, 2000.0, q=home, sensors=sensors, substeps=4, seed=1)
    return run.log, truth_of(robot, run)


def truth_of(robot: Robot, run: Any) -> Estimate:
    """The truth of a simulation as an estimate."""
    q = run.truth["q"]
    return Estimate(
        t=run.log.t,
        names=robot.names,
        q=q,
        dq=run.truth["dq"],
        theta=run.truth["theta"],
        dtheta=run.truth["dtheta"],
        tool_position=robot.tool_position(q),
        status=np.zeros(len(q), np.uint8),
    )


def judged(estimate: Estimate, truth: Estimate) -> tuple[float, float, float]:
    """Error of the tool [mm], median of |error| / q_std, and percent of good rows that are off by three of these."""
    rows = slice(FIRST, None)
    at = np.searchsorted(truth.t, estimate.t - 1e-9)
    error = (estimate.q - truth.q[at])[rows]
    tool = (estimate.tool_position - truth.tool_position[at])[rows]
    tool_error = 1e3 * float(np.sqrt(np.mean(np.sum((tool - tool.mean(axis=0)) ** 2, axis=1))))
    if estimate.q_std is None:
        return tool_error, np.nan, np.nan
    ratio = np.abs(error) / estimate.q_std[rows]
    good = estimate.status[rows] & (Status.CONTRADICTED | Status.FAULTY) == 0
    return tool_error, float(np.median(ratio)), 100 * float(np.mean((ratio > 3).any(axis=1) & good))


def timed(estimator: Any, log: Log) -> tuple[Estimate, float]:
    """An estimate, and the least processor time that it took [s]."""
    least = np.inf
    for _ in range(3):
        begin = time.process_time()
        estimate = estimator.run(log)
        least = min(least, time.process_time() - begin)
        if least > 2.0:
            break
    return estimate, least


def print_methods(chosen: list[str]) -> None:
    """Print a row for each method and recording; time is in multiples of the first method's."""
    names, found, seconds = [], {name: [] for name in chosen}, {name: [] for name in chosen}
    for name, robot, log, truth, held in recorded():
        names.append(name)
        for method in chosen:
            try:
                estimate, took = timed(METHODS[method](robot, held), log)
                tool, ratio, off = judged(estimate, truth)
            except EstimatorError:
                found[method].append("refused")
                continue
            if method == chosen[0]:
                plain = took
            seconds[method].append(took / plain)
            words = f"{tool:.4f}" if np.isnan(ratio) else f"{tool:.4f}, {ratio:.2f}, {off:.1f} %"
            found[method].append(words)
    print("| | " + " | ".join(names) + " | time |")
    for method, cells in found.items():
        print(f"| `{method}` | " + " | ".join(cells) + f" | {np.median(seconds[method]):.1f} |", flush=True)


def print_lags() -> None:
    """Print the error over the lag."""
    print("| | " + " | ".join(f"{lag}" for lag in LAGS) + " |")
    for name in ("kr15_six_axes", "arm2_square"):
        robot = Robot.load(FOLDERS[name] / "robot.yaml")
        log, truth = Log.read(FOLDERS[name] / "log.parquet", robot), Estimate.read(FOLDERS[name] / "truth.parquet")
        noise = Noise().for_log(log, robot)
        cells = [_lagged(robot, noise, log, truth, lag) for lag in LAGS]
        print(f"| {name} | " + " | ".join(f"{cell:.4f}" for cell in cells) + " |", flush=True)


def _lagged(robot: Robot, noise: Noise, log: Log, truth: Estimate, lag: int) -> float:
    """Error of the tool [mm]."""
    smoother, rows = FixedLagSmoother(robot, noise, lag=lag, tolerances=False), []
    for i in range(len(log)):
        signals = {name: getattr(log, name) for name in ("theta", "acceleration", "dtheta", "ddqref")}
        there = {name: values[i] for name, values in signals.items() if values is not None}
        state = smoother.step(dt=log.t[i] - log.t[i - 1] if i else log.period, **there)
        if state is not None:
            rows.append((state.q, state.q_std, state.tool_position, state.status))
    q, q_std, tool, status = (np.array(values) for values in zip(*rows, strict=True))
    bare = dataclasses.replace(
        truth[: len(q)], t=log.t[: len(q)], q=q, q_std=q_std, tool_position=tool, status=status.astype(np.uint8)
    )
    return judged(bare, truth)[0]


if __name__ == "__main__":
    if sys.argv[1:]:
        print_methods(sys.argv[1:])
    else:
        print_methods(list(METHODS))
        print_lags()
