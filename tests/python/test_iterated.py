"""The most probable motion and robust losses: against a pendulum in closed form, SciPy, and the linear smoother."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import least_squares

from linkside import (
    ElasticJointIteratedSmoother,
    ElasticJointSmoother,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    IteratedSmoother,
    Log,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
    Status,
)
from linkside.kalman import bound
from linkside.kalman.cleaning import cleaned
from linkside.kalman.start import Readings, Spread

from . import test_kalman_filter as linear
from .drawn import jerk_noise

PENDULUM = """<robot name="pendulum"><link name="base"/><link name="bob"><inertial>
<origin xyz="0.4 0 0"/><mass value="20"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.5" iyz="0" izz="0.5"/></inertial></link><joint name="x" type="revolute">
<parent link="base"/><child link="bob"/><axis xyz="0 -1 0"/><limit lower="-9" upper="9" effort="1" velocity="1"/>
</joint></robot>"""
MASS, REACH, INERTIA, GRAVITY = 20.0, 0.4, 0.5 + 20.0 * 0.4**2, 9.81
STIFFNESS, PLACE, STEP, ROWS = 2e3, 0.6, 4e-3, 60
STD = np.array([1e-3, 0.05, 0.05])
"""Of the motor position and of both axes of the accelerometer."""
NOISE = Noise(
    jerk=60.0, transmission=1e-3, torsion=0.0, motor_velocity=0.0, position=1e-2, velocity=0.5, initial_acceleration=3.0
)
SETTINGS = {"biases": (), "damping": False, "tolerances": False, "link_disturbance": False}
START = np.array([0.4, 0.6, 0.0]), np.diag([1e-2, 0.5, 3.0]) ** 2


def pendulum():
    """One link that swings about a horizontal axis behind a spring, an accelerometer on it."""
    sensor = {"name": "acc", "link": "bob", "xyz": [PLACE, 0, 0], "axes": "xz", "noise_std": STD[1]}
    drive = {"name": "x", "stiffness": STIFFNESS, "motor_inertia": 1.0}
    return Robot.from_urdf(PENDULUM, [drive], accelerometers=[sensor], encoder={"resolution": 1e-9})


def read(x):
    """What motor and accelerometer read in states (..., 3), as mechanics has it."""
    q, dq, ddq = np.moveaxis(x, -1, 0)
    theta = q + (INERTIA * ddq + MASS * GRAVITY * REACH * np.cos(q)) / STIFFNESS
    return np.stack([theta, -PLACE * dq**2 + GRAVITY * np.sin(q), PLACE * ddq + GRAVITY * np.cos(q)], axis=-1)


def states(z):
    """States of starts and jerks in their standard deviations (ROWS, 3)."""
    f = np.array([[1, STEP, STEP**2 / 2], [0, 1, STEP], [0, 0, 1]])
    jolts = z[1:] @ (NOISE.jerk * np.linalg.cholesky(jerk_noise(STEP))).T
    x = [START[0] + z[0] * np.sqrt(np.diag(START[1]))]
    for jolt in jolts:
        x.append(f @ x[-1] + jolt)
    return np.array(x)


def drawn(seed, outliers=0.0):
    rng = np.random.default_rng(seed)
    x = states(rng.standard_normal((ROWS, 3)))
    noise = rng.standard_normal((ROWS, 3)) * STD
    struck = rng.random(ROWS) < outliers
    noise[struck, 1:] *= 50.0
    readings = read(x) + noise
    readings[rng.random((ROWS, 3)) < 0.1] = np.nan
    readings[0, 0] = read(x[0])[0]
    return x, readings


def cost(z, readings, loss):
    """Minus the log density of a path: the motor and the accelerometer are a sensor each."""
    errors = (readings - read(states(z))) / STD
    total = 0.5 * (z * z).sum()
    for sensor in (errors[:, :1], errors[:, 1:]):
        there = ~np.isnan(sensor.real)
        squared = (np.where(there, sensor, 0.0) ** 2).sum(axis=1)
        if loss == "student-t":
            total += (0.5 * (4 + there.sum(axis=1)) * np.log(1 + squared / 4)).sum()
        elif loss == "huber":
            far = np.where(squared.real > 1.345**2, squared, 1.345**2)
            total += np.where(squared.real > 1.345**2, 1.345 * np.sqrt(far) - 0.5 * 1.345**2, 0.5 * squared).sum()
        else:
            total += 0.5 * squared.sum()
    return total


def gradient(z, readings, loss):
    """By the complex step, exact to rounding."""
    out = np.empty(z.size)
    for i in range(z.size):
        moved = z.astype(complex)
        moved.flat[i] += 1e-30j
        out[i] = cost(moved, readings, loss).imag / 1e-30
    return out


def whitened(x):
    """Starts and jerks of states, in their standard deviations."""
    f = np.array([[1, STEP, STEP**2 / 2], [0, 1, STEP], [0, 0, 1]])
    root = NOISE.jerk * np.linalg.cholesky(jerk_noise(STEP))
    return np.vstack(
        [(x[0] - START[0]) / np.sqrt(np.diag(START[1])), np.linalg.solve(root, (x[1:] - x[:-1] @ f.T).T).T]
    )


def log_of(robot, readings):
    columns = {"t": STEP * np.arange(len(readings)), "theta_x": readings[:, 0]}
    return Log.from_table(columns | {"acc_x": readings[:, 1], "acc_z": readings[:, 2]}, robot, check=False)


@pytest.mark.parametrize("loss", ["squares", "huber", "student-t"])
def test_it_is_where_the_density_is_largest(loss):
    robot = pendulum()
    _, readings = drawn(3, 0.05)
    estimate = IteratedSmoother(robot, NOISE, start=START, loss=loss, **SETTINGS).run(log_of(robot, readings))
    found = whitened(np.stack([estimate.q, estimate.dq, estimate.ddq], axis=-1)[:, 0])
    # z has standard deviations of about 1 and less: so close to where the gradient is zero.
    assert np.abs(gradient(found, readings, loss)).max() < (1e-5 if loss == "squares" else 1e-2)


def test_it_is_where_scipys_least_squares_ends():
    robot = pendulum()
    _, readings = drawn(3)
    estimate = IteratedSmoother(robot, NOISE, start=START, **SETTINGS).run(log_of(robot, readings))
    found = whitened(np.stack([estimate.q, estimate.dq, estimate.ddq], axis=-1)[:, 0])

    def residuals(z):
        errors = (readings - read(states(z.reshape(ROWS, 3)))) / STD
        return np.concatenate([z, errors[~np.isnan(readings)]])

    def jacobian(z):
        return np.stack([residuals(z + 1e-30j * axis).imag / 1e-30 for axis in np.eye(z.size)], axis=1)

    theirs = least_squares(residuals, np.zeros(3 * ROWS), jac=jacobian, method="lm", gtol=1e-12, xtol=1e-12)
    assert np.abs(found.ravel() - theirs.x).max() < 1e-5
    assert cost(found, readings, "squares") == pytest.approx(theirs.cost, rel=1e-9)


def test_its_covariance_is_the_inverse_of_the_curvature():
    """Of Gauss and Newton's: dense, by derivatives of the closed forms."""
    robot = pendulum()
    _, readings = drawn(4)
    smoother = IteratedSmoother(robot, NOISE, start=START, **SETTINGS)
    estimate = smoother.run(log_of(robot, readings), covariance=True)
    z = whitened(estimate.state)
    rows = np.empty((3 * ROWS, 3 * ROWS))
    path = np.empty((3 * ROWS, 3 * ROWS))
    for i in range(3 * ROWS):
        moved = z.astype(complex)
        moved.flat[i] += 1e-30j
        path[:, i] = states(moved).imag.ravel() / 1e-30
        rows[:, i] = (read(states(moved)) / STD).imag.ravel() / 1e-30
    rows[np.isnan(readings).ravel()] = 0.0
    covariance = path @ np.linalg.inv(np.eye(3 * ROWS) + rows.T @ rows) @ path.T
    for i in range(0, ROWS, 7):
        dense = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        np.testing.assert_allclose(estimate.covariance[i], dense, rtol=1e-6, atol=1e-9 * np.abs(dense).max())


