"""A recording as the likelihood takes it: readings as they were recorded, smooth derivatives of motor positions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.signal

from ..kalman import _jerk
from ..log import Log
from ..noise import Noise
from ..robot import Robot

FloatArray = npt.NDArray[np.float64]

SMOOTHING = 0.01
"""Over this time motor positions are taken for a cubic, to be differentiated [s]."""

TORQUE_DRIFT = 0.02
"""Initial bias of a motor torque, and its walk in one second, as a share of the torque's standard deviation."""


def window(period: float) -> int:
    """Samples of the differentiating window: odd, at least seven."""
    return max(7, 2 * round(SMOOTHING / period / 2) + 1)


def derivative(values: FloatArray, period: float, order: int) -> FloatArray:
    """Differentiate columns by a cubic through each window (Savitzky and Golay 1964); NaN where a value was missing."""
    missing = np.isnan(values)
    rows = np.arange(len(values))
    filled = np.array(
        [np.interp(rows, rows[~gap], column[~gap]) for column, gap in zip(values.T, missing.T, strict=True)]
    ).T
    length = min(window(period), len(values) - 1 + len(values) % 2)
    out = scipy.signal.savgol_filter(filled, length, min(3, length - 1), deriv=order, delta=period, axis=0)
    return np.where(missing, np.nan, out)


def signals(robot: Robot, log: Log, torque: bool) -> dict[str, Any]:
    """Arrays for the core; accelerometers with the bias and scale of robot.yaml put back on."""
    count = len(log)
    dt = np.diff(log.t, prepend=log.t[0] - log.period)
    bias, scale = robot.acceleration_errors
    readings = np.zeros((count, 0)) if log.acceleration is None else log.acceleration * scale + bias
    dtheta = derivative(log.theta, log.period, 1) if log.dtheta is None else log.dtheta
    none = np.zeros((count, 0))
    arrays = {
        "t": log.t,
        "theta": log.theta,
        "dtheta": dtheta,
        "ddtheta": derivative(log.theta, log.period, 2) if torque else none,
        "tau": log.tau if torque else none,
        "acceleration": readings,
        "jerk": _jerk(log, dt, None),
    }
    return {name: np.ascontiguousarray(array) for name, array in arrays.items()} | {"period": log.period}


def noise_arrays(robot: Robot, log: Log, noise: Noise, torque: bool, free_bias: list[bool]) -> dict[str, Any]:
    """Noise of motors, accelerometers and torques; a bias that is a parameter is not also an uncertain state."""
    kinds = ("motor", "acceleration", "torque") if torque else ("motor", "acceleration")
    arrays = noise.for_log(log).arrays(robot, kinds)
    n, m = robot.n, len(robot.acceleration_channels)
    for channel, free in enumerate(free_bias):
        arrays["initial_bias"][n + channel] *= 0.0 if free else 1.0
    if torque:
        assert log.tau is not None
        drift = TORQUE_DRIFT * np.nan_to_num(np.nanstd(log.tau, axis=0))
        arrays["reading"][n + m :] = _torque_noise(robot, log).tolist()
        arrays["initial_bias"][n + m :] = drift.tolist()
        arrays["bias_walk"][n + m :] = drift.tolist()
    return arrays


def _torque_noise(robot: Robot, log: Log) -> FloatArray:
    """The sensor's, and that of the motor acceleration from the encoder's steps."""
    impulse = np.zeros(4 * window(log.period))
    impulse[len(impulse) // 2] = robot.config.encoder.resolution / np.sqrt(12)
    spread = float(np.linalg.norm(derivative(impulse[:, None], log.period, 2)))
    inertia = np.array([drive.motor_inertia or 0.0 for drive in robot.drives])
    return np.hypot(robot.config.torque.noise_std, inertia * spread)
