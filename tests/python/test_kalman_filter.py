"""The Kalman filter and the smoother against a textbook in NumPy, against themselves, and against chance."""

import dataclasses
from decimal import Decimal, localcontext
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest
import scipy.stats
from filterpy.kalman import KalmanFilter
from pydantic import ValidationError

from linkside import (
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    LogError,
    Noise,
    NumericalError,
    RauchTungStriebelSmoother,
    Robot,
    Status,
    demo,
)

from .drawn import bias_step, jerk_noise
from .processors import outputs

DATA = Path(__file__).parents[1] / "data"
SLIDE = """<robot name="slide"><link name="base"/><link name="cart"><inertial><mass value="30"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="x" type="prismatic">
<parent link="base"/><child link="cart"/><axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="1" velocity="1"/>
</joint></robot>"""
DRIVE = {"name": "x", "stiffness": 4e4, "damping": 50.0, "motor_inertia": 5.0}
SENSOR = {"name": "acc", "link": "cart", "axes": "z", "noise_std": 0.05}
NOISE = Noise(jerk=40.0, transmission=2e-5, torsion=0.0, motor_velocity=0.0, acceleration_bias_walk=0.02)
GRAVITY = 9.81


def slide():
    """A cart on a vertical slide behind a spring: everything about it is linear."""
    return Robot.from_urdf(SLIDE, joints=[DRIVE], accelerometers=[SENSOR], encoder={"resolution": 1e-6})


def recording(name):
    folder = demo.FOLDER if name == "demo" else DATA / name
    robot = Robot.load(folder / "robot.yaml")
    return robot, Log.read(folder / "log.parquet", robot)


def slide_matrices(noise, h):
    """F, Q, H, offset and R of the cart's states (q, q̇, q̈, motor bias, accelerometer bias)."""
    f = np.eye(5)
    f[:3, :3] = [[1, h, h * h / 2], [0, 1, h], [0, 0, 1]]
    decay, variance = bias_step(noise.arrays(slide(), ("motor", "acceleration")), h)
    f[3, 3], f[4, 4] = decay
    q = np.diag([0, 0, 0, *variance])
    q[:3, :3] = noise.jerk**2 * jerk_noise(h)
    k, d, mass = DRIVE["stiffness"], DRIVE["damping"], 30.0
    rows = np.array([[1, d / k, mass / k, 1, 0], [0, 0, 1, 0, 1]])
    offset = np.array([mass * GRAVITY / k, GRAVITY])
    r = np.array([1e-12 / 12 + noise.transmission**2, SENSOR["noise_std"] ** 2])
    return f, q, rows, offset, np.diag(r)


def drawn(noise, rng, count=400, h=1e-3):
    """A recording of the cart drawn from the model itself, with its states."""
    f, q, rows, offset, r = slide_matrices(noise, h)
    start = [noise.position, noise.velocity, noise.initial_acceleration, noise.motor_bias, noise.acceleration_bias]
    x = np.array(start) * rng.standard_normal(5)
    jolt = noise.jerk * np.linalg.cholesky(jerk_noise(h))
    states, readings = np.empty((count, 5)), np.empty((count, 2))
    dtheta = 0.05 * rng.standard_normal(count)
    for i in range(count):
        if i:
            x = f @ x
            x[:3] += jolt @ rng.standard_normal(3)
            x[3:] += np.sqrt(np.diag(q)[3:]) * rng.standard_normal(2)
        states[i] = x
        readings[i] = rows @ x + offset + np.sqrt(np.diag(r)) * rng.standard_normal(2)
        readings[i, 0] -= DRIVE["damping"] / DRIVE["stiffness"] * dtheta[i]
    t = np.arange(count) * h
    return {"t": t, "theta_x": readings[:, 0], "dtheta_x": dtheta, "acc_z": readings[:, 1]}, states


def exact(values):
    """The same numbers, with 60 digits from here on."""
    return np.vectorize(Decimal, otypes=[object])(np.asarray(values, float))


