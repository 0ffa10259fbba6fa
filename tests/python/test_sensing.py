"""Filters and delays inside accelerometers: declared, they cost next to nothing; undeclared, a great deal."""

import dataclasses
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from linkside import (
    ElasticJointFilter,
    ElasticNoise,
    ExtendedKalmanFilter,
    Log,
    Noise,
    RauchTungStriebelSmoother,
    Robot,
)

FOLDER = Path(__file__).parents[1] / "data/arm2_square"
ROBOT = Robot.load(FOLDER / "robot.yaml")
LOG = Log.read(FOLDER / "log.parquet", ROBOT)


def with_sensor(**inside):
    settings = ROBOT.config.model_dump(exclude={"urdf"})
    settings["accelerometers"][0].update(inside)
    return Robot.from_urdf(FOLDER / "robot.urdf", **settings)


def filtered(signal, corner, period):
    """A first-order filter fed on straight lines between samples, from rest: the textbook's recursion."""
    constant = 1 / (2 * np.pi * corner)
    alpha = np.exp(-period / constant)
    rest = (1 - alpha) * constant / period
    out = signal.copy()
    for k in range(1, len(signal)):
        out[k] = alpha * out[k - 1] + (rest - alpha) * signal[k - 1] + (1 - rest) * signal[k]
    return out


def tool_error(method, robot, log):
    return method(robot).run(log).error_against(FOLDER / "truth.parquet").tool_rms_centred


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
@pytest.mark.parametrize("corner", [60.0, 250.0])
def test_a_declared_filter_is_undone(method, corner):
    log = dataclasses.replace(LOG, acceleration=filtered(LOG.acceleration, corner, LOG.period))
    clean = tool_error(method, ROBOT, LOG)
    assert tool_error(method, ROBOT, log) > 1.8 * clean
    assert tool_error(method, with_sensor(corner_frequency=corner), log) < 1.2 * clean


@pytest.mark.parametrize("method", [ExtendedKalmanFilter, RauchTungStriebelSmoother])
def test_a_declared_delay_is_undone(method):
    rows = 4
    late = np.vstack([np.repeat(LOG.acceleration[:1], rows, axis=0), LOG.acceleration[:-rows]])
    log = dataclasses.replace(LOG, acceleration=late)
    clean = tool_error(method, ROBOT, LOG)
    assert tool_error(method, ROBOT, log) > 5 * clean
    assert tool_error(method, with_sensor(delay=rows * LOG.period), log) < 1.1 * clean


@pytest.mark.parametrize(
    "inside", [{"corner_frequency": 100.0}, {"delay": 2.6 * LOG.period}, {"corner_frequency": 60.0, "delay": 1e-3}]
)
def test_live_and_in_pieces_it_is_the_run(inside):
    robot, log = with_sensor(**inside), LOG[:40]
    noise = Noise(jerk=100.0)
    whole = ExtendedKalmanFilter(robot, noise).run(log, covariance=True)
    pieces = list(ExtendedKalmanFilter(robot, noise).run_pieces([log[:13], log[13:]]))
    assert np.array_equal(np.vstack([piece.q for piece in pieces]), whole.q)
    live = ExtendedKalmanFilter(robot, noise)
    for k in range(len(log)):
        dtheta = None if log.dtheta is None else log.dtheta[k]
        ddqref = None if log.ddqref is None else log.ddqref[k]
        sample = {"theta": log.theta[k], "acceleration": log.acceleration[k], "dtheta": dtheta, "ddqref": ddqref}
        state = live.step(dt=log.period, **sample)
    assert np.allclose(state.q, whole.q[-1], rtol=0, atol=1e-9)
    assert np.isclose(whole.used, robot.n + len(robot.acceleration_channels)).all()


def test_the_smoother_ends_where_the_filter_does():
    robot = with_sensor(corner_frequency=60.0, delay=2.3 * LOG.period)
    log = LOG[:60]
    forth = ExtendedKalmanFilter(robot, tolerances=False).run(log, covariance=True)
    back = RauchTungStriebelSmoother(robot, tolerances=False).run(log, covariance=True)
    assert np.allclose(back.state[-1], forth.state[-1], rtol=0, atol=1e-9)
    assert (
        np.diagonal(back.covariance, axis1=1, axis2=2) <= np.diagonal(forth.covariance, axis1=1, axis2=2) + 1e-12
    ).all()


def test_elastic_filters_take_late_sensors():
    robot = with_sensor(corner_frequency=60.0, delay=1e-3)
    estimate = ElasticJointFilter(robot).run(LOG[:60])
    assert np.isfinite(estimate.q).all()


@pytest.mark.parametrize(("method", "noise"), [(ExtendedKalmanFilter, Noise), (ElasticJointFilter, ElasticNoise)])
def test_a_tachometer_on_the_links_tells_their_velocity(method, noise):
    log = LOG[:300]
    truth = pq.read_table(FOLDER / "truth.parquet").to_pydict()
    dq = np.stack([np.interp(log.t, truth["t"], truth[f"dq_{name}"]) for name in ROBOT.names], axis=1)
    measured = dq + 3e-5 * np.random.default_rng(0).normal(size=dq.shape)
    plain = method(ROBOT).run(log)
    estimate = method(ROBOT, noise(link_velocity=3e-5)).run(dataclasses.replace(log, dq=measured))

    def rms(found):
        return np.sqrt(np.mean((found.dq - dq)[50:] ** 2))

    assert rms(estimate) < 0.5 * rms(plain)
    assert rms(estimate) < 3e-5
    assert (estimate.used - plain.used == ROBOT.n).all()
