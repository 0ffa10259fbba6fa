"""Unscented and cubature filters: against filterpy, SciPy's integration of the points, and the linear filter."""

import dataclasses

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints
from filterpy.kalman import UnscentedKalmanFilter as Peer
from scipy.integrate import solve_ivp

from linkside import (
    CubatureKalmanFilter,
    ElasticJointFilter,
    ElasticNoise,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    Log,
    RauchTungStriebelSmoother,
    Robot,
    Status,
    UnscentedKalmanFilter,
)

from . import test_elastic_filter as elastic
from . import test_iterated as swinging
from . import test_kalman_filter as linear
from .drawn import jerk_noise

BOTH = pytest.mark.parametrize(
    ("method", "beta"), [(UnscentedKalmanFilter, 2.0), (CubatureKalmanFilter, 0.0)], ids=["unscented", "cubature"]
)


def readings(seed=3, size=1.0):
    """Readings of the pendulum, none missing, from states that are spread ``size`` times as far as a filter expects."""
    rng = np.random.default_rng(seed)
    x = swinging.states(size * rng.standard_normal((swinging.ROWS, 3)))
    return swinging.read(x) + rng.standard_normal((swinging.ROWS, 3)) * swinging.STD


@BOTH
def test_on_a_pendulum_it_is_filterpys(method, beta):
    h = swinging.STEP
    f = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    points = MerweScaledSigmaPoints(3, alpha=1.0, beta=beta, kappa=0.0)
    peer = Peer(3, 3, h, hx=swinging.read, fx=lambda x, _: f @ x, points=points)
    peer.x, peer.P = (np.array(part) for part in swinging.START)
    peer.Q, peer.R = swinging.NOISE.jerk**2 * jerk_noise(h), np.diag(swinging.STD**2)
    peer.sigmas_f = points.sigma_points(peer.x, peer.P)
    mean, covariance, columns = [], [], readings(size=3.0)
    for i, reading in enumerate(columns):
        if i:
            peer.predict()
        peer.update(reading)
        mean.append(peer.x)
        covariance.append(peer.P)
    robot = swinging.pendulum()
    ours = method(robot, swinging.NOISE, start=swinging.START, **swinging.SETTINGS).run(
        swinging.log_of(robot, columns), covariance=True
    )
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.abs((ours.state - mean) / std).max() < 1e-6
    assert np.abs((ours.covariance - covariance) / (std[:, :, None] * std[:, None, :])).max() < 1e-6
    plain = ExtendedKalmanFilter(robot, swinging.NOISE, start=swinging.START, **swinging.SETTINGS)
    apart = plain.run(swinging.log_of(robot, columns)).q - ours.q
    assert np.abs(apart / ours.q_std).max() > 1e-3  # there is something to agree on


@BOTH
def test_on_a_linear_robot_it_is_the_textbooks_filter(method, beta):
    robot = linear.slide()
    columns, _ = linear.drawn(linear.NOISE, np.random.default_rng(1))
    columns["acc_z"][np.arange(400) % 4 != 0] = np.nan
    columns["theta_x"][100:140] = np.nan
    book = linear.textbook(linear.NOISE, columns, linear.rest(robot, columns))
    log = Log.from_table(columns, robot)
    ours = method(robot, linear.NOISE, start="rest", tolerances=False).run(log, covariance=True)
    np.testing.assert_allclose(ours.state, book["x"], rtol=0, atol=1e-12)
    linear.close(ours.covariance, book["p"], book["p"], 1e-9)
    lagged = FixedLagSmoother(
        robot, linear.NOISE, lag=399, start="rest", tolerances=False, linearisation=ours_name(method)
    )
    for i in range(len(log)):
        last = lagged.step(dt=1e-3, theta=log.theta[i], acceleration=log.acceleration[i], dtheta=log.dtheta[i])
    np.testing.assert_allclose(last.state, book["xs"][0], rtol=0, atol=1e-9)


def ours_name(method):
    return "unscented" if method is UnscentedKalmanFilter else "cubature"


@pytest.mark.parametrize("linearisation", ["unscented", "cubature"])
def test_on_a_linear_elastic_joint_it_is_the_plain_filter(linearisation):
    robot, columns = elastic.slide(), elastic.wandering(np.random.default_rng(1))
    log, settings = Log.from_table(columns, robot), {"start": "rest", "tolerances": False}
    ours = ElasticJointFilter(robot, elastic.NOISE, linearisation=linearisation, **settings).run(log, covariance=True)
    plain = ElasticJointFilter(robot, elastic.NOISE, **settings).run(log, covariance=True)
    std = np.sqrt(np.diagonal(plain.covariance, axis1=1, axis2=2))
    # Points go by the rule of Runge and Kutta, derivatives by the exponential.
    assert np.abs((ours.state - plain.state) / std).max() < 1e-4
    assert np.abs((ours.covariance - plain.covariance) / (std[:, :, None] * std[:, None, :])).max() < 1e-4