def inverse(matrix):
    """Gauss and Jordan's, of a positive definite matrix."""
    n = len(matrix)
    a = np.hstack([matrix, exact(np.eye(n))])
    for k in range(n):
        a[k] = a[k] / a[k, k]
        for i in set(range(n)) - {k}:
            a[i] = a[i] - a[i, k] * a[k]
    return a[:, n:]


def textbook(noise, columns, mean, h=1e-3):
    """Kalman (1960) with matrix inverses, and Rauch, Tung and Striebel (1965) on it, in 60 digits."""
    with localcontext() as context:
        context.prec = 60
        f, q, rows, offset, r = map(exact, slide_matrices(noise, h))
        std = [noise.position, noise.velocity, noise.initial_acceleration, noise.motor_bias, noise.acceleration_bias]
        x, p = exact([mean, 0, 0, 0, 0.0]), np.diag(exact(std) ** 2)
        readings = np.stack([columns["theta_x"], columns["acc_z"]], axis=1)
        lag = exact(DRIVE["damping"]) / exact(DRIVE["stiffness"])
        out = {name: [] for name in ("before", "p_before", "x", "p", "nis", "log_likelihood")}
        for i, reading in enumerate(readings):
            if i:
                x, p = f @ x, f @ p @ f.T + q
            out["before"].append(x)
            out["p_before"].append(p)
            there = ~np.isnan(reading)
            if there.any():
                y = exact(np.nan_to_num(reading)) - offset
                y[0] += lag * exact(columns["dtheta_x"][i])
                h_there, r_there = rows[there], r[np.ix_(there, there)]
                s = h_there @ p @ h_there.T + r_there
                e = y[there] - h_there @ x
                gain = p @ h_there.T @ inverse(s)
                x, p = x + gain @ e, p - gain @ s @ gain.T
                out["nis"].append(e @ inverse(s) @ e)
                volume = np.linalg.slogdet(2 * np.pi * s.astype(float))[1]
                out["log_likelihood"].append(-0.5 * (float(out["nis"][-1]) + volume))
            out["x"].append(x)
            out["p"].append(p)
        xs, ps = [x], [p]
        for i in range(len(readings) - 2, -1, -1):
            gain = out["p"][i] @ f.T @ inverse(out["p_before"][i + 1])
            xs.append(out["x"][i] + gain @ (xs[-1] - out["before"][i + 1]))
            ps.append(out["p"][i] + gain @ (ps[-1] - out["p_before"][i + 1]) @ gain.T)
        out |= {"xs": xs[::-1], "ps": ps[::-1]}
    return {name: np.array(values).astype(float) for name, values in out.items()}


def close(ours, theirs, p, rtol):
    """Equal to a fraction of the standard deviation that goes with it."""
    scale = np.sqrt(np.diagonal(p, axis1=1, axis2=2))
    if ours.ndim == 3:
        scale = scale[:, :, None] * scale[:, None, :]
    assert np.abs((ours - theirs) / scale).max() < rtol


def rest(robot, columns):
    """Where the cart hangs at the first sample."""
    return columns["theta_x"][0] - 30.0 * GRAVITY / DRIVE["stiffness"]


@pytest.mark.parametrize("lost", [False, True])
def test_on_a_linear_robot_it_is_the_textbooks_filter_and_smoother(lost):
    robot = slide()
    columns, _ = drawn(NOISE, np.random.default_rng(1))
    if lost:
        columns["acc_z"][np.arange(400) % 4 != 0] = np.nan
        columns["theta_x"][100:140] = np.nan
    log = Log.from_table(columns, robot)
    book = textbook(NOISE, columns, rest(robot, columns))
    ours = ExtendedKalmanFilter(robot, NOISE, start="rest", tolerances=False).run(log, covariance=True)
    np.testing.assert_allclose(ours.state, book["x"], rtol=0, atol=1e-12)
    close(ours.covariance, book["p"], book["p"], 2e-12)
    some = ours.used > 0
    np.testing.assert_allclose(ours.nis[some], book["nis"], rtol=1e-8, atol=1e-10)
    assert ours.log_likelihood.sum() == pytest.approx(book["log_likelihood"].sum(), rel=1e-11)
    smooth = RauchTungStriebelSmoother(robot, NOISE, start="rest", tolerances=False).run(log, covariance=True)
    np.testing.assert_allclose(smooth.state, book["xs"], rtol=0, atol=1e-12)
    close(smooth.covariance, book["ps"], book["ps"], 1e-10)
    close(smooth.state[-1:], ours.state[-1:], ours.covariance[-1:], 1e-9)


