"""What holds of every estimator: `step` is `run`, wherever it starts; missing torques and slow encoders are bridged."""

import dataclasses
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from linkside import (
    AccelerationObserver,
    ElasticJointFilter,
    ElasticJointIteratedSmoother,
    ElasticJointSmoother,
    Estimate,
    EstimatorError,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    IteratedSmoother,
    Log,
    MarginalizedParticleFilter,
    MotorJerkFilter,
    MotorJerkNoise,
    MotorJerkSmoother,
    NicosiaTomeiObserver,
    Noise,
    ParticleFilter,
    RauchTungStriebelSmoother,
    ReducedOrderObserver,
    Robot,
    Status,
    UnscentedKalmanFilter,
    UnscentedSmoother,
)
from linkside.kalman.start import WINDOW

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
ROWS = 80
WANDERING = {"position_walk": 1e-6, "velocity_walk": 1e-4}


@cache
def recorded():
    """A robot, its recording, and the truth at the recording's samples."""
    robot = Robot.load(FOLDER / "robot.yaml")
    return robot, Log.read(FOLDER / "log.parquet", robot), Estimate.read(FOLDER / "truth.parquet")


@cache
def moving():
    """A stretch that begins where the robot is fastest."""
    robot, log, truth = recorded()
    fastest = int(np.abs(truth.dq).sum(axis=1).argmax())
    return robot, log[fastest : fastest + ROWS], truth[fastest : fastest + ROWS], truth[fastest - 1 : fastest]


def kalman(method, **settings):
    noise = Noise(jerk=30.0, **settings.pop("walks", {}))
    return lambda robot, start: method(robot, noise, start=start, **settings)


def motors(method):
    return lambda robot, start: method(robot, MotorJerkNoise(jerk=30.0), start=start, dtheta=True, tolerances=False)


def velocity(method):
    return lambda robot, start: method(robot, 200.0, start=start)


METHODS = {
    "observer": lambda robot, start: AccelerationObserver(robot, tolerances=False, start=start),
    "ekf": kalman(ExtendedKalmanFilter, tolerances=False),
    "ukf": kalman(UnscentedKalmanFilter, tolerances=False),
    "smoother": kalman(RauchTungStriebelSmoother, tolerances=False),
    "ukf-smoother": kalman(UnscentedSmoother, tolerances=False),
    "map": kalman(IteratedSmoother, tolerances=False),
    "elastic-ekf": lambda robot, start: ElasticJointFilter(robot, tolerances=False, start=start),
    "elastic-ckf": lambda robot, start: ElasticJointFilter(
        robot, tolerances=False, start=start, linearisation="cubature"
    ),
    "elastic-smoother": lambda robot, start: ElasticJointSmoother(robot, tolerances=False, start=start),
    "elastic-map": lambda robot, start: ElasticJointIteratedSmoother(robot, tolerances=False, start=start),
    "motor-ekf": motors(MotorJerkFilter),
    "motor-smoother": motors(MotorJerkSmoother),
    "particle": kalman(ParticleFilter, particles=60, tolerances=False),
    "marginalized": kalman(MarginalizedParticleFilter, particles=60, tolerances=False),
    "accelerations": kalman(
        MarginalizedParticleFilter, particles=60, tolerances=False, accelerations=True, walks=WANDERING
    ),
    "reduced-order": velocity(ReducedOrderObserver),
    "nicosia-tomei": velocity(NicosiaTomeiObserver),
}
OBSERVERS = ("observer", "reduced-order", "nicosia-tomei")
LIVE = [method for method in METHODS if not method.endswith(("smoother", "map"))]


