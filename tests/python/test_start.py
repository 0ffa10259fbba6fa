"""Where estimates start: at rest, in motion, or where they are told."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from linkside import (
    ElasticJointFilter,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    Log,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
    demo,
)
from linkside.kalman import filtering
from linkside.kalman.fixed_lag import FixedLagSmoother
from linkside.kalman.start import WINDOW, find_start

from .drawn import jerk_noise

DATA = Path(__file__).parents[1] / "data"
ROBOT = Robot.load(demo.ROBOT)
LOG, TRUTH = Log.read(demo.LOG, ROBOT), Estimate.read(demo.TRUTH)
FASTEST = int(np.abs(TRUTH.dq[:, 0]).argmax())
SLIDE = """<robot name="one"><link name="base"/><link name="cart"><inertial><mass value="30"/><inertia ixx="1" ixy="0"
ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link><joint name="x" type="prismatic"><parent link="base"/>
<child link="cart"/><axis xyz="1 0 0"/><limit effort="1" velocity="1" lower="-9" upper="9"/></joint></robot>"""


def ratio(estimate, true):
    """Error over its standard deviation, of the joints whose model is right."""
    return np.abs(estimate.q - true.q[:, : estimate.q.shape[1]])[:, :3] / estimate.q_std[:, :3]


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
@pytest.mark.parametrize("row", [FASTEST, FASTEST - 150])
def test_a_recording_cut_in_motion_is_as_good_as_the_whole(method, row):
    whole = method(ROBOT).run(LOG)
    cut = method(ROBOT).run(LOG[row : row + 400])
    error, usual = (np.abs(e.q - TRUTH.q[i : i + 400])[:, :3] for e, i in ((cut, row), (whole[row : row + 400], row)))
    assert error.max() < 1e-4
    assert error[100:].max() < 3 * usual[100:].max() + 1e-5
    assert ratio(cut, TRUTH[row : row + 400]).max() < 5


def test_step_starts_in_motion_too_and_is_run_once_the_first_samples_have_decided():
    log = LOG[FASTEST : FASTEST + 80]
    ekf = ExtendedKalmanFilter(ROBOT, Noise(jerk=30.0))
    whole = ekf.run(log)
    for i in range(80):
        dt = log.period if i == 0 else log.t[i] - log.t[i - 1]
        signals = {name: getattr(log, name)[i] for name in ("theta", "dtheta", "acceleration")}
        ddqref = None if log.ddqref is None else log.ddqref[i]
        state = ekf.step(dt=dt, ddqref=ddqref, **signals)
        std = np.sqrt(np.diag(ekf.covariance))[:3]
        assert (np.abs(state.q[:3] - TRUTH.q[FASTEST + i, :3]) < 6 * std).all(), i
        if i >= WINDOW:
            np.testing.assert_allclose(state.q, whole.q[i], rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, ElasticJointFilter])
def test_step_looks_for_its_start_only_when_samples_have_doubled(method, monkeypatch):
    counts = []

    def count(robot, readings, spread):
        counts.append(len(readings.t))
        return find_start(robot, readings, spread)

    monkeypatch.setattr(filtering, "find_start", count)
    live = method(ROBOT)
    for i in range(FASTEST, FASTEST + 50):
        signals = {name: getattr(LOG, name)[i] for name in ("theta", "dtheta", "acceleration", "tau")}
        if method is ExtendedKalmanFilter:
            del signals["tau"]
        live.step(dt=LOG.period, **signals)
    assert counts == [1, 2, 4, 8, 16, WINDOW]


def test_a_cart_that_starts_anywhere_is_as_uncertain_as_it_is_off():
    """Normalised errors (q, q̇, q̈) of carts that start with any velocity, by the motor alone."""
    drive = {"name": "x", "stiffness": 1e6, "motor_inertia": 5.0}
    robot = Robot.from_urdf(SLIDE, joints=[drive], encoder={"resolution": 1e-7})
    noise, rng, h, count = Noise(jerk=100.0, transmission=1e-5, torsion=0.0), np.random.default_rng(1), 1e-3, 60
    root = noise.jerk * np.linalg.cholesky(jerk_noise(h))
    f = np.array([[1, h, h * h / 2], [0, 1, h], [0, 0, 1]])
    found = {5: [], 59: []}
    for _ in range(60):
        x, states = np.array([0.0, rng.normal(0, 1), rng.normal(0, 5)]), []
        for _ in range(count):
            states.append(x)
            x = f @ x + root @ rng.standard_normal(3)
        states = np.array(states)
        theta = states[:, 0] + 30 / 1e6 * states[:, 2] + 1e-5 * rng.standard_normal(count)
        log = Log.from_table({"t": np.arange(count) * h, "theta_x": theta}, robot)
        estimate = ExtendedKalmanFilter(robot, noise, biases=(), tolerances=False).run(log, covariance=True)
        for row in found:
            error = estimate.state[row] - states[row]
            found[row].append(error @ np.linalg.solve(estimate.covariance[row], error))
    assert np.mean(found[5]) < 4.5
    assert 2.0 < np.mean(found[59]) < 4.2


def test_what_is_given_is_where_it_starts():
    n = ROBOT.n
    mean, covariance = (
        np.concatenate([TRUTH.q[FASTEST], TRUTH.dq[FASTEST], np.zeros(n)]),
        np.diag([1e-8] * 2 * n + [1.0] * n),
    )
    log = LOG[FASTEST : FASTEST + 50]
    told = ExtendedKalmanFilter(ROBOT, start=(mean, covariance)).run(log)
    assert np.abs(told.q - TRUTH.q[FASTEST : FASTEST + 50])[:, :3].max() < 1e-3
    for bad in ((mean[:4], covariance), (mean, -covariance), (mean * np.nan, covariance)):
        with pytest.raises(EstimatorError, match="start has"):
            ExtendedKalmanFilter(ROBOT, start=bad).run(log)
    with pytest.raises(EstimatorError, match="start is 'moving'"):
        ElasticJointFilter(ROBOT, start="moving")


def test_pieces_and_a_lag_start_where_the_whole_does():
    log, noise = LOG[FASTEST : FASTEST + 90], Noise(jerk=30.0)
    ekf = ExtendedKalmanFilter(ROBOT, noise)
    parts = list(ekf.run_pieces(log[a : a + 7] for a in range(0, 90, 7)))
    assert np.array_equal(np.vstack([part.q for part in parts]), ekf.run(log).q)
    lagged = FixedLagSmoother(ROBOT, noise, lag=10)
    for i in range(90):
        signals = {
            s: getattr(log, s)[i] for s in ("theta", "dtheta", "acceleration", "ddqref") if getattr(log, s) is not None
        }
        late = lagged.step(dt=log.t[i] - log.t[i - 1] if i else log.period, **signals)
    smooth = RauchTungStriebelSmoother(ROBOT, noise).run(log)
    np.testing.assert_allclose(late.q, smooth.q[79], rtol=0, atol=1e-9)


def test_a_robot_at_rest_starts_at_rest():
    folder = DATA / "arm2_square"
    robot = Robot.load(folder / "robot.yaml")
    log = Log.read(folder / "log.parquet", robot)[:50]
    still = {name: np.repeat(getattr(log, name)[:1], 50, axis=0) for name in ("theta", "acceleration")}
    log = dataclasses.replace(log, dtheta=np.zeros((50, 2)), **still)
    found, rest = (ExtendedKalmanFilter(robot, start=start).run(log) for start in ("auto", "rest"))
    assert np.array_equal(found.q, rest.q)