@pytest.mark.parametrize(("linearisation", "centre"), [("unscented", 2.0), ("cubature", 0.0)])
def test_a_step_without_readings_is_the_points_through_scipys_integration(linearisation, centre):
    """A cart on a hardening spring, known so badly that its curvature counts."""
    hard, h = 5e9, 1e-3
    robot = Robot.from_urdf(
        elastic.SLIDE, joints=[elastic.DRIVE | {"cubic_stiffness": hard}], encoder={"resolution": 1e-6}
    )
    noise = ElasticNoise(
        link_acceleration=0.0, motor_acceleration=0.0, torque=1e-9, disturbance=1e-9, disturbance_walk=0.0
    )
    start = np.array([0.0, 0.1, 2e-3, -0.2, 0.0]), np.diag([2e-3, 0.2, 2e-3, 0.3, 1e-6]) ** 2
    columns = {"t": [0.0, h], "theta_x": [0.0, np.nan], "tau_x": [250.0, 250.0]}
    log = Log.from_table({name: np.array(values) for name, values in columns.items()}, robot, check=False)
    settings = {"start": start, "tolerances": False, "accelerations": False, "dtheta": False}
    found = ElasticJointFilter(robot, noise, linearisation=linearisation, **settings).run(log, covariance=True)
    m, b, k, d, drag = elastic.M, elastic.B, elastic.K, elastic.D, elastic.F

    def slope(_, x):
        q, dq, theta, dtheta, disturbance = x
        spring = k * (theta - q) + hard * (theta - q) ** 3 + d * (dtheta - dq)
        return [dq, spring / m - elastic.GRAVITY, dtheta, (250.0 + disturbance - drag * dtheta - spring) / b, 0.0]

    def after(x):
        return solve_ivp(slope, (0, h), x, rtol=1e-11, atol=1e-13).y[:, -1]

    mean, root = found.state[0], np.linalg.cholesky(found.covariance[0]).T
    reach = np.sqrt(5)
    ends = np.array([after(mean + sign * reach * u) for u in root for sign in (1, -1)])
    expected = ends.mean(axis=0)
    spread = (ends - expected).T @ (ends - expected) / 10
    off = after(mean) - expected
    spread += centre * np.outer(off, off)
    std = np.sqrt(np.diag(spread))
    assert np.abs((found.state[1] - expected) / std).max() < 1e-4
    assert np.abs((found.covariance[1] - spread) / np.outer(std, std)).max() < 2e-3
    plain = ElasticJointFilter(robot, noise, **settings).run(log, covariance=True)
    assert np.abs((plain.state[1] - expected) / std).max() > 3e-3  # there is something to agree on


def test_it_judges_itself_and_gates_as_the_plain_filter_does():
    robot, log = linear.recording("arm2_square")
    acceleration = log.acceleration.copy()
    acceleration[500, 0] += 100.0
    struck = dataclasses.replace(log, acceleration=acceleration.copy())[:600]
    found = UnscentedKalmanFilter(robot, linear.Noise(jerk=15.0), gate=8.0).run(struck)
    assert np.flatnonzero(found.status & Status.GATED).tolist() == [500]
    acceleration[900:, 0] += 5.0
    found = UnscentedKalmanFilter(robot, linear.Noise(jerk=15.0)).run(
        dataclasses.replace(log, acceleration=acceleration)[600:1200]
    )
    assert not (found.status[:300] & Status.CONTRADICTED).any()
    assert (found.status[300:] & Status.CONTRADICTED).any()
    assert "tool_acc_x" in [finding.channel for finding in found.findings]


def test_where_a_channel_curves_its_errors_are_as_large_as_it_says():
    """The first sample of the pendulum: an accelerometer reads the square of a velocity that nobody knows."""
    robot, squares = swinging.pendulum(), {UnscentedKalmanFilter: [], ExtendedKalmanFilter: []}
    for seed in range(60):
        rng = np.random.default_rng(seed)
        x = swinging.states(rng.standard_normal((swinging.ROWS, 3)))
        noisy = swinging.read(x) + rng.standard_normal((swinging.ROWS, 3)) * swinging.STD
        for method, found in squares.items():
            estimate = method(robot, swinging.NOISE, start=swinging.START, **swinging.SETTINGS).run(
                swinging.log_of(robot, noisy[:2]), covariance=True
            )
            error = estimate.state[0] - x[0]
            found.append(error @ np.linalg.solve(estimate.covariance[0], error))
    assert np.mean(squares[UnscentedKalmanFilter]) < 6
    assert np.mean(squares[ExtendedKalmanFilter]) > 20


@pytest.mark.parametrize("bad", ["derivative", "", 3, None])
def test_a_linearisation_that_is_none_is_refused(bad):
    with pytest.raises(EstimatorError, match="linearisation"):
        ExtendedKalmanFilter(linear.slide(), linearisation=bad)


def test_a_smoother_of_whole_recordings_refuses_points():
    with pytest.raises(EstimatorError, match="FixedLagSmoother"):
        RauchTungStriebelSmoother(linear.slide(), linearisation="unscented")
