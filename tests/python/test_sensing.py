"""Filters and delays inside accelerometers: declared, they cost next to nothing; undeclared, a great deal."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from linkside import EstimatorError, ExtendedKalmanFilter, Log, RauchTungStriebelSmoother, Robot
from linkside.kalman.late_sensors import Schedule, unfiltered

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


def test_a_filter_undone_is_the_signal_a_lag_ago():
    period, corner = 5e-4, 100.0
    t = np.arange(400) * period
    robot = with_sensor(corner_frequency=corner)
    wave = np.sin(2 * np.pi * 5 * t)[:, None] * np.ones(len(robot.acceleration_channels))
    readings, lag, noise = unfiltered(robot, filtered(wave, corner, period), period)
    assert np.abs(readings[100:, 0] - np.sin(2 * np.pi * 5 * (t[100:] - lag[0]))).max() < 1e-4
    assert 0.45 * period < lag[0] < 0.5 * period
    assert (noise > 1).all()


def test_a_schedule_keeps_every_reading_once_in_order_of_time():
    t = np.arange(6) * 1.0
    schedule = Schedule(t, np.array([0.0, 2.5, 0.5]))
    readings = np.arange(18.0).reshape(6, 3)
    dt, spread, _, _ = schedule.spread((t, readings, readings[:, :1], readings[:, :1]), 1.0)
    assert (dt >= 0).all()
    assert np.isclose(dt[1:].sum(), 5.0)
    # The second channel's first three readings, and the third's first, are of before the first sample.
    for channel, lost in enumerate([0, 3, 1]):
        kept = spread[:, channel][~np.isnan(spread[:, channel])]
        assert np.array_equal(kept, readings[lost:, channel])


def test_rows_count_what_was_used_since_the_row_before():
    robot = with_sensor(delay=0.3 * LOG.period)
    estimate = ExtendedKalmanFilter(robot).run(LOG[:50], innovations=True)
    assert estimate.used.tolist() == [2] + [5] * 49
    assert not estimate.status.any()
    assert np.isfinite(estimate.innovation[1:]).all()


def test_what_needs_readings_in_order_says_so():
    robot = with_sensor(delay=1e-3)
    with pytest.raises(EstimatorError, match="call run on the whole log"):
        ExtendedKalmanFilter(robot).step(dt=5e-4, theta=LOG.theta[0])
    with pytest.raises(EstimatorError, match="call run on the whole log"):
        next(ExtendedKalmanFilter(robot).run_pieces([LOG]))