def test_on_a_linear_robot_it_is_the_smoother():
    robot = linear.slide()
    columns, _ = linear.drawn(linear.NOISE, np.random.default_rng(1))
    columns["acc_z"][100:140] = np.nan
    log = Log.from_table(columns, robot)
    given = {"start": "rest", "tolerances": False}
    plain = RauchTungStriebelSmoother(robot, linear.NOISE, **given).run(log, covariance=True)
    ours = IteratedSmoother(robot, linear.NOISE, **given).run(log, covariance=True)
    np.testing.assert_allclose(ours.state, plain.state, rtol=0, atol=1e-12)
    linear.close(ours.covariance, plain.covariance, plain.covariance, 1e-12)
    np.testing.assert_allclose(ours.nis, plain.nis, rtol=1e-9, atol=1e-12)


def test_on_a_linear_elastic_joint_it_is_the_smoother():
    robot = linear.slide()
    columns, _ = linear.drawn(linear.NOISE, np.random.default_rng(2), 200)
    t = np.arange(200) * 1e-3
    columns |= {"tau_x": 30.0 * linear.GRAVITY + 20.0 * np.sin(20 * t)}
    columns["acc_z"][60:90] = np.nan
    log = Log.from_table(columns, robot, check=False)
    given = {"start": "rest", "tolerances": False, "link_disturbance": False}
    plain = ElasticJointSmoother(robot, **given).run(log, covariance=True)
    ours = ElasticJointIteratedSmoother(robot, **given).run(log, covariance=True)
    # Where the mean goes by Runge and Kutta's rule, F by the exponential: they differ by 1e-6 of the motion.
    linear.close(ours.state, plain.state, plain.covariance, 5e-3)
    linear.close(ours.covariance, plain.covariance, plain.covariance, 1e-6)


