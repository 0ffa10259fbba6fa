"""The filter on motors moved by jerk against dense matrices, the jerk-driven filter, itself, and recordings."""

import dataclasses

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from hypothesis import given
from hypothesis import strategies as st

from linkside import (
    ExtendedKalmanFilter,
    Log,
    MotorJerkFilter,
    MotorJerkNoise,
    MotorJerkSmoother,
    Noise,
    Robot,
)

from . import test_elastic_filter as elastic
from .drawn import bias_step
from .test_elastic_filter import GRAVITY, SLIDE, B, D, F, K, M, equal, recording, slide

NOISE = MotorJerkNoise(jerk=300.0, link_acceleration=0.3, transmission=2e-5, motor_velocity=5e-3)
H = 1e-4


def signals(rng, count=300, h=H):
    """Signals of the cart; a filter need not know where they come from."""
    columns = elastic.wandering(rng, count, h)
    return columns | {"qref_x": columns["theta_x"], "ddqref_x": np.sin(70 * columns["t"])}


def dense(columns, *, torque, h=H):
    """Kalman (1960), and Rauch, Tung and Striebel (1965), on the state (q, q̇, θ, θ̇, θ̈, biases) of the cart."""
    kinds = ("motor", "acceleration", *(("tau",) if torque else ()))
    n, biases = 5, len(kinds) - 1
    a = np.zeros((n + biases, n + biases))
    a[0, 1] = a[2, 3] = a[3, 4] = 1
    a[1, :4] = np.array([-K, -D, K, D]) / M
    # The commanded jerk is constant over a step, and so is gravity.
    big = np.zeros((n + biases + 2, n + biases + 2))
    big[: n + biases, : n + biases] = a
    big[4, -2], big[1, -1] = 1, -GRAVITY
    big = scipy.linalg.expm(big * h)
    f = big[: n + biases, : n + biases]
    arrays = NOISE.arrays(slide(), kinds)
    decay, variance = (values[1:] for values in bias_step(arrays, h))
    f[n:, n:] = np.diag(decay)
    walks = np.array([0, NOISE.link_acceleration, 0, 0, NOISE.jerk, *[0] * biases])

    def spread(s):
        return scipy.linalg.expm(a * s) @ np.diag(walks**2) @ scipy.linalg.expm(a * s).T

    # White noise all the time, by adaptive quadrature.
    q = scipy.integrate.quad_vec(spread, 0, h, epsabs=0, epsrel=1e-13)[0]
    q[n:, n:] += np.diag(variance)
    unit = np.eye(n + biases)
    rows = [unit[2], a[1] + unit[n]]
    readings = [columns["theta_x"], columns["acc_z"]]  # gravity is in both of them
    if torque:  # B θ̈ + F θ̇ + K (θ − q) + D (θ̇ − q̇)
        rows.append(M * a[1] + F * unit[3] + B * unit[4] + unit[n + 1])
        readings.append(columns["tau_x"])
    rows, readings, r = np.stack(rows), np.stack(readings, axis=1), np.diag(np.square(arrays["reading"]))
    x = np.concatenate([[columns["theta_x"][0] - M * GRAVITY / K, 0, columns["theta_x"][0]], np.zeros(2 + biases)])
    p = np.diag(np.square(np.r_[[NOISE.position, NOISE.velocity] * 2, 0.1, arrays["initial_bias"][1:]]))
    jerk = np.diff(columns["ddqref_x"], prepend=columns["ddqref_x"][0]) / h
    before, p_before, after, p_after = [], [], [], []
    for i, reading in enumerate(readings):
        if i:
            x = (big @ np.array([*x, jerk[i], 1.0]))[: n + biases]
            p = f @ p @ f.T + q
        before.append(x)
        p_before.append(p)
        there = ~np.isnan(reading)
        hh, rr = rows[there], r[np.ix_(there, there)]
        s = hh @ p @ hh.T + rr
        gain = np.linalg.solve(s, hh @ p).T
        x = x + gain @ (reading[there] - hh @ x)
        left = np.eye(n + biases) - gain @ hh
        p = left @ p @ left.T + gain @ rr @ gain.T
        after.append(x)
        p_after.append(p)
    xs, ps = [x], [p]
    for i in range(len(readings) - 2, -1, -1):
        scale = np.sqrt(np.diag(p_before[i + 1]))
        inverse = np.linalg.inv(p_before[i + 1] / np.outer(scale, scale)) / np.outer(scale, scale)
        gain = p_after[i] @ f.T @ inverse
        left = np.eye(n + biases) - gain @ f
        xs.append(after[i] + gain @ (xs[-1] - before[i + 1]))
        ps.append(left @ p_after[i] @ left.T + gain @ (q + ps[-1]) @ gain.T)
    return [np.array(values) for values in (after, p_after, xs[::-1], ps[::-1])]