def test_on_a_linear_robot_it_is_filterpys_filter_and_smoother():
    robot = slide()
    columns, _ = drawn(NOISE, np.random.default_rng(5), 200)
    f, q, rows, offset, r = slide_matrices(NOISE, 1e-3)
    peer = KalmanFilter(5, 2)
    peer.F, peer.Q, peer.H, peer.R = f, q, rows, r
    start = [NOISE.position, NOISE.velocity, NOISE.initial_acceleration, NOISE.motor_bias, NOISE.acceleration_bias]
    peer.x, peer.P = np.array([rest(robot, columns), 0, 0, 0, 0]), np.diag(np.square(start))
    readings = np.stack([columns["theta_x"], columns["acc_z"]], axis=1) - offset
    readings[:, 0] += DRIVE["damping"] / DRIVE["stiffness"] * columns["dtheta_x"]
    mean, covariance = [], []
    for i, reading in enumerate(readings):
        if i:
            peer.predict()
        peer.update(reading)
        mean.append(peer.x)
        covariance.append(peer.P)
    log = Log.from_table(columns, robot)
    ours = ExtendedKalmanFilter(robot, NOISE, start="rest", tolerances=False).run(log, covariance=True)
    np.testing.assert_allclose(ours.state, mean, rtol=0, atol=1e-12)
    close(ours.covariance, np.array(covariance), ours.covariance, 1e-9)
    smooth = RauchTungStriebelSmoother(robot, NOISE, start="rest", tolerances=False).run(log, covariance=True)
    theirs = peer.rts_smoother(np.array(mean), np.array(covariance))[:2]
    np.testing.assert_allclose(smooth.state, theirs[0], rtol=0, atol=1e-9)  # it inverts what is predicted
    close(smooth.covariance, theirs[1], smooth.covariance, 1e-4)


def test_smoothing_survives_half_a_second_without_readings():
    """Predicted variances are 10¹³ times the smoothed ones, so that no difference of them has a digit left."""
    robot, noise = slide(), NOISE.updated(jerk=2e3, transmission=1e-6, motor_bias=1e-6, motor_bias_walk=1e-7)
    columns, _ = drawn(noise, np.random.default_rng(6), 700)
    columns["theta_x"][100:600] = columns["acc_z"][100:600] = columns["dtheta_x"][100:600] = np.nan
    log = Log.from_table(columns, robot, check=False)
    columns["dtheta_x"][:] = 0.0
    log = dataclasses.replace(log, dtheta=np.zeros((700, 1)))
    book = textbook(noise, columns, rest(robot, columns))
    filtered = ExtendedKalmanFilter(robot, noise, start="rest", tolerances=False).run(log, covariance=True)
    smooth = RauchTungStriebelSmoother(robot, noise, start="rest", tolerances=False).run(log, covariance=True)
    assert book["p_before"][599, 0, 0] > 1e11 * book["ps"][599, 0, 0]
    variance, expected = (np.diagonal(p, axis1=1, axis2=2) for p in (smooth.covariance, book["ps"]))
    assert np.abs(variance / expected - 1).max() < 1e-6
    close(smooth.covariance, book["ps"], book["ps"], 1e-6)
    close(filtered.covariance, book["p"], book["p"], 1e-7)
    # No larger than the filtered one, to what the gap has left of both.
    assert (variance <= np.diagonal(filtered.covariance, axis1=1, axis2=2) * (1 + 1e-7)).all()
    scale = 1 / np.sqrt(variance)
    assert np.linalg.eigvalsh(smooth.covariance * scale[:, :, None] * scale[:, None, :]).min() > 0
    close(smooth.state, book["xs"], book["ps"], 1e-2)