def recorded(name, outliers=0.0, seed=0):
    """A recording with a truth, some of its accelerometer samples struck by 50 standard deviations."""
    robot, log = linear.recording(name)
    if outliers:
        rng = np.random.default_rng(seed)
        acceleration = log.acceleration.copy()
        struck = rng.random(len(log)) < outliers
        std = np.repeat([sensor.noise_std for sensor in robot.accelerometers], 3)[: acceleration.shape[1]]
        acceleration[struck] += 50.0 * std * rng.standard_normal(acceleration[struck].shape)
        log = dataclasses.replace(log, acceleration=acceleration)
    return robot, log


# On arm2_square: RMS of the tool over that of the same method on the log as it is, per cent of sensor readings struck.
@pytest.mark.parametrize("method", [ExtendedKalmanFilter, RauchTungStriebelSmoother, IteratedSmoother])
@pytest.mark.parametrize(("share", "most"), [(0.01, 1.2), (0.05, 1.5)])
def test_outliers_of_fifty_deviations_hardly_matter_to_students_t(method, share, most):
    robot, log = recorded("arm2_square")
    truth = Estimate.read(linear.DATA / "arm2_square/truth.parquet")[:1500]

    def error(log, loss):
        estimate = method(robot, Noise(jerk=20.0), loss=loss, link_disturbance=False).run(log[:1500])
        assert not (estimate.status & Status.CONTRADICTED).any() or loss == "squares"
        return estimate, estimate.error_against(truth).tool_rms_centred_mm

    struck = recorded("arm2_square", share, seed=2)[1]
    _, clean = error(log, "squares")
    estimate, robust = error(struck, "student-t")
    assert robust < most * clean
    assert error(struck, "squares")[1] > 1.5 * most * clean
    away = np.abs(struck.acceleration - log.acceleration)[:1500].max(axis=1) > 2.0
    gated = (estimate.status & Status.GATED) > 0
    assert gated[away].mean() > 0.95
    assert gated[~away].mean() < 0.01


