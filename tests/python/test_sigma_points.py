"""Unscented and cubature filters and smoothers: against filterpy, points in NumPy and SciPy, and the linear ones."""

import dataclasses

import numpy as np
import pytest
from filterpy.kalman import MerweScaledSigmaPoints
from filterpy.kalman import UnscentedKalmanFilter as Peer
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from linkside import (
    CubatureKalmanFilter,
    CubatureSmoother,
    ElasticJointFilter,
    ElasticJointIteratedSmoother,
    ElasticJointSmoother,
    ElasticNoise,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    IteratedSmoother,
    Log,
    Robot,
    Status,
    UnscentedKalmanFilter,
    UnscentedSmoother,
    smooth_file,
)

from . import test_elastic_filter as elastic
from . import test_iterated as swinging
from . import test_kalman_filter as linear
from .drawn import jerk_noise

BOTH = pytest.mark.parametrize(
    ("method", "beta"), [(UnscentedKalmanFilter, 2.0), (CubatureKalmanFilter, 0.0)], ids=["unscented", "cubature"]
)
SMOOTHERS = {UnscentedKalmanFilter: UnscentedSmoother, CubatureKalmanFilter: CubatureSmoother}


def readings(seed=3, size=1.0):
    """Readings of the pendulum, none missing, from states that are spread ``size`` times as far as a filter expects."""
    rng = np.random.default_rng(seed)
    x = swinging.states(size * rng.standard_normal((swinging.ROWS, 3)))
    return swinging.read(x) + rng.standard_normal((swinging.ROWS, 3)) * swinging.STD


def agree(ours, mean, covariance, part):
    """States and covariances are these, to a part of standard deviations."""
    std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.abs((ours.state - mean) / std).max() < part
    assert np.abs((ours.covariance - covariance) / (std[:, :, None] * std[:, None, :])).max() < part


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
    mean, covariance = np.array(mean), np.array(covariance)
    robot = swinging.pendulum()
    ours = method(robot, swinging.NOISE, start=swinging.START, **swinging.SETTINGS).run(
        swinging.log_of(robot, columns), covariance=True
    )
    agree(ours, mean, covariance, 1e-6)
    smoothed = SMOOTHERS[method](robot, swinging.NOISE, start=swinging.START, **swinging.SETTINGS).run(
        swinging.log_of(robot, columns), covariance=True
    )
    agree(smoothed, *peer.rts_smoother(mean, covariance)[:2], 1e-6)
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
    smoothed = SMOOTHERS[method](robot, linear.NOISE, start="rest", tolerances=False).run(log, covariance=True)
    np.testing.assert_allclose(smoothed.state, book["xs"], rtol=0, atol=1e-12)
    linear.close(smoothed.covariance, book["ps"], book["ps"], 1e-9)


def ours_name(method):
    return "unscented" if method is UnscentedKalmanFilter else "cubature"


@pytest.mark.parametrize("linearisation", ["unscented", "cubature"])
def test_on_a_linear_elastic_joint_it_is_the_plain_filter(linearisation):
    robot, columns = elastic.slide(), elastic.wandering(np.random.default_rng(1))
    log, settings = Log.from_table(columns, robot), {"start": "rest", "tolerances": False}
    for method in (ElasticJointFilter, ElasticJointSmoother):
        ours = method(robot, elastic.NOISE, linearisation=linearisation, **settings).run(log, covariance=True)
        plain = method(robot, elastic.NOISE, **settings).run(log, covariance=True)
        # Points go by the rule of Runge and Kutta, derivatives by the exponential.
        agree(ours, plain.state, plain.covariance, 1e-4)


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


@pytest.mark.parametrize("method", [IteratedSmoother, ElasticJointIteratedSmoother])
def test_the_most_probable_motion_refuses_points(method):
    with pytest.raises(EstimatorError, match="derivatives"):
        method(linear.slide(), linearisation="unscented")


HARD, ROWS, STEP = 5e9, 60, 1e-3
"""Of a cart on a hardening spring [N/m³], and of its recording."""
CARTS_NOISE = ElasticNoise(
    link_acceleration=2.0,
    motor_acceleration=5.0,
    torque=1e-9,
    disturbance=1e-9,
    disturbance_walk=0.0,
    transmission=1e-4,
)
CARTS_START = np.array([0.0, 0.1, 2e-3, -0.2, 0.0]), np.diag([2e-3, 0.2, 2e-3, 0.3, 1e-6]) ** 2


def rates(x):
    """The cart's ẋ at columns of states, under a constant torque."""
    q, dq, theta, dtheta, disturbance = x
    spring = elastic.K * (theta - q) + HARD * (theta - q) ** 3 + elastic.D * (dtheta - dq)
    ddtheta = (250.0 + disturbance - elastic.F * dtheta - spring) / elastic.B
    return np.stack([dq, spring / elastic.M - elastic.GRAVITY, dtheta, ddtheta, 0.0 * q])


def after(x, substeps=8):
    """The same a step later, by the classical rule."""
    h = STEP / substeps
    for _ in range(substeps):
        a = rates(x)
        b = rates(x + 0.5 * h * a)
        c = rates(x + 0.5 * h * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + rates(x + h * c))
    return x