def test_an_iterated_update_on_a_linear_robot_is_the_plain_update():
    robot = slide()
    log = Log.from_table(drawn(NOISE, np.random.default_rng(2))[0], robot)
    once, often = (
        ExtendedKalmanFilter(robot, NOISE, iterations=k, start="rest", tolerances=False).run(log, covariance=True)
        for k in (1, 4)
    )
    close(once.state, often.state, once.covariance, 1e-9)
    close(once.covariance, often.covariance, once.covariance, 1e-9)


def test_errors_and_innovations_are_as_large_as_it_says():
    """NEES and NIS over 60 recordings drawn from the model, within their 99 % bounds."""
    robot, rng = slide(), np.random.default_rng(3)
    nees, nis, runs, count = [], [], 60, 200
    for _ in range(runs):
        columns, states = drawn(NOISE, rng, count)
        # The filter starts where the first reading hangs; the truth starts about zero with the same spread.
        start = {"theta_x": np.concatenate([[30.0 * GRAVITY / DRIVE["stiffness"]], columns["theta_x"][1:]])}
        start["acc_z"] = np.concatenate([[np.nan], columns["acc_z"][1:]])
        noise = NOISE
        estimate = ExtendedKalmanFilter(robot, noise, start="rest", tolerances=False).run(
            Log.from_table(columns | start, robot), covariance=True
        )
        # The first motor reading was made up, so the bound is on what follows once it is forgotten.
        error = estimate.state[-1] - states[-1]
        nees.append(error @ np.linalg.solve(estimate.covariance[-1], error))
        nis.append(estimate.nis[50:].sum())
    low, high = scipy.stats.chi2.ppf([0.005, 0.995], 2 * (count - 50) * runs)
    assert low < sum(nis) < high
    # Biases and position are told apart by the prior alone; the made-up start costs them a little.
    assert sum(nees) < 1.3 * scipy.stats.chi2.ppf(0.995, 5 * runs)
    assert sum(nees) > 0.5 * 5 * runs


def reference(robot, log, noise, kinds, ekf, often=MappingProxyType({})):
    """The same filter with dense matrices and an inverse, its derivatives from differences of its own predictions.

    Samples are linearised as ``often`` says, or once (Bell and Cathey 1993).
    """
    n, m = robot.n, len(robot.acceleration_channels)
    arrays = noise.arrays(robot, kinds)
    dt, readings, dtheta, jerk = ekf.arrays(log, kinds)
    k = np.array([d.stiffness for d in robot.drives])
    d = np.array([d.damping for d in robot.drives])

    def predict(x, i):
        q, dq, ddq, motor_bias, bias = np.split(x, np.cumsum([n, n, n, n]))
        torsion = (robot.inverse_dynamics(q, dq, ddq) - d * (dtheta[i] - dq)) / k
        return np.concatenate([q + torsion + motor_bias, robot.specific_force(q, dq, ddq) + bias]), torsion

    def jacobian(x, i):
        step = 1e-5
        columns = [(predict(x + step * e, i)[0] - predict(x - step * e, i)[0]) / (2 * step) for e in np.eye(len(x))]
        return np.stack(columns, axis=1)

    states = []
    x = np.concatenate([rest_position(robot, log.theta[0]), np.zeros(3 * n + m)])
    p = np.diag(np.square(np.concatenate([arrays["initial"], arrays["initial_bias"]])))
    for i in range(len(log)):
        if i:
            h = dt[i]
            f, eye = np.eye(len(x)), np.eye(n)
            f[:n, n : 2 * n] = f[n : 2 * n, 2 * n : 3 * n] = h * eye
            f[:n, 2 * n : 3 * n] = h * h / 2 * eye
            q = np.zeros(f.shape)
            q[: 3 * n, : 3 * n] = np.kron(jerk_noise(h), np.diag(np.square(arrays["jerk"])))
            q[: 2 * n, : 2 * n] += np.diag(np.square(arrays["link_walk"])) * h
            decay, variance = bias_step(arrays, h)
            f[3 * n :, 3 * n :], q[3 * n :, 3 * n :] = np.diag(decay), np.diag(variance)
            u = np.concatenate([h**3 / 6 * jerk[i], h**2 / 2 * jerk[i], h * jerk[i], np.zeros(n + m)])
            x, p = f @ x + u, f @ p @ f.T + q
        prior = x
        for _ in range(often.get(i, 1)):
            rows, (prediction, torsion) = jacobian(x, i), predict(x, i)
            variance = np.square(arrays["reading"])
            variance[:n] += np.square(noise.torsion * torsion)
            s = rows @ p @ rows.T + np.diag(variance)
            gain = np.linalg.solve(s, rows @ p).T
            innovation = readings[i] - prediction - rows @ (prior - x)
            x = prior + gain @ innovation
        p = p - gain @ s @ gain.T
        states.append((x, np.sqrt(np.diag(p))))
    return states