@pytest.mark.parametrize("torque", [False, True])
@pytest.mark.parametrize("lost", [False, True])
def test_on_a_linear_robot_it_is_the_dense_filter_and_smoother(lost, torque):
    robot, columns = slide(), signals(np.random.default_rng(1))
    if lost:
        columns["acc_z"][np.arange(300) % 4 != 0] = np.nan
        columns["theta_x"][100:140] = np.nan
        columns["tau_x"][120:160] = np.nan
    log = Log.from_table(columns, robot)
    x, p, xs, ps = dense(columns, torque=torque)
    settings = {"start": "rest", "tolerances": False, "tau": torque}
    ours = MotorJerkFilter(robot, NOISE, **settings).run(log, covariance=True)
    smooth = MotorJerkSmoother(robot, NOISE, **settings).run(log, covariance=True)
    for found, mean, covariance in ((ours, x, p), (smooth, xs, ps)):
        assert np.abs(found.state - mean).max() < 1e-10 * np.abs(mean).max()
        std = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        assert np.abs((found.covariance - covariance) / (std[:, :, None] * std[:, None, :])).max() < 1e-6
    assert np.abs((smooth.state - ours.state)[-1]).max() < 1e-12


@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 99))
def test_motors_alone_do_not_know_of_springs_masses_and_dampers(spring, damper, seed):
    drive = elastic.DRIVE | {"stiffness": K * np.exp(spring), "damping": D * np.exp(damper)}
    columns = signals(np.random.default_rng(seed), 40)
    own = ("t", "theta_x", "qref_x", "ddqref_x")
    found = []
    for robot in (slide(), Robot.from_urdf(SLIDE, joints=[drive], encoder={"resolution": 1e-6})):
        log = Log.from_table({name: columns[name] for name in own}, robot)
        found.append(MotorJerkFilter(robot, NOISE, accelerations=False).run(log))
    np.testing.assert_allclose(found[0].log_likelihood, found[1].log_likelihood, rtol=1e-9)
    np.testing.assert_allclose(found[0].theta, found[1].theta, rtol=0, atol=1e-15)


def rigid():
    """The two-axis arm without springs."""
    folder = elastic.DATA / "arm2_square"
    sensor = {"name": "tool_acc", "link": "fore", "xyz": [1.0, 0.0, 0.08], "rpy": [0.0, 0.35, 0.0], "noise_std": 0.05}
    joints = [{"name": name, "elastic": False, "motor_inertia": 50.0} for name in ("axis2", "axis3")]
    robot = Robot.from_urdf((folder / "robot.urdf").read_text(), joints=joints, accelerometers=[sensor])
    return robot, Log.read(folder / "log.parquet", robot)


def test_rigid_joints_are_those_of_the_jerk_driven_filter():
    robot, log = rigid()
    noise = {"jerk": 200.0, "transmission": 2e-5}
    settings = {"tolerances": False, "biases": ("acceleration",), "start": "rest", "link_disturbance": False}
    ours = MotorJerkFilter(robot, MotorJerkNoise(**noise), **settings).run(log[:300])
    theirs = ExtendedKalmanFilter(robot, Noise(**noise), **settings).run(log[:300])
    for signal in ("q", "dq", "ddq", "q_std", "log_likelihood"):
        np.testing.assert_allclose(
            getattr(ours, signal), getattr(theirs, signal), rtol=1e-8, atol=1e-10, err_msg=signal
        )
    assert np.array_equal(ours.q, ours.theta)


LIMITS = {  # tool error with its offset out: filter, smoother; the same without accelerometers, RMS [mm]
    "arm2_square": (0.0050, 0.0027, 0.0004, 0.0004),
    "kr15_six_axes": (0.0052, 0.0029, 0.0006, 0.0006),
    "demo": (0.0440, 0.0445, 0.0435, 0.0435),
}


@pytest.mark.parametrize("name", LIMITS)
def test_tool_error_on_recordings(name):
    robot, log, truth = recording(name)
    log = dataclasses.replace(log, tau=None)
    found = []
    for accelerations in (True, False):
        for method in (MotorJerkFilter, MotorJerkSmoother):
            estimate = method(robot, accelerations=accelerations).run(log)
            found.append(estimate.error_against(truth).tool_rms_centred)
    assert (np.array(found) < LIMITS[name]).all(), found


@pytest.mark.parametrize("name", ["demo", "kr15_six_axes"])  # the hand of the first is rigid
def test_run_step_and_pieces_are_the_same_bits(name):
    robot, log, _ = recording(name)
    log = log[:200]
    ekf = MotorJerkFilter(robot, MotorJerkNoise(jerk=300.0), start="rest", dtheta=True)
    whole = ekf.run(log, covariance=True)
    assert equal(whole, type(whole).concatenate(list(ekf.run_pieces(log[a : a + 77] for a in range(0, 200, 77)))))
    assert all(equal(whole, one) for one in ekf.run([log, log]))
    dt = np.diff(log.t, prepend=log.t[0] - log.period)
    for i in range(200):
        signals = {s: getattr(log, s)[i] for s in ("theta", "dtheta", "acceleration", "ddqref")}
        state = ekf.step(dt=dt[i], **signals)
        for name in ("state", "q", "theta", "dtheta", "q_std", "tool_position", "tool_std", "nis", "status"):
            assert np.array_equal(getattr(state, name), getattr(whole, name)[i]), name
    assert np.array_equal(ekf.covariance, whole.covariance[-1])
    assert np.array_equal(whole.covariance, whole.covariance.swapaxes(1, 2))
