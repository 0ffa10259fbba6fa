"""The momentum residual finds a torque that was put there, and none where none was."""

import numpy as np
import pytest
from scipy.signal import lfilter

from linkside import AccelerationObserver, Estimate, EstimatorError, Log, ReducedOrderObserver, Robot
from linkside.control.controllers import JointPD
from linkside.simulation import simulate
from linkside.velocity.residual import momentum_residual

from . import two_rods
from .robots import ARM, spring

PERIOD = 1e-3
PUSH = np.array([3.0, -2.0])


@pytest.fixture(scope="module")
def pushed():
    """Two seconds of motion; from 1.2 to 1.4 s something pushes."""
    robot, t = two_rods.robot(), PERIOD * np.arange(2001)
    tau = np.stack([np.cos(t / 2), -np.cos(t)], axis=1)
    x, rows = two_rods.START, []
    for time, torque in zip(t, tau, strict=True):
        rows.append(x)
        total = torque + PUSH * (1.2 <= time < 1.4)
        x = two_rods.rk4(
            lambda _, x, total=total: np.concatenate([x[2:], two_rods.forward(x[:2], x[2:], total)]), time, x, PERIOD
        )
    q = np.array(rows)[:, :2] + 2e-7 * np.random.default_rng(0).standard_normal((len(t), 2))
    columns = {"t": t, "theta_j1": q[:, 0], "theta_j2": q[:, 1], "tau_j1": tau[:, 0], "tau_j2": tau[:, 1]}
    log = Log.from_table(columns, robot)
    return robot, log, ReducedOrderObserver(robot, 200).run(log)


def test_finds_the_push(pushed):
    robot, log, estimate = pushed
    residual = momentum_residual(robot, log, estimate, quiet=(0.5, 1.1))
    np.testing.assert_allclose(residual.torque[1390], PUSH, atol=0.3)
    assert residual.collision[1250:1400].all()
    assert not residual.collision[500:1200].any()


@pytest.mark.parametrize(
    ("settings", "words"),
    [({"bandwidth": 0}, "bandwidth is 0"), ({"deviations": -1}, "deviations is -1"), ({"quiet": (8, 9)}, "quiet is")],
)
def test_refuses(pushed, settings, words):
    with pytest.raises(EstimatorError, match=words):
        momentum_residual(*pushed, **settings)


def test_refuses_an_estimate_of_other_rows(pushed):
    robot, log, estimate = pushed
    with pytest.raises(EstimatorError, match="rows"):
        momentum_residual(robot, log, estimate[:10])


@pytest.fixture(scope="module")
def leant_upon():
    """Two elastic joints, motors moving; from 1 to 1.5 s the links are pushed."""
    sensors = [{"name": f"on_{link}", "link": link, "xyz": [0, 0, 0.15]} for link in ("upper", "fore")]
    joints = [spring(name, motor_friction={"viscous": 3.0}) for name in ("shoulder", "elbow")]
    robot = Robot.from_urdf(ARM, joints, accelerometers=sensors, coupling={"shoulder": {"elbow": 0.05}})
    times = np.linspace(0, 2, 201)
    theta = np.array([0.3, 0.9]) + 0.2 * np.sin(4 * times)[:, None] * [1, -1]
    control = JointPD(kp=2000, kd=200, times=times, theta=list(theta), tau=np.zeros(2))
    push = PUSH * ((PERIOD * np.arange(2001) >= 1) & (PERIOD * np.arange(2001) < 1.5))[:, None]
    run = simulate(robot, control, 2.0, 1 / PERIOD, substeps=4, q=theta[0], push=push)
    return robot, run, push


def test_finds_a_push_behind_springs(leant_upon):
    robot, run, _ = leant_upon
    estimate = AccelerationObserver(robot, 300).run(run.log)
    residual = momentum_residual(robot, run.log, estimate, side="both")
    np.testing.assert_allclose(residual.torque[1490], PUSH, atol=0.1)
    assert np.abs(residual.torque[600:990]).max() < 0.1
    assert residual.collision[1050:1500].all()


def test_with_the_true_motion_it_is_the_push_through_a_filter(leant_upon):
    robot, run, push = leant_upon
    truth = {name: run.truth[name] for name in ("q", "dq", "theta", "dtheta")}
    status = np.zeros(len(run.log), np.uint8)
    estimate = Estimate(run.log.t, *truth.values(), status, robot.names)
    residual = momentum_residual(robot, run.log, estimate, side="both")
    keep = np.exp(-50 * PERIOD)
    between = np.vstack([np.zeros(2), 0.5 * (push[:-1] + push[1:])])
    np.testing.assert_allclose(residual.torque, lfilter([1 - keep], [1, -keep], between, axis=0), atol=2e-3)


def test_refuses_a_side_that_is_none(pushed):
    with pytest.raises(EstimatorError, match="side is 'left', expected one of 'motors', 'links', 'both'"):
        momentum_residual(*pushed, side="left")
