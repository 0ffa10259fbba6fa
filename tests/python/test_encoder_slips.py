"""An encoder that slips or drifts against the measured velocity of its motor: flagged where it moves the estimate."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from linkside import (
    ExtendedKalmanFilter,
    Log,
    MarginalizedParticleFilter,
    RauchTungStriebelSmoother,
    Robot,
    UnscentedKalmanFilter,
)
from linkside.control.controllers import JointPD
from linkside.recording.estimate import Status
from linkside.simulation import Sensor, simulate

from .robots import ARM, spring

RATE, ROW = 500.0, 600


@pytest.fixture(scope="module")
def robot() -> Robot:
    return Robot.from_urdf(ARM, [spring("shoulder"), spring("elbow")], encoder={"resolution": 1e-5})


@pytest.fixture(scope="module")
def run(robot: Robot) -> Any:
    """Three seconds of motion; the motors' velocities have a zero, a scale and noise of their own."""
    rng = np.random.default_rng(3)
    times = np.arange(0.1, 3.0, 0.02)
    waves = [rng.uniform(0.05, 0.2, 2) * (1 - np.cos(rng.uniform(1, 7, 2) * (times - 0.1)[:, None])) for _ in range(3)]
    start = np.zeros(2)
    inertia = np.diag(robot.mass_matrix(start)) + [drive.motor_inertia for drive in robot.drives]
    held = robot.gravity_torque(start)
    theta = np.sum(waves, axis=0) + held / [drive.stiffness for drive in robot.drives]
    control = JointPD(kp=400 * inertia, kd=28 * inertia, times=times, theta=list(theta), tau=held)
    sensors = {"theta": Sensor(resolution=1e-5), "dtheta": Sensor(noise=1e-3)}
    run = simulate(robot, control, 3.0, RATE, substeps=4, q=start, seed=2, sensors=sensors)
    return replace(run, log=replace(run.log, dtheta=1.01 * run.log.dtheta + 0.004))


def spoiled(log: Log, fault: str, joint: int, size: float) -> Log:
    theta = log.theta.copy()
    theta[ROW:, joint] += size if fault == "slip" else size * (log.t[ROW:] - log.t[ROW])
    return replace(log, theta=theta)


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize(("fault", "size"), [("slip", 2e-3), ("slip", -5e-3), ("drift", 8e-3), ("drift", -3e-3)])
@pytest.mark.parametrize(
    "estimator",
    [ExtendedKalmanFilter, RauchTungStriebelSmoother, UnscentedKalmanFilter, MarginalizedParticleFilter],
)
def test_rows_that_a_slip_or_a_drift_spoils_are_not_good(
    robot: Robot, run: Any, estimator: Any, fault: str, size: float, joint: int
) -> None:
    """Without a sensor on the links nothing but the velocity tells it from a motion."""
    log = spoiled(run.log, fault, joint, size)
    estimate = estimator(robot).run(log)
    off = (np.abs(estimate.q - run.truth["q"]) > 3 * estimate.q_std).any(axis=1)
    assert off.mean() > 0.1
    assert (off & (estimate.status == Status.GOOD)).sum() < 0.15 * RATE  # until it is found
    (found,) = {finding.channel for finding in estimate.findings}
    assert found == log.columns("theta")[joint]
    blind = estimator(robot).run(replace(log, dtheta=None))
    assert (off & (blind.status == Status.GOOD)).mean() > 0.1 or fault == "slip"


def test_an_encoder_that_is_back_is_good_again(robot: Robot, run: Any) -> None:
    theta = run.log.theta.copy()
    theta[ROW : ROW + 200, 0] += 5e-3
    estimate = ExtendedKalmanFilter(robot).run(replace(run.log, theta=theta))
    assert (estimate.status[ROW + 50 : ROW + 190] & Status.FAULTY).all()
    assert (estimate.status[-100:] == Status.GOOD).all()


def derived(log: Log, corner: float) -> np.ndarray:
    """The derivative of the positions, by a filter of this corner frequency [Hz]; infinite: none."""
    slope = np.diff(log.theta, axis=0, prepend=log.theta[:1]) * RATE
    share = -np.expm1(-2 * np.pi * corner / RATE)
    for k in range(1, len(slope)):
        slope[k] = slope[k - 1] + share * (slope[k] - slope[k - 1])
    return slope


@pytest.mark.parametrize("velocity", ["clean", "derived", "filtered", "slow", "late", "coarse", "held", "none", "dead"])
def test_velocities_of_all_kinds_raise_no_flag_of_a_sound_encoder(robot: Robot, run: Any, velocity: str) -> None:
    log = run.log
    every = 5 * (np.arange(len(log)) // 5)
    known = {
        "clean": log.dtheta,
        "derived": derived(log, np.inf),
        "filtered": derived(log, 40.0),
        "slow": derived(log, 5.0),
        "late": np.vstack([log.dtheta[:1].repeat(4, axis=0), log.dtheta[:-4]]),
        "coarse": np.round(log.dtheta / 5e-3) * 5e-3,
        "held": log.dtheta[every],
        "none": np.full_like(log.dtheta, np.nan),
        "dead": np.zeros_like(log.dtheta),
    }
    estimate = ExtendedKalmanFilter(robot).run(replace(log, dtheta=known[velocity]))
    assert estimate.findings == ()
    assert (estimate.status == Status.GOOD).all()


@pytest.mark.parametrize("rows", [20, 100, 300])
def test_rows_that_are_missing_make_no_slip(robot: Robot, run: Any, rows: int) -> None:
    """Velocities at both ends of a gap do not tell how far the motor has turned in it."""
    there = np.ones(len(run.log), bool)
    there[ROW : ROW + rows] = False
    signals = {name: getattr(run.log, name)[there] for name in ("t", "theta", "dtheta", "tau")}
    estimate = ExtendedKalmanFilter(robot).run(replace(run.log, **signals))
    assert estimate.findings == ()


def test_a_derivative_of_the_drifting_position_itself_testifies_to_nothing(robot: Robot, run: Any) -> None:
    """It drifts with it: documented as not detected."""
    log = spoiled(run.log, "drift", 0, 8e-3)
    assert ExtendedKalmanFilter(robot).run(replace(log, dtheta=derived(log, np.inf))).findings == ()


def test_steps_judge_as_the_run_does(robot: Robot, run: Any) -> None:
    log = spoiled(run.log, "drift", 1, 8e-3)
    whole = ExtendedKalmanFilter(robot, start="rest").run(log)
    live = ExtendedKalmanFilter(robot, whole_noise(robot, log), start="rest")
    status = [live.step(dt=1 / RATE, theta=a, dtheta=b).status for a, b in zip(log.theta, log.dtheta, strict=True)]
    assert np.count_nonzero((np.array(status) & Status.FAULTY) != (whole.status & Status.FAULTY)) < 10


def whole_noise(robot: Robot, log: Log) -> Any:
    """The noise that a run reads off the recording."""
    return ExtendedKalmanFilter(robot).noise.for_log(log, robot)
