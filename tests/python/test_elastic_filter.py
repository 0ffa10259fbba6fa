"""The filter on the elastic-joint model against dense matrices, against itself, and on recordings."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from pydantic import ValidationError

from linkside import (
    ConfigError,
    ElasticJointFilter,
    ElasticJointSmoother,
    ElasticNoise,
    Estimate,
    EstimatorError,
    Log,
    LogError,
    NumericalError,
    Robot,
    Status,
    demo,
    simulate,
)

from .drawn import bias_step

DATA = Path(__file__).parents[1] / "data"
SLIDE = """<robot name="slide"><link name="base"/><link name="cart"><inertial><mass value="30"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="x" type="prismatic">
<parent link="base"/><child link="cart"/><axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="1" velocity="1"/>
</joint></robot>"""
K, D, B, M, F = 4e4, 50.0, 5.0, 30.0, 20.0
DRIVE = {"name": "x", "stiffness": K, "damping": D, "motor_inertia": B, "motor_friction": {"viscous": F}}
NOISE = ElasticNoise(link_acceleration=0.3, motor_acceleration=0.2, transmission=2e-5, motor_velocity=5e-3)
GRAVITY = 9.81


def slide():
    """A cart on a vertical slide behind a spring: everything about it is linear."""
    sensor = {"name": "acc", "link": "cart", "axes": "z", "noise_std": 0.05}
    return Robot.from_urdf(SLIDE, joints=[DRIVE], accelerometers=[sensor], encoder={"resolution": 1e-6})


def recording(name):
    folder = demo.FOLDER if name == "demo" else DATA / name
    robot = Robot.load(folder / "robot.yaml")
    return robot, Log.read(folder / "log.parquet", robot), folder / "truth.parquet"


def wandering(rng, count=300, h=1e-3):
    """Signals of the cart; a filter need not know where they come from."""
    t = np.arange(count) * h
    wave = np.sin(30 * t)
    tau = M * GRAVITY + 40 * np.cos(25 * t) + rng.standard_normal(count)
    theta = M * GRAVITY / K + 1e-3 * wave + 1e-5 * rng.standard_normal(count)
    columns = {"t": t, "theta_x": theta, "dtheta_x": 0.03 * np.cos(30 * t), "tau_x": tau}
    return columns | {"acc_z": GRAVITY + rng.standard_normal(count)}


def dense(noise, columns, h=1e-3):
    """Kalman (1960), and Rauch, Tung and Striebel (1965), on the state (q, q̇, θ, θ̇, disturbance, bias) of the cart."""
    a = np.zeros((6, 6))
    a[0, 1] = a[2, 3] = 1
    spring = np.array([-K, -D, K, D, 0, 0])
    a[1] = spring / M
    a[3] = -spring / B
    a[3, 3] -= F / B
    a[3, 4] = 1 / B
    # The torque changes linearly: two more states, it and its slope.
    big = np.zeros((9, 9))
    big[:6, :6] = a
    big[3, 6], big[6, 7], big[1, 8] = 1 / B, 1, -GRAVITY
    big = scipy.linalg.expm(big * h)
    f = big[:6, :6]
    drag = F
    walks = [0, noise.link_acceleration, 0, noise.motor_acceleration, noise.disturbance_walk * drag, 0]
    decay, variance = bias_step(noise.arrays(slide(), ("motor", "acceleration")), h)
    f[5, 5] = decay[1]
    # White noise all the time, by adaptive quadrature; a torque's reading is wrong by the same all through a step, and
    # its mean by a change at any time in between.

    def spread(s):
        return scipy.linalg.expm(a * s) @ np.diag(np.square(walks)) @ scipy.linalg.expm(a * s).T

    torque = scipy.integrate.quad_vec(lambda s: scipy.linalg.expm(a * s)[:, 3] / B, 0, h, epsrel=1e-12)[0]
    q = scipy.integrate.quad_vec(spread, 0, h, epsabs=0, epsrel=1e-12)[0] + np.outer(torque, torque)
    q[5, 5] += variance[1]
    rows = np.stack([np.eye(6)[2], a[1] + np.eye(6)[5], np.eye(6)[3]])
    r = np.diag([1e-12 / 12 + noise.transmission**2, 0.05**2, noise.motor_velocity**2])
    readings = np.stack([columns["theta_x"], columns["acc_z"], columns["dtheta_x"]], axis=1)
    x = np.array([columns["theta_x"][0] - M * GRAVITY / K, 0, columns["theta_x"][0], 0, 0, 0])
    std = [noise.position, noise.velocity] * 2 + [noise.disturbance * drag, noise.acceleration_bias]
    p = np.diag(np.square(std))
    before, p_before, after, p_after = [], [], [], []
    for i, reading in enumerate(readings):
        if i:
            tau = columns["tau_x"][i - 1 : i + 1]
            x = (big @ np.array([*x, tau[0], (tau[1] - tau[0]) / h, 1.0]))[:6]
            p = f @ p @ f.T + q + (tau[1] - tau[0]) ** 2 / 12 * np.outer(torque, torque)
        before.append(x)
        p_before.append(p)
        there = ~np.isnan(reading)
        hh, rr = rows[there], r[np.ix_(there, there)]
        s = hh @ p @ hh.T + rr
        gain = np.linalg.solve(s, hh @ p).T
        x, p = x + gain @ (reading[there] - hh @ x), p - gain @ s @ gain.T
        after.append(x)
        p_after.append(p)
    xs, ps = [x], [p]
    for i in range(len(readings) - 2, -1, -1):
        gain = np.linalg.solve(p_before[i + 1], f @ p_after[i]).T
        xs.append(after[i] + gain @ (xs[-1] - before[i + 1]))
        ps.append(p_after[i] + gain @ (ps[-1] - p_before[i + 1]) @ gain.T)
    return [np.array(values) for values in (after, p_after, xs[::-1], ps[::-1])]


@pytest.mark.parametrize("lost", [False, True])
def test_on_a_linear_robot_it_is_the_dense_filter_and_smoother(lost):
    robot, columns = slide(), wandering(np.random.default_rng(1))
    if lost:
        columns["acc_z"][np.arange(300) % 4 != 0] = np.nan
        columns["dtheta_x"][100:140] = np.nan
    log = Log.from_table(columns, robot)
    x, p, xs, ps = dense(NOISE, columns)
    ours = ElasticJointFilter(robot, NOISE, start="rest", tolerances=False).run(log, covariance=True)
    std = np.sqrt(np.diagonal(p, axis1=1, axis2=2))
    assert np.abs((ours.state - x) / std).max() < 1e-4  # of Runge and Kutta's rule
    assert np.abs((ours.covariance - p) / (std[:, :, None] * std[:, None, :])).max() < 1e-6
    smooth = ElasticJointSmoother(robot, NOISE, start="rest", tolerances=False).run(log, covariance=True)
    std = np.sqrt(np.diagonal(ps, axis1=1, axis2=2))
    assert np.abs((smooth.state - xs) / std).max() < 1e-4
    assert np.abs((smooth.covariance - ps) / (std[:, :, None] * std[:, None, :])).max() < 1e-4
    assert np.abs((smooth.state - ours.state)[-1]).max() < 1e-12


LIMITS = {  # tool error with its offset out: filter, smoother; the same without accelerometers, RMS [mm]
    "arm2_square": (0.0058, 0.0030, 0.027, 0.024),
    "kr15_six_axes": (0.0058, 0.0033, 0.0225, 0.0185),
    "demo": (0.100, 0.082, 0.0500, 0.0445),
}


@pytest.mark.parametrize("name", LIMITS)
def test_tool_error_on_recordings(name):
    robot, log, truth = recording(name)
    found = []
    for accelerations in (True, False):
        for method in (ElasticJointFilter, ElasticJointSmoother):
            estimate = method(robot, accelerations=accelerations).run(log)
            found.append(estimate.error_against(truth).tool_rms_centred)
    assert (np.array(found) < LIMITS[name]).all(), found


def equal(a, b):
    return all(np.array_equal(a.columns()[c], b.columns()[c]) for c in a.columns())


@pytest.mark.parametrize("name", ["demo", "kr15_six_axes"])  # the hand of the first is rigid
def test_run_step_and_pieces_are_the_same_bits(name):
    robot, log, _ = recording(name)
    log = log[:200]
    ekf = ElasticJointFilter(robot, start="rest")
    whole = ekf.run(log, covariance=True)
    assert equal(whole, type(whole).concatenate(list(ekf.run_pieces(log[a : a + 77] for a in range(0, 200, 77)))))
    assert all(equal(whole, one) for one in ekf.run([log, log]))
    dt = np.diff(log.t, prepend=log.t[0] - log.period)
    for i in range(200):
        signals = {s: getattr(log, s)[i] for s in ("theta", "tau", "dtheta", "acceleration")}
        state = ekf.step(dt=dt[i], **signals)
        for name in ("state", "q", "theta", "dtheta", "q_std", "tool_position", "tool_std", "nis", "status"):
            assert np.array_equal(getattr(state, name), getattr(whole, name)[i]), name
    assert np.array_equal(ekf.covariance, whole.covariance[-1])
    assert np.array_equal(whole.covariance, whole.covariance.swapaxes(1, 2))


def test_first_order_and_exact_transition_agree_in_short_steps():
    robot, log, _ = recording("arm2_square")
    run = {t: ElasticJointFilter(robot, transition=t).run(log[:1000]) for t in ("exact", "first-order")}
    apart = np.abs(run["exact"].q - run["first-order"].q)
    assert 0 < apart.max() < run["exact"].q_std.max()


def test_a_missing_torque_is_the_one_before_and_trusted_less_and_less():
    robot, log, _ = recording("arm2_square")
    log = log[:100]
    held, missing = log.tau.copy(), log.tau.copy()
    held[40:43, 1], missing[40:43, 1] = held[39, 1], np.nan
    held, missing = (dataclasses.replace(log, tau=tau) for tau in (held, missing))
    sure = ElasticJointFilter(robot, ElasticNoise(torque_walk=0.0), start="rest", tolerances=False)
    assert np.array_equal(sure.run(held).q, sure.run(missing).q)
    for ekf in (sure, ElasticJointFilter(robot, ElasticNoise(torque_walk=300.0), start="rest", tolerances=False)):
        whole = ekf.run(missing)
        assert np.flatnonzero(whole.status & Status.BRIDGED).tolist() == [40, 41, 42]
        pieces = list(ekf.run_pieces([missing[:41], missing[41:]]))
        assert equal(whole, type(pieces[0]).concatenate(pieces))
    assert (whole.q_std[41:43, 1] > sure.run(missing).q_std[41:43, 1]).all()


@pytest.mark.parametrize("method", [ElasticJointFilter, ElasticJointSmoother])
@pytest.mark.parametrize("what", ["torques", "everything"])
@pytest.mark.parametrize("name", ["arm2_square", "demo"])
def test_torques_missing_for_a_tenth_of_a_second_are_no_certainty(method, what, name):
    robot, log, truth = recording(name)
    log = log[:600]
    cut = slice(300, 500)
    gone = {name: getattr(log, name).copy() for name in ("tau", "theta", "dtheta", "acceleration")}
    for name in gone if what == "everything" else ["tau"]:
        gone[name][cut] = np.nan
    true = Estimate.read(truth).q[:600]

    def worst(estimate):
        return (np.abs(estimate.q - true) / estimate.q_std)[290:560, :3].max()

    estimate = method(robot).run(dataclasses.replace(log, **gone))
    # The demo's hand gives a little, of which the model knows nothing.
    assert worst(estimate) < max(8, 1.3 * worst(method(robot).run(log)))
    assert (estimate.status[cut] & Status.BRIDGED).all()


def held_run(rate=100.0):
    """The cart under a torque that jumps at every sample, and a filter for it that trusts the model."""
    rng = np.random.default_rng(2)
    run = simulate(
        slide(), lambda t, state: M * GRAVITY + 40 * rng.standard_normal(1), 1.0, rate, integrator="adaptive"
    )
    sure = ElasticNoise(link_acceleration=1e-4, motor_acceleration=1e-4, transmission=1e-2, acceleration=50.0)
    return run, {"noise": sure, "disturbances": False, "biases": (), "start": "rest"}


def test_held_torques_are_not_interpolated():
    run, settings = held_run()
    errors = {
        kind: np.abs(
            ElasticJointFilter(run.robot, motor_torque=kind, **settings).run(run.log).dq - run.truth["dq"]
        ).max()
        for kind in ("held", "sampled")
    }
    assert np.ptp(run.truth["dq"]) > 0.1
    assert errors["held"] < 1e-4
    assert errors["sampled"] > 100 * errors["held"]


def test_held_torques_run_in_pieces_to_the_same_bits_and_step_after_they_have_acted():
    run, settings = held_run()
    log, held = run.log, ElasticJointFilter(run.robot, motor_torque="held", **settings)
    whole = held.run(log)
    pieces = [piece.q for piece in held.run_pieces([log[:7], log[7:8], log[8:]])]
    assert (np.vstack(pieces) == whole.q).all()
    acted = np.vstack([log.tau[:1], log.tau[:-1]])
    for k in range(len(log)):
        state = held.step(
            dt=0.01, theta=log.theta[k], tau=acted[k], dtheta=log.dtheta[k], acceleration=log.acceleration[k]
        )
    np.testing.assert_allclose(state.q, whole.q[-1], rtol=1e-12)


def test_a_disturbance_torque_is_found():
    robot, log, _ = recording("arm2_square")
    log = dataclasses.replace(log, tau=log.tau + np.array([25.0, 0.0]))
    plain = ElasticJointFilter(robot, disturbances=False, tolerances=False).run(log)
    found = ElasticJointFilter(robot, tolerances=False).run(log, covariance=True)
    n = robot.n
    assert found.state[-500:, 4 * n].mean() == pytest.approx(-25.0, abs=3.0)
    assert found.nis.sum() < 0.95 * plain.nis.sum()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gate": 0.0}, "gate is 0"),
        ({"iterations": 0}, "iterations is 0"),
        ({"biases": ["q"]}, "'q' is not one of"),
        ({"transition": "euler"}, "transition is 'euler'"),
        ({"motor_torque": "linear"}, "motor_torque is 'linear', expected 'sampled' or 'held'"),
        (
            {"noise": ElasticNoise(link_acceleration=(1.0, 2.0, 3.0))},
            "link_acceleration has 3 entries, expected 1 or 2",
        ),
    ],
)
def test_settings_out_of_range_are_refused(arguments, message):
    robot, log, _ = recording("arm2_square")
    with pytest.raises(EstimatorError, match=message):
        ElasticJointFilter(robot, **arguments).run(log[:10])


def test_noise_files_are_read_and_refused(tmp_path):
    (tmp_path / "good.yaml").write_text("torque: 2.5\nlink_acceleration: [1e-3, 2e-3]\n")
    assert ElasticNoise.read(tmp_path / "good.yaml").link_acceleration == (1e-3, 2e-3)
    (tmp_path / "bad.yaml").write_text("torque: 2.5\njerk: 3\n")
    with pytest.raises(ConfigError, match=r"bad\.yaml.*jerk"):
        ElasticNoise.read(tmp_path / "bad.yaml")
    with pytest.raises(ValidationError):
        ElasticNoise(torque=-1.0)


def test_logs_that_cannot_be_filtered_are_refused():
    robot, log, _ = recording("arm2_square")
    ekf = ElasticJointFilter(robot)
    without = {"t": log.t, "theta_axis2": log.theta[:, 0], "theta_axis3": log.theta[:, 1]}
    with pytest.raises(LogError, match="tau_axis2"):
        ekf.run(Log.from_table(without, robot))
    for signal in ("theta", "tau"):
        values = getattr(log, signal).copy()
        values[0, 1] = np.nan
        with pytest.raises(LogError, match=f"row 0: {signal}_axis3 is missing"):
            ekf.run(dataclasses.replace(log, **{signal: values}))
    wrong = log.tau.copy()
    wrong[70, 0] = np.inf
    with pytest.raises(NumericalError, match=r"log\.parquet.*sample 70"):
        ekf.run(dataclasses.replace(log, tau=wrong))
    with pytest.raises(EstimatorError, match="tau of joint 1 is NaN"):
        ekf.step(dt=5e-4, theta=[0, 0], tau=[0, np.nan])
    with pytest.raises(EstimatorError, match=r"theta has shape \(3,\), expected \(2,\)"):
        ekf.step(dt=5e-4, theta=[0, 0, 0], tau=[0, 0])