def true_start(method):
    """The truth at the first sample as ``start`` takes it; of the observer of a period before."""
    robot, _, truth, before = moving()
    n = robot.n
    if method == "observer":
        return {name: getattr(before, name)[0] for name in ("theta", "q", "dtheta", "dq")}
    if method in OBSERVERS:
        return {"dq": truth.dq[0]}
    if method.startswith("elastic"):
        mean = np.concatenate([truth.q[0], truth.dq[0], truth.theta[0], truth.dtheta[0], np.zeros(n)])
        std = np.repeat([1e-5, 1e-3, 1e-5, 1e-3, 10.0], n)
    elif method.startswith("motor"):
        ddtheta = (truth.dtheta[1] - before.dtheta[0]) / (truth.t[1] - before.t[0])
        mean = np.concatenate([truth.q[0], truth.dq[0], truth.theta[0], truth.dtheta[0], ddtheta])
        std = np.repeat([1e-5, 1e-3, 1e-5, 1e-3, 1.0], n)
    else:
        ddq = (truth.dq[1] - before.dq[0]) / (truth.t[1] - before.t[0])
        mean, std = np.concatenate([truth.q[0], truth.dq[0], ddq]), np.repeat([1e-5, 1e-3, 1.0], n)
    return mean, np.diag(std**2)


def starts(method):
    return {"auto": "auto", "rest": "rest", "given": true_start(method)}


def samples(method, log):
    """A recording's samples as ``step`` takes them."""
    for i in range(len(log)):
        if method in ("reduced-order", "nicosia-tomei"):
            yield {"q": log.theta[i], "tau": log.tau[i]}
            continue
        sample = {"theta": log.theta[i], "acceleration": log.acceleration[i]}
        if method in ("observer", "elastic-ekf", "elastic-ckf"):
            sample["tau"] = log.tau[i]
        if method != "observer":
            sample |= {"dtheta": log.dtheta[i], "dt": log.t[i] - log.t[i - 1] if i else log.period}
        if method not in ("observer", "elastic-ekf", "elastic-ckf") and log.ddqref is not None:
            sample["ddqref"] = log.ddqref[i]
        yield sample


def stepped(estimator, method, log):
    return [estimator.step(**sample) for sample in samples(method, log)]


