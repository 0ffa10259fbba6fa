"""An encoder that slips: the estimate follows it, and says so until the encoder is back."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    ElasticJointSmoother,
    ExtendedKalmanFilter,
    Log,
    RauchTungStriebelSmoother,
    Robot,
)
from linkside.control.controllers import JointPD
from linkside.recording.estimate import Status
from linkside.simulation import Sensor, simulate

from .robots import DATA, EXAMPLES

ARMS = {
    "ur10": (
        "ur_description/urdf/ur10_robot.urdf",
        "shoulder_pan shoulder_lift elbow wrist_1 wrist_2 wrist_3",
        "{}_joint",
    ),
    "panda": ("panda_description/urdf/panda.urdf", "1 2 3 4 5 6 7", "panda_joint{}"),
}
ESTIMATORS = [ExtendedKalmanFilter, RauchTungStriebelSmoother, ElasticJointFilter, ElasticJointSmoother]
BAD = Status.CONTRADICTED | Status.FAULTY
SLIP, THIRD = 2e-3, 2


def arm(name: str) -> tuple[Robot, np.ndarray]:
    """A public arm whose joints ring at 8 to 18 Hz, without sensors on its links, and a posture."""
    file, names, pattern = ARMS[name]
    names = [pattern.format(joint) for joint in names.split()]
    plain = Robot.from_urdf(EXAMPLES / file, [{"name": n, "stiffness": 1e4, "motor_inertia": 1.0} for n in names])
    q = np.linspace(-0.5, 0.6, plain.n)
    inertia = np.diag(plain.mass_matrix(q))
    stiffness = inertia * (2 * np.pi * np.linspace(8, 18, plain.n)) ** 2
    joints = [
        {"name": n, "stiffness": float(k), "damping": float(k * 5e-4), "motor_inertia": float(m)}
        for n, k, m in zip(names, stiffness, inertia, strict=True)
    ]
    settings: dict[str, Any] = {"encoder": {"resolution": 1e-5}, "torque": {"noise_std": 0.1}}
    return Robot.from_urdf(EXAMPLES / file, joints, **settings), q


@pytest.fixture(scope="module", params=[("ur10", 500.0), ("ur10", 250.0), ("panda", 250.0)])
def moved(request: Any) -> tuple[Robot, Log, np.ndarray]:
    """From rest to rest within 2 s by a polynomial of degree nine: robot, log and true link positions."""
    name, rate = request.param
    robot, q = arm(name)
    end = q + 0.6 * np.random.default_rng(0).uniform(-1, 1, robot.n)
    times = np.arange(0.0, 3.0, 0.01)
    u = np.clip((times - 0.5) / 2, 0, 1)[:, None]
    share = u**5 * (126 - 420 * u + 540 * u**2 - 315 * u**3 + 70 * u**4)
    torque, inertia = robot.gravity_torque(q), 2 * np.diag(robot.mass_matrix(q))
    theta = q + torque / [drive.stiffness for drive in robot.drives] + share * (end - q)
    control = JointPD(kp=400 * inertia, kd=28 * inertia, times=times, theta=list(theta), tau=torque)
    run = simulate(robot, control, 3.0, rate, substeps=8, q=q, seed=1, sensors={"dtheta": Sensor(noise=1e-3)})
    return robot, run.log, run.truth["q"]


def slipped(log: Log, row: int, back: int | None = None) -> Log:
    theta = log.theta.copy()
    theta[row:back, THIRD] += SLIP
    return replace(log, theta=theta)


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_row_that_a_slip_spoils_is_never_good(moved: Any, estimator: Any) -> None:
    robot, log, q = moved
    row = int(0.45 * len(log))
    estimate = estimator(robot).run(slipped(log, row))
    off = (np.abs(estimate.q - q) > 3 * estimate.q_std).any(axis=1)
    assert not (off & (estimate.status & BAD == 0)).any()
    assert estimate.findings[0].channel == log.columns("theta")[THIRD]
    assert estimate.findings[0].size == pytest.approx(SLIP, rel=0.05)
    if robot.n == 6:  # there it is off by more than three deviations to the end, long after innovations are calm
        assert off[row + 320 :].mean() > 0.5


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_a_motion_without_a_slip_is_good(moved: Any, estimator: Any) -> None:
    robot, log, q = moved
    estimate = estimator(robot).run(log)
    assert (estimate.status == Status.GOOD).all()
    assert estimate.findings == ()
    assert (np.abs(estimate.q - q) < 3 * estimate.q_std).all()


@pytest.mark.parametrize("estimator", [ElasticJointFilter, ElasticJointSmoother])
def test_rows_are_good_again_after_the_encoder_returned(moved: Any, estimator: Any) -> None:
    robot, log, q = moved
    row, back = int(0.35 * len(log)), int(0.45 * len(log))
    estimate = estimator(robot).run(slipped(log, row, back))
    off = (np.abs(estimate.q - q) > 3 * estimate.q_std).any(axis=1)
    assert not (off & (estimate.status & BAD == 0)).any()
    assert (estimate.status[back + 330 :] == Status.GOOD).all()
    assert len(estimate.findings) == 1


def test_pieces_flag_the_same_rows(moved: Any) -> None:
    robot, log, _ = moved
    bad = slipped(log, int(0.45 * len(log)))
    whole = ElasticJointFilter(robot).run(bad)
    pieces = list(ElasticJointFilter(robot).run_pieces([bad[:300], bad[300:600], bad[600:]]))
    np.testing.assert_array_equal(np.concatenate([piece.status for piece in pieces]), whole.status)
    assert pieces[-1].findings == whole.findings


@pytest.mark.parametrize("size", [SLIP, -5e-4])
@pytest.mark.parametrize("joint", [0, 4])
def test_the_observer_says_so_until_the_encoder_is_back(size: float, joint: int) -> None:
    """It follows the encoder within milliseconds, with small innovations, and its link is off as long as that is."""
    robot = Robot.load(DATA / "kr15_six_axes/robot.yaml")
    log = Log.read(DATA / "kr15_six_axes/log.parquet", robot)
    theta, row, back = log.theta.copy(), len(log) // 2, 3 * len(log) // 4
    theta[row:back, joint] += size
    clean, estimate = (AccelerationObserver(robot).run(x) for x in (log, replace(log, theta=theta)))
    assert not (clean.status & Status.CONTRADICTED).any()
    contradicted = estimate.status & Status.CONTRADICTED > 0
    off = np.abs(estimate.q - clean.q).max(axis=1)
    assert off[back - 1] > 0.9 * abs(size)
    assert contradicted[off > 0.5 * abs(size)].all()
    assert not contradicted[:row].any()
    assert not contradicted[back + 200 :].any()