def test_a_sensor_that_stays_away_is_no_outlier():
    """A step of 40 deviations is left out for a few samples, and then judged: the filter does not run free."""
    robot, log = recorded("arm2_square")
    log = log[:1200]
    acceleration = log.acceleration.copy()
    acceleration[600:] += 2.0
    log = dataclasses.replace(log, acceleration=acceleration)
    estimate = ExtendedKalmanFilter(robot, Noise(jerk=20.0), loss="student-t", link_disturbance=False).run(log)
    assert (estimate.status[600:650] & Status.GATED).any()
    assert (estimate.status[600:700] & Status.CONTRADICTED).any()
    assert estimate.findings


def test_a_loss_may_be_of_one_kind_of_sensor():
    robot, log = recorded("demo")
    log = log[:300]
    given = {"link_disturbance": False}
    squares = ExtendedKalmanFilter(robot, Noise(jerk=15.0), **given).run(log)
    none = ExtendedKalmanFilter(robot, Noise(jerk=15.0), loss={"acceleration": "squares"}, **given).run(log)
    np.testing.assert_array_equal(squares.q, none.q)
    some = ExtendedKalmanFilter(robot, Noise(jerk=15.0), loss={"acceleration": "huber"}, **given)
    assert "loss={'acceleration': 'huber'}" in repr(some)
    assert np.abs(some.run(log).q - squares.q).max() > 0
    for loss, message in [("cauchy", "loss is 'cauchy'"), ({"torques": "huber"}, "'torques' is not one of")]:
        with pytest.raises(EstimatorError, match=message):
            ExtendedKalmanFilter(robot, loss=loss)


def test_step_is_run_with_a_loss_too():
    robot, log = recorded("arm2_square", 0.05)
    log = log[:200]
    noise = Noise(jerk=20.0)
    run = ExtendedKalmanFilter(robot, noise, loss="student-t", link_disturbance=False).run(log)
    live = ExtendedKalmanFilter(robot, noise, loss="student-t", link_disturbance=False)
    for i in range(len(log)):
        jerk = {} if log.ddqref is None else {"ddqref": log.ddqref[i]}
        state = live.step(
            dt=log.t[i] - log.t[i - 1] if i else log.period,
            theta=log.theta[i],
            acceleration=log.acceleration[i],
            dtheta=log.dtheta[i],
            **jerk,
        )
        if i >= 32:
            np.testing.assert_allclose(state.q, run.q[i], rtol=0, atol=1e-12)
            assert state.status == run.status[i]


def test_on_the_elastic_model_it_agrees_with_the_smoother_where_that_is_nearly_linear():
    robot, log = recorded("arm2_square")
    log = log[:400]
    truth = Estimate.read(linear.DATA / "arm2_square/truth.parquet")[:400]
    methods = ElasticJointIteratedSmoother, ElasticJointSmoother
    ours, plain = (method(robot, link_disturbance=False, tolerances=False).run(log) for method in methods)
    assert not (ours.status & Status.CONTRADICTED).any()
    assert np.abs((ours.q - plain.q) / plain.q_std).max() < 1.0
    np.testing.assert_allclose(ours.q_std[50:], plain.q_std[50:], rtol=0.05)  # at the start a filter knows little
    errors = [estimate.error_against(truth).tool_rms_centred_mm for estimate in (ours, plain)]
    assert errors[0] < 1.05 * errors[1]