@pytest.mark.parametrize("method", METHODS)
def test_first_samples_or_a_given_state_tell_more_than_a_rest_that_is_none(method):
    robot, log, truth, _ = moving()
    off = {}  # an observer knows no velocity at its first row
    for name, start in starts(method).items():
        off[name] = np.abs(METHODS[method](robot, start).run(log).dq - truth.dq)[1 : WINDOW // 2].max()
    assert off["auto"] < 0.3 * off["rest"], off
    assert off["given"] < 0.3 * off["rest"], off


@pytest.mark.parametrize("start", ["auto", "rest", "given"])
@pytest.mark.parametrize("method", LIVE)
def test_step_is_run_wherever_it_starts(method, start):
    robot, log, *_ = moving()
    estimator = METHODS[method](robot, starts(method)[start])
    whole = estimator.run(log)
    pieces = list(estimator.run_pieces([log[:11], log[11:50], log[50:]]))
    assert np.array_equal(np.vstack([piece.q for piece in pieces]), whole.q)
    first = WINDOW if start == "auto" and method not in OBSERVERS else 0
    for _ in range(2):  # and once more, when it has forgotten
        states = stepped(estimator, method, log)
        for name in ("q", "dq"):
            live = np.array([getattr(state, name) for state in states])
            np.testing.assert_allclose(live[first:], getattr(whole, name)[first:], rtol=0, atol=1e-9)
        estimator.reset()


@pytest.mark.parametrize("start", ["rest", "given"])
def test_a_fixed_lag_starts_where_it_is_told(start):
    robot, log, *_ = moving()
    settings = {"start": starts("ekf")[start], "tolerances": False}
    smoother = FixedLagSmoother(robot, Noise(jerk=30.0), lag=10, **settings)
    late = [smoother.step(**sample) for sample in samples("ekf", log[:40])]
    smooth = RauchTungStriebelSmoother(robot, Noise(jerk=30.0), **settings).run(log[:40])
    np.testing.assert_allclose(late[-1].q, smooth.q[29], rtol=0, atol=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_start_that_is_none_is_refused(method):
    robot, log, *_ = moving()
    bad = {"dq": [0.0, np.nan]} if method in OBSERVERS else (np.zeros(3), np.eye(2))
    for start in ("moving", bad):
        with pytest.raises(EstimatorError, match="start"):
            METHODS[method](robot, start).run(log)


def test_a_cloud_starts_with_the_correlations_it_is_given():
    robot, log, *_ = moving()
    mean, covariance = true_start("particle")
    root = 0.3 * np.random.default_rng(0).standard_normal(covariance.shape) + np.eye(len(mean))
    std = np.sqrt(np.diag(covariance))
    covariance = std[:, None] * (root @ root.T) * std
    settings = {"start": (mean, covariance), "biases": (), "tolerances": False}
    exact = ExtendedKalmanFilter(robot, Noise(jerk=30.0), **settings).run(log, covariance=True)
    cloud = ParticleFilter(robot, Noise(jerk=30.0), particles=4000, collapse="flag", **settings)
    ours = cloud.run(log[:2], covariance=True)
    deviations = np.sqrt(np.diag(exact.covariance[0]))
    assert np.abs(ours.state[0] - exact.state[0]).max() < 1e-6
    assert np.abs((ours.covariance[0] - exact.covariance[0]) / np.outer(deviations, deviations)).max() < 1e-6
    assert not ours.reseeded.any()


def without(log, signal, rows):
    values = getattr(log, signal).copy()
    values[rows] = np.nan
    return dataclasses.replace(log, **{signal: values})


def bridged(estimate):
    return (estimate.status & Status.BRIDGED) != 0


@pytest.mark.parametrize("method", METHODS)
def test_missing_torques_are_bridged_and_uncertain_where_they_are_used(method):
    robot, log, truth = recorded()
    log, truth = log[:600], truth[:600]
    gap = slice(300, 390)
    whole = METHODS[method](robot, "auto").run(log)
    cut = METHODS[method](robot, "auto").run(without(log, "tau", gap))
    if method not in (*OBSERVERS, "elastic-ekf", "elastic-ckf", "elastic-smoother", "elastic-map"):
        assert np.array_equal(cut.q, whole.q)
        return
    assert bridged(cut)[gap].all()
    assert np.isfinite(cut.q).all()
    if cut.q_std is not None:
        assert (cut.q_std[gap][1:] > whole.q_std[gap][1:]).all()
        assert (np.abs(cut.q - truth.q)[gap] < 3 * cut.q_std[gap]).all()


@pytest.mark.parametrize("every", [5, 16])
@pytest.mark.parametrize("method", METHODS)
def test_slow_encoders_are_bridged_and_uncertain_in_between(method, every):
    robot, log, truth = recorded()
    log, truth = log[:600], truth[:600]
    rows = np.arange(len(log)) % every != 0
    whole = METHODS[method](robot, "auto").run(log)
    slow = METHODS[method](robot, "auto").run(without(log, "theta", rows))
    assert (bridged(slow) == rows).all()
    rms = [np.sqrt(np.mean((e.q - truth.q)[200:] ** 2, axis=0)) for e in (whole, slow)]
    assert (rms[1] < 3 * rms[0] + 2e-5).all(), rms
    if slow.q_std is not None:
        ratio = (slow.q_std / whole.q_std)[100:]
        assert (ratio.mean(axis=0) > 1.01).all()
        if not hasattr(slow, "effective"):  # of a cloud, chance is in it
            assert (ratio > 1).all()
        if not method.endswith(("smoother", "map")):
            assert (slow.q_std[100:][rows[100:]].mean(axis=0) > slow.q_std[100:][~rows[100:]].mean(axis=0)).all()
        assert (np.abs(slow.q - truth.q)[100:] < 3 * slow.q_std[100:]).all()