def rest_position(robot, theta):
    q = theta.copy()
    for _ in range(100):
        q = theta - robot.gravity_torque(q) / np.array([d.stiffness for d in robot.drives])
    return q


@pytest.mark.parametrize("name", ["arm2_square", "kr15_six_axes"])
def test_on_recordings_it_is_the_dense_filter(name):
    robot, log = recording(name)
    log, noise = log[:150], Noise(jerk=20.0, position_walk=1e-4, velocity_walk=tuple(1e-3 * np.arange(1, robot.n + 1)))
    ekf = ExtendedKalmanFilter(robot, noise, start="rest", tolerances=False)
    ours = ekf.run(log, covariance=True)
    theirs = reference(robot, log, noise, ("motor", "acceleration"), ekf)
    for i, (x, std) in enumerate(theirs):
        assert np.abs((ours.state[i] - x) / std).max() < 1e-3  # the differences' own error
        assert np.abs(np.sqrt(np.diag(ours.covariance[i])) / std - 1).max() < 1e-4


def test_links_that_a_gap_leaves_uncertain_are_linearised_four_times():
    """One linearisation leaves an error that later readings contradict; iterated, the estimate is nearer the truth."""
    robot, log = recording("arm2_square")
    truth, rows, gap = Estimate.read(DATA / "arm2_square/truth.parquet"), np.r_[:700, 1100:1300], 700
    signals = {name: getattr(log, name)[rows] for name in ("t", "theta", "dtheta", "acceleration", "ddqref")}
    log, noise = dataclasses.replace(log, tau=None, **signals), Noise(jerk=100.0)
    ekf = ExtendedKalmanFilter(robot, noise, start="rest", tolerances=False)
    ours = ekf.run(log)
    once, iterated = (
        np.array([x[: robot.n] for x, _ in reference(robot, log, noise, ("motor", "acceleration"), ekf, often)])
        for often in ({}, {gap: 4})
    )
    assert (np.abs(ours.q - iterated)[: gap + 1] / ours.q_std[: gap + 1]).max() < 1e-2
    error, error_once = (np.abs(q - truth.q[rows])[gap].max() for q in (ours.q, once))
    assert error < 0.5 * error_once
    assert (ours.status == Status.GOOD).all()


LIMITS = {  # tool error with its offset out of filter and smoother, RMS [mm]
    "arm2_square": (0.0046, 0.0024),
    "demo": (0.043, 0.043),  # the hand gives, and the model has it rigid: the smoother gains nothing
    "kr15_long": (0.190, 0.184),
    "kr15_six_axes": (0.0039, 0.0024),
}


@pytest.mark.parametrize("name", LIMITS)
def test_tool_error_on_recordings(name):
    robot, log = recording(name)
    truth = (demo.FOLDER if name == "demo" else DATA / name) / "truth.parquet"
    methods = (ExtendedKalmanFilter, RauchTungStriebelSmoother)
    estimates = [method(robot, tolerances=False).run(log) for method in methods]
    filtered, smooth = (e.error_against(truth).tool_rms_centred for e in estimates)
    assert filtered < LIMITS[name][0]
    assert smooth < LIMITS[name][1]
    assert name == "demo" or smooth < filtered
    assert (estimates[1].q_std <= estimates[0].q_std * (1 + 1e-9)).all()


