"""A recording as the likelihood takes it: readings as they were recorded, smooth derivatives of motor positions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import scipy.signal

from linkside.arrays import FloatArray
from linkside.kalman.jerk_driven import commanded_jerk
from linkside.kalman.noise import Noise
from linkside.recording.log import Log
from linkside.robot import Robot

SMOOTHING = 0.01
"""Length of the window in which motor positions are fitted by a cubic and differentiated [s]."""

HALF = 3
SPIKE = 10.0
"""A reading further than this from its neighbours, in their spread, stands alone; `HALF` of them on either side."""


def window(period: float) -> int:
    """Samples of the differentiating window: odd, at least seven."""
    return max(7, 2 * round(SMOOTHING / period / 2) + 1)


def filled(values: FloatArray) -> FloatArray:
    """Interpolate columns where a value is missing."""
    rows, known = np.arange(len(values)), ~np.isnan(values)
    columns = [np.interp(rows, rows[k], column[k]) for column, k in zip(values.T, known.T, strict=True)]
    return np.stack(columns, axis=1)


def derivative(values: FloatArray, period: float, order: int) -> FloatArray:
    """Differentiate columns by a cubic through each window (Savitzky and Golay 1964); NaN where a value was missing."""
    missing, whole = np.isnan(values), filled(values)
    length = min(window(period), len(values) - 1 + len(values) % 2)
    out = scipy.signal.savgol_filter(whole, length, min(3, length - 1), deriv=order, delta=period, axis=0)
    return np.where(missing, np.nan, out)


def without_spikes(values: FloatArray, least: FloatArray) -> FloatArray:
    """Leave out readings that stand alone: a filter would follow them for many samples.

    A reading is one if it differs from the median of the seven around it by more than ten times their spread, the
    median of absolute deviations, and by more than ten times ``least`` (F. R. Hampel, J. Am. Stat. Assoc. 69, 1974).
    """
    padded = np.pad(values, ((HALF, HALF), (0, 0)), mode="edge")
    around = np.lib.stride_tricks.sliding_window_view(padded, 2 * HALF + 1, axis=0)
    middle = np.median(around, axis=-1)
    spread = np.median(np.abs(around - middle[..., None]), axis=-1)
    return np.where(np.abs(values - middle) > SPIKE * np.maximum(1.4826 * spread, least), np.nan, values)


def signals(robot: Robot, log: Log) -> dict[str, Any]:
    """Arrays for the core; accelerometers with the bias and scale of robot.yaml put back on."""
    count = len(log)
    dt = np.diff(log.t, prepend=log.t[0] - log.period)
    bias, scale = robot.acceleration_errors
    readings = np.zeros((count, 0)) if log.acceleration is None else log.acceleration * scale + bias
    noise = np.array([sensor.noise_std for sensor in robot.accelerometers for _ in sensor.axes])
    theta = without_spikes(log.theta, np.full(robot.n, robot.config.encoder.resolution))
    theta[0] = log.theta[0]
    dtheta = derivative(theta, log.period, 1) if log.dtheta is None else log.dtheta
    arrays = {
        "t": log.t,
        "theta": theta,
        "dtheta": dtheta,
        "acceleration": without_spikes(readings, noise),
        "jerk": commanded_jerk(log, dt, None),
    }
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()} | {"period": log.period}


def noise_arrays(robot: Robot, log: Log, noise: Noise, free_bias: list[bool]) -> dict[str, Any]:
    """Noise of motors and accelerometers; a bias that is a parameter is not also an uncertain state."""
    steps = np.full(robot.n, robot.config.encoder.resolution)
    smooth = replace(log, theta=filled(without_spikes(log.theta, steps)))
    arrays = noise.for_log(smooth, robot).arrays(robot, ("motor", "acceleration"))
    for channel, free in enumerate(free_bias):
        arrays["initial_bias"][robot.n + channel] *= 0.0 if free else 1.0
    return arrays