def process_noise(x):
    """C. F. Van Loan's (1978) integral of the cart's noise over a step that begins at ``x``."""
    middle = 0.5 * (x + after(x))
    a = np.stack([rates(middle + 1e-30j * unit).imag / 1e-30 for unit in np.eye(5)], axis=1)
    density = np.diag([0, CARTS_NOISE.link_acceleration, 0, CARTS_NOISE.motor_acceleration, 0]) ** 2
    block = expm(STEP * np.block([[-a, density], [np.zeros((5, 5)), a.T]]))
    return block[5:, 5:].T @ block[:5, 5:]


def plain_smoother(readings, variance, centre):
    """Särkkä's (2008) smoother of the cart; the cross-covariance of consecutive states is a sum over the points."""
    x, p = CARTS_START
    kept = []
    for i, reading in enumerate(readings):
        if i:
            points = np.concatenate([sign * np.sqrt(5) * np.linalg.cholesky(p) for sign in (1, -1)], axis=1)
            ends = after(x[:, None] + points)
            mean = ends.mean(axis=1)
            off = after(x) - mean
            spread = (ends - mean[:, None]) @ (ends - mean[:, None]).T / 10 + centre * np.outer(off, off)
            spread += process_noise(x)
            kept.append((x, p, mean, spread, points @ (ends - mean[:, None]).T / 10))
            x, p = mean, spread
        if not np.isnan(reading):
            gain = p[:, 2] / (p[2, 2] + variance)
            x, p = x + gain * (reading - x[2]), p - np.outer(gain, p[2])
    means, covariances = [x], [p]
    for x, p, mean, spread, cross in reversed(kept):
        gain = np.linalg.solve(spread, cross.T).T
        means.append(x + gain @ (means[-1] - mean))
        covariances.append(p + gain @ (covariances[-1] - spread) @ gain.T)
    return np.array(means[::-1]), np.array(covariances[::-1])


@pytest.mark.parametrize(("linearisation", "centre"), [("unscented", 2.0), ("cubature", 0.0)])
def test_on_a_hardening_spring_it_is_a_plain_smoother_in_numpy(linearisation, centre):
    robot = Robot.from_urdf(
        elastic.SLIDE, joints=[elastic.DRIVE | {"cubic_stiffness": HARD}], encoder={"resolution": 1e-6}
    )
    rng = np.random.default_rng(1)
    x, theta = CARTS_START[0], []
    for _ in range(ROWS):
        theta.append(x[2] + CARTS_NOISE.transmission * rng.standard_normal())
        x = after(x)
    theta = np.array(theta)
    theta[20:45] = np.nan
    log = Log.from_table(
        {"t": np.arange(ROWS) * STEP, "theta_x": theta, "tau_x": np.full(ROWS, 250.0)}, robot, check=False
    )
    settings = {"start": CARTS_START, "tolerances": False, "accelerations": False, "dtheta": False}
    ours = ElasticJointSmoother(robot, CARTS_NOISE, linearisation=linearisation, **settings).run(log, covariance=True)
    expected = plain_smoother(theta, 1e-12 / 12 + CARTS_NOISE.transmission**2, centre)
    agree(ours, *expected, 5e-4)
    plain = ElasticJointSmoother(robot, CARTS_NOISE, **settings).run(log)
    assert np.abs((plain.q[:, 0] - expected[0][:, 0]) / ours.q_std[:, 0]).max() > 0.5  # there is something to agree on


@pytest.mark.parametrize(
    "method",
    [
        UnscentedSmoother,
        CubatureSmoother,
        lambda robot: ElasticJointSmoother(robot, linearisation="unscented"),
        lambda robot: ElasticJointSmoother(robot, linearisation="cubature"),
    ],
    ids=["unscented", "cubature", "elastic unscented", "elastic cubature"],
)
@pytest.mark.parametrize("lost", ["accelerometer", "all"])
def test_it_is_honest_through_dropouts(method, lost):
    robot, log = linear.recording("arm2_square")
    acceleration, theta = log.acceleration.copy(), log.theta.copy()
    acceleration[600:1000] = np.nan
    if lost == "all":
        theta[600:700] = np.nan
    gaps = dataclasses.replace(log, acceleration=acceleration, theta=theta)[:1600]
    found = method(robot).run(gaps)
    truth = Estimate.read(linear.DATA / "arm2_square" / "truth.parquet")
    error = np.abs(found.q - truth.q[np.searchsorted(truth.t, found.t - 1e-9)])
    assert (error < 3 * found.q_std).all()
    assert not (found.status & (Status.CONTRADICTED | Status.FAULTY)).any()
    assert (found.q_std[650] > method(robot).run(log[:1600]).q_std[650]).all()


def test_from_file_to_file_it_is_the_smoother_of_the_whole(tmp_path):
    robot, log = linear.recording("arm2_square")
    smoother = UnscentedSmoother(robot, linear.Noise(jerk=15.0))
    log[:1000].write(tmp_path / "log.parquet")
    smooth_file(smoother, tmp_path / "log.parquet", robot, tmp_path / "out.parquet", rows=300)
    np.testing.assert_array_equal(Estimate.read(tmp_path / "out.parquet").q, smoother.run(log[:1000]).q)
