"""Kalman filter and smoother, mean and covariance kept, against other Kalman filters on the same model."""

from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from timing import Result, microseconds
from two_link import Array, Problem

from linkside import (
    ExtendedKalmanFilter,
    FixedLagSmoother,
    Log,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
    UnscentedKalmanFilter,
)

DATA = Path(__file__).parents[2] / "tests/data"
AGREE = 1e-9  # rad
# A reading's noise is a constant, and biases are random walks, as the peers have it.
NOISE = Noise(torsion=0.0, motor_bias_time=np.inf, acceleration_bias_time=np.inf)

PEERS = {"numba": "numba_ekf", "filterpy": "filterpy_ekf", "dynamax": "dynamax_ekf"}
"""What has to be installed, and the file that uses it; each has `run(problem)`, which gives the means (T, 10)."""


def bench() -> Iterator[Result]:
    """Two joints, one sensor of two axes: 10 states, 4 readings. Six joints, three sensors: 33 states, 15 readings."""
    two, six = load("arm2_square", axes="xz"), load("kr15_six_axes")
    yield from against_peers("EKF, 2 joints, 10 states", *two)
    yield smoother("smoother, 2 joints, 10 states", *two)
    yield step("EKF step from Python, 2 joints", *two, most=1.5)
    yield lagged("fixed lag of 20, step from Python, 2 joints", *two)
    yield unscented("UKF, 2 joints, 10 states", *two)
    yield Result("EKF, 6 joints, 33 states", timed(ExtendedKalmanFilter, *six), most=6.0)
    yield smoother("smoother, 6 joints, 33 states", *six)
    yield step("EKF step from Python, 6 joints", *six)
    yield lagged("fixed lag of 20, step from Python, 6 joints", *six, least_ratio=0.2)
    yield unscented("UKF, 6 joints, 33 states", *six)


PLAIN: dict[str, Any] = {"start": "rest", "tolerances": False}
"""What peers have as well: no tolerances, and a start at rest."""


def load(name: str, axes: str = "xyz") -> tuple[Robot, Log, Noise]:
    """A robot, its recording, and the noise with the jerk that was read off it."""
    settings = Robot.load(DATA / name / "robot.yaml").config.model_dump(exclude={"urdf"})
    for sensor in settings["accelerometers"]:
        sensor["axes"] = axes
    robot = Robot.from_urdf(DATA / name / "robot.urdf", **settings)
    log = Log.read(DATA / name / "log.parquet", robot)
    return robot, log, NOISE.for_log(log, robot)


def against_peers(what: str, robot: Robot, log: Log, noise: Noise) -> Iterator[Result]:
    """Recordings; each peer that is installed is first made sure to compute the same."""
    ours = timed(ExtendedKalmanFilter, robot, log, noise)
    expected = ExtendedKalmanFilter(robot, noise, **PLAIN).run(log).q
    problem = Problem.of(robot, log, noise)
    for name, file in PEERS.items():
        most = 0.35 if name == "numba" else None
        try:
            run: Callable[[Problem], tuple[Array, Array]] = import_module(file).run
        except ImportError as error:
            yield Result(what, ours, f"{name}: {error.name} is not installed", most=most)
            continue
        apart = np.abs(run(problem)[0][:, :2] - expected).max()
        if not apart <= AGREE:
            raise SystemExit(f"{what}: linkside and {name} are {apart:.1e} rad apart, this compares nothing")
        loop = microseconds(lambda run=run: run(problem), len(log))
        yield Result(what, ours, name, loop, most=most)


def timed(method: type[ExtendedKalmanFilter], robot: Robot, log: Log, noise: Noise) -> float:
    """A recording, mean and covariance of the state kept."""
    estimator = method(robot, noise, **PLAIN)
    return microseconds(lambda: estimator.run(log, covariance=True), len(log), repeats=25)


def smoother(what: str, robot: Robot, log: Log, noise: Noise) -> Result:
    """Beside the filter."""
    ours, filtered = (timed(m, robot, log, noise) for m in (RauchTungStriebelSmoother, ExtendedKalmanFilter))
    return Result(what, ours, "linkside's filter", filtered, least_ratio=0.4)


def step(what: str, robot: Robot, log: Log, noise: Noise, most: float | None = None) -> Result:
    """One sample after the other, as a control loop would."""
    return Result(what, stepped(ExtendedKalmanFilter(robot, noise, **PLAIN), log), most=most)


def lagged(what: str, robot: Robot, log: Log, noise: Noise, least_ratio: float = 0.25) -> Result:
    """Beside the filter's step: at most four of these, or as many as said."""
    ours, plain = (
        stepped(estimator, log)
        for estimator in (
            FixedLagSmoother(robot, noise, lag=20, **PLAIN),
            ExtendedKalmanFilter(robot, noise, **PLAIN),
        )
    )
    return Result(what, ours, "a step of the EKF", plain, least_ratio=least_ratio)


def unscented(what: str, robot: Robot, log: Log, noise: Noise) -> Result:
    """Beside the filter by derivatives: at most five times as long."""
    ours, plain = (timed(m, robot, log, noise) for m in (UnscentedKalmanFilter, ExtendedKalmanFilter))
    return Result(what, ours, "linkside's EKF", plain, least_ratio=0.2)


def stepped(estimator: ExtendedKalmanFilter | FixedLagSmoother, log: Log) -> float:
    """One sample after the other, as a control loop would."""
    samples = list(zip(log.theta, log.acceleration, log.dtheta, log.ddqref, strict=True))

    def loop() -> None:
        for theta, acceleration, dtheta, ddqref in samples:
            estimator.step(dt=log.period, theta=theta, acceleration=acceleration, dtheta=dtheta, ddqref=ddqref)

    return microseconds(loop, len(samples))