def test_motor_velocities_as_measurements_neither_harm_nor_pretend_to_know():
    robot, log = recording("arm2_square")
    truth = DATA / "arm2_square/truth.parquet"
    without, with_them = (
        ExtendedKalmanFilter(robot, dtheta=wanted, start="rest", tolerances=False).run(log) for wanted in (False, True)
    )
    assert (with_them.used == without.used + robot.n).all()
    assert with_them.channels[5:] == ("dtheta_axis2", "dtheta_axis3")
    assert with_them.error_against(truth).tool_rms_centred < 1.02 * LIMITS["arm2_square"][0]
    assert np.abs(with_them.q_std / without.q_std - 1).max() < 0.01


# Itself


def equal(a, b):
    return all(np.array_equal(a.columns()[c], b.columns()[c]) for c in a.columns())


@pytest.mark.parametrize("velocity", [True, False])
def test_run_step_and_pieces_are_the_same_bits(velocity):
    robot, log = recording("kr15_six_axes")
    log = log[:300] if velocity else dataclasses.replace(log[:300], dtheta=None)
    ekf = ExtendedKalmanFilter(robot, Noise(jerk=20.0), start="rest", tolerances=False)
    whole = ekf.run(log)
    parts = list(ekf.run_pieces(log[a : a + 77] for a in range(0, 300, 77)))
    assert equal(whole, type(whole).concatenate(parts))
    assert all(equal(whole, one) for one in ekf.run([log, log]))
    before = log.t[0] - log.period
    for i in range(300):
        dtheta = log.dtheta[i] if velocity else None
        dt = log.t[i] - before
        state = ekf.step(
            dt=dt, theta=log.theta[i], acceleration=log.acceleration[i], dtheta=dtheta, ddqref=log.ddqref[i]
        )
        before = log.t[i]
        for name in ("q", "dq", "ddq", "theta", "dtheta", "q_std", "tool_position", "tool_std", "nis", "status"):
            assert np.array_equal(getattr(state, name), getattr(whole, name)[i]), name
    assert np.array_equal(state.covariance, ekf.covariance)
    assert np.array_equal(state.state[:6], state.q)
    assert state.t == pytest.approx(log.t[299] - log.t[0])


def test_results_do_not_depend_on_the_processors_instructions():
    program = (
        "import hashlib; from linkside import *; r = Robot.load(demo.ROBOT); l = Log.read(demo.LOG, r)[:400];"
        "e = [m(r).run(l) for m in (ExtendedKalmanFilter, RauchTungStriebelSmoother, AccelerationObserver)];"
        "print([hashlib.sha256(x.q.tobytes() + x.dq.tobytes()).hexdigest() for x in e])"
    )
    assert len(outputs(program)) == 1


def with_nan(log, rows, channel):
    values = log.acceleration.copy()
    values[rows, channel] = np.nan
    return dataclasses.replace(log, acceleration=values)


def test_a_missing_channel_equals_a_robot_without_it():
    robot, log = recording("arm2_square")
    log = log[:500]
    settings = robot.config.model_dump(exclude={"urdf"})
    settings["accelerometers"][0]["axes"] = "xz"
    poorer = Robot.from_urdf(DATA / "arm2_square/robot.urdf", **settings)
    less = dataclasses.replace(log, acceleration=np.ascontiguousarray(log.acceleration[:, [0, 2]]))
    a = ExtendedKalmanFilter(robot, Noise(jerk=20.0), start="rest", tolerances=False).run(with_nan(log, slice(None), 1))
    b = ExtendedKalmanFilter(poorer, Noise(jerk=20.0), start="rest", tolerances=False).run(less)
    assert np.abs(a.q - b.q).max() < 1e-14
    assert np.array_equal(a.used, b.used)
    assert a.log_likelihood.sum() == pytest.approx(b.log_likelihood.sum(), rel=1e-12)


def test_a_second_without_readings_is_a_prediction_and_then_recovers():
    robot, log = recording("arm2_square")
    gone = slice(1000, 3000)
    theta = log.theta.copy()
    theta[gone] = np.nan
    log = dataclasses.replace(with_nan(log, gone, slice(None)), theta=theta)
    estimate = ExtendedKalmanFilter(robot, tolerances=False).run(log)
    predicted = (estimate.status & Status.PREDICTED) != 0
    assert np.array_equal(np.flatnonzero(predicted), np.arange(1000, 3000))
    assert (np.diff(estimate.q_std[gone], axis=0) > 0).all()
    assert estimate.q_std[3100].max() < 10 * estimate.q_std[900].max()