def test_the_bound_is_tichavskys():
    robot = pendulum()
    x, readings = drawn(5)
    log = log_of(robot, readings)
    zeros = np.zeros((ROWS, 1))
    motion = Estimate(
        log.t, x[:, :1], x[:, 1:2], zeros, zeros, np.zeros(ROWS, np.uint8), robot.names, ddq=x[:, 2:].copy()
    )
    noise = NOISE.updated(motor_bias=0.0, motor_bias_walk=0.0, acceleration_bias=0.0, acceleration_bias_walk=0.0)
    found = bound(robot, log, motion, noise)
    # Late in the log, where the start matters no more: J ← (Q + F J⁻¹ Fᵀ)⁻¹ + Hᵀ R⁻¹ H.
    f = np.array([[1, STEP, STEP**2 / 2], [0, 1, STEP], [0, 0, 1]])
    q, information = NOISE.jerk**2 * jerk_noise(STEP), np.linalg.inv(np.diag([1e-2, 0.5, 3.0]) ** 2)
    least = []
    for i in range(ROWS):
        if i:
            information = np.linalg.inv(q + f @ np.linalg.inv(information) @ f.T)
        rows = np.stack([read(x[i] + 1e-30j * axis).imag / 1e-30 for axis in np.eye(3)], axis=1) / STD[:, None]
        rows = rows[~np.isnan(readings[i])]
        information = information + rows.T @ rows
        least.append(np.sqrt(np.linalg.inv(information)[0, 0]))
    np.testing.assert_allclose(found.filter_q[40:, 0], least[40:], rtol=1e-3)
    assert (found.smoother_q <= found.filter_q * (1 + 1e-12)).all()
    np.testing.assert_allclose(found.smoother_q[-1], found.filter_q[-1], rtol=1e-9)


def test_a_bound_needs_accelerations_at_the_samples_of_the_log():
    robot = pendulum()
    _, readings = drawn(5)
    log = log_of(robot, readings)
    estimate = IteratedSmoother(robot, NOISE, start=START, **SETTINGS).run(log)
    with pytest.raises(EstimatorError, match="motion has no ddq"):
        bound(robot, log, dataclasses.replace(estimate, ddq=None), NOISE)
    with pytest.raises(EstimatorError, match="motion has 9 samples"):
        bound(robot, log, estimate[:9], NOISE)


def test_errors_of_the_smoother_are_those_of_the_bound():
    """40 recordings drawn from the model: mean square error over that of the bound, 1.0 ± 0.1 by chance."""
    robot = pendulum()
    noise = NOISE.updated(motor_bias=0.0, motor_bias_walk=0.0, acceleration_bias=0.0, acceleration_bias_walk=0.0)
    drawings = [drawn(100 + seed) for seed in range(40)]
    logs = [log_of(robot, readings) for _, readings in drawings]
    estimates = IteratedSmoother(robot, noise, start=START, **SETTINGS).run(logs)
    errors = np.array([estimate.q[:, 0] - x[:, 0] for estimate, (x, _) in zip(estimates, drawings, strict=True)])
    least = np.array(
        [bound(robot, log, estimate, noise).smoother_q[:, 0] for log, estimate in zip(logs, estimates, strict=True)]
    )
    middle = slice(15, -5)
    ratio = np.sqrt(np.mean(errors[:, middle] ** 2) / np.mean(least[:, middle] ** 2))
    assert 0.85 < ratio < 1.2


@pytest.mark.parametrize("moving", [False, True])
def test_a_start_is_cleaned_of_outliers_and_of_nothing_else(moving):
    _, log = recorded("arm2_square")
    log = log[700:] if moving else log
    t, theta, acceleration = log.t[:32], log.theta[:32], log.acceleration[:32]
    spread = Spread(np.full(2, 1e-5), 1e-3, np.full(3, 0.05), np.full(2, 20.0))
    first = Readings(t, theta, None, acceleration)
    same = cleaned(first, spread, motors=True, acceleration=True)
    np.testing.assert_array_equal(same.theta, theta)
    np.testing.assert_array_equal(same.acceleration, acceleration)
    rng = np.random.default_rng(3)
    struck = rng.random(acceleration.shape) < 0.1
    bad = dataclasses.replace(first, acceleration=acceleration + 2.5 * struck)
    found = cleaned(bad, spread, motors=True, acceleration=True)
    np.testing.assert_array_equal(found.acceleration[~struck], acceleration[~struck])
    assert np.abs(found.acceleration - acceleration).max() < 0.3
    kept = cleaned(bad, spread, motors=True, acceleration=False)
    np.testing.assert_array_equal(kept.acceleration, bad.acceleration)