def test_an_outlier_is_gated_as_if_it_were_missing():
    robot, log = recording("arm2_square")
    log = log[:800]
    wrong = log.acceleration.copy()
    wrong[400, 0] += 100.0
    ekf = ExtendedKalmanFilter(robot, Noise(jerk=20.0), gate=30.0)
    gated, missing = ekf.run(dataclasses.replace(log, acceleration=wrong)), ekf.run(with_nan(log, 400, 0))
    assert gated.status[400] == Status.GATED
    assert np.flatnonzero(gated.status).tolist() == [400]
    assert np.array_equal(gated.q, missing.q)


def test_perfect_knowledge_at_the_start_stays_finite_and_precise_encoders_stay_positive():
    robot, log = recording("arm2_square")
    sure = Noise(jerk=20.0, motor_bias=0, acceleration_bias=0, position=0, velocity=0, initial_acceleration=0)
    assert np.isfinite(ExtendedKalmanFilter(robot, sure).run(log).q).all()
    sharp = Noise(jerk=1e4, transmission=0, torsion=0, motor_velocity=0, position=1.0, velocity=10.0)
    covariance = ExtendedKalmanFilter(robot, sharp, tolerances=False).run(log[:600], covariance=True).covariance
    assert np.array_equal(covariance, covariance.swapaxes(1, 2))
    scale = 1 / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.linalg.eigvalsh(covariance * scale[:, :, None] * scale[:, None, :]).min() > 0


def test_nothing_is_added_to_the_innovations_variance():
    """Sharp readings of one second: the posterior is the textbook's to the last digits, with no jitter on the way."""
    robot = slide()
    noise = NOISE.updated(transmission=1e-9)
    columns, _ = drawn(noise, np.random.default_rng(4), 50)
    book = textbook(noise, columns, rest(robot, columns))
    ours = ExtendedKalmanFilter(robot, noise, start="rest", tolerances=False).run(
        Log.from_table(columns, robot), covariance=True
    )
    close(ours.covariance, book["p"], book["p"], 1e-10)


# Bad input


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"gate": 0.0}, "gate is 0"),
        ({"gate": float("nan")}, "gate is NaN"),
        ({"iterations": 0}, "iterations is 0"),
        ({"biases": ["torque"]}, "'torque' is not one of"),
        ({"noise": Noise(jerk=(1.0, 2.0, 3.0))}, "jerk has 3 entries, expected 1 or 2"),
    ],
)
def test_settings_out_of_range_are_refused(arguments, message):
    robot, log = recording("arm2_square")
    with pytest.raises(EstimatorError, match=message):
        ExtendedKalmanFilter(robot, **arguments).run(log[:10])


@pytest.mark.parametrize("bad", [{"jerk": -1.0}, {"transmission": float("inf")}, {"acceleration": 0.0}, {"speed": 1.0}])
def test_noise_out_of_range_is_refused(bad):
    with pytest.raises(ValidationError):
        Noise(**bad)


def test_logs_that_cannot_be_filtered_are_refused():
    robot, log = recording("arm2_square")
    theta = log.theta.copy()
    theta[0, 1] = np.nan
    with pytest.raises(LogError, match="row 0: theta_axis3 is missing"):
        ExtendedKalmanFilter(robot).run(dataclasses.replace(log, theta=theta))
    wrong = log.acceleration.copy()
    wrong[70, 0] = np.inf
    with pytest.raises(NumericalError, match=r"log\.parquet.*sample 70"):
        ExtendedKalmanFilter(robot).run(dataclasses.replace(log, acceleration=wrong))
    with pytest.raises(LogError, match="torque_axis2"):
        ExtendedKalmanFilter(robot, torque=True).run(log)
    with pytest.raises(EstimatorError, match=r"theta has shape \(3,\), expected \(2,\)"):
        ExtendedKalmanFilter(robot).step(dt=5e-4, theta=[0, 0, 0])
