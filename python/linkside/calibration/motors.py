"""How motors moved: positions smoothed by what their own noise allows, with velocity and acceleration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
import scipy.interpolate
import scipy.signal

from linkside.arrays import FloatArray
from linkside.recording.log import Log
from linkside.robot import Robot

from .signals import filled, without_spikes

CORNERS = (0.4, 2.0)
"""Corner frequencies that are tried: from this many Hz up to this share of the sampling rate."""

PER_OCTAVE = 6
SHORTEST = 16
"""Fewer samples are not smoothed."""

ALLOWED = 1.05
"""What smoothing removes may be larger than the encoder's noise by this factor."""

FOURTH = float(np.sqrt(70.0))
"""Factor by which fourth differences of white noise are larger than the noise."""

SHARE_OF_ENDS = 20
"""At most one part in this many of a recording is left out at either end."""

SHARE = 0.3
"""Of the accelerometers' noise, what the encoders' may make of what they should read."""


def motors(robot: Robot, log: Log, corners: Sequence[float]) -> dict[str, FloatArray]:
    """Give time, position, velocity and acceleration of all motors, nothing missing, as the core takes them.

    The smoother of a white jerk behind white noise is 1/(1 + (ω/ω_c)⁶), forwards and backwards a Butterworth filter of
    third order, with the ``corners`` of `quietest`, or near them [Hz].
    """
    pairs = zip(_uniform(robot, log).T, corners, strict=True)
    columns = [_smooth(x, corner, 1 / log.period) for x, corner in pairs]
    spline = scipy.interpolate.CubicSpline(log.t, np.stack(columns, axis=1))
    arrays = {"t": log.t, "theta": spline(log.t), "dtheta": spline(log.t, 1), "ddtheta": spline(log.t, 2)}
    return {name: np.ascontiguousarray(array, dtype=np.float64) for name, array in arrays.items()}


def measured_again(robot: Robot, log: Log, theta: FloatArray, rng: np.random.Generator) -> Log:
    """Give ``log`` with what the motors' encoders might as well have read along ``theta`` (T, n).

    Their steps begin elsewhere, so that they are passed at other times; noise beyond them is drawn again, and so is
    where links are for all that robot.yaml says: zeros and lost motion.
    """
    step, tolerances = robot.config.encoder.resolution, robot.config.tolerances
    noise = np.array([_noise(x, 0.0) for x in _uniform(robot, log).T])
    beyond = np.sqrt(np.maximum(noise**2 - step**2 / 12, 0.0))
    begin = step * rng.uniform(-0.5, 0.5, robot.n)
    off = np.hypot(tolerances.encoder_zero, tolerances.lost_motion) * rng.standard_normal(robot.n)
    steps = np.round((theta + begin + beyond * rng.standard_normal(theta.shape)) / step)
    return replace(log, theta=np.where(np.isnan(log.theta), np.nan, step * steps - begin + off))


def unsettled(log: Log, corners: Sequence[float]) -> int:
    """Samples at either end of a log where how motors moved is known less well: a period of the lowest corner."""
    return min(len(log) // SHARE_OF_ENDS, round(1 / (log.period * min(corners))))


def _uniform(robot: Robot, log: Log) -> FloatArray:
    """Motors' positions (T, n), what is missing or stands alone interpolated."""
    theta = without_spikes(log.theta, np.full(robot.n, robot.config.encoder.resolution))
    theta[0] = log.theta[0]
    return filled(theta)


def quietest(robot: Robot, log: Log, torque: bool = False) -> tuple[float, ...]:
    """Give the corner frequency for each motor's positions [Hz].

    The lowest is taken at which what smoothing takes away is still the encoder's noise (V. A. Morozov, Soviet Math.
    Dokl. 7, 1966), unless the acceleration of that noise is still far below what an accelerometer at an arm's length of
    1 m tells, or with ``torque`` the motor's own torque: vibration may be hidden in the encoder's steps and show there.
    """
    by_links = min((sensor.noise_std for sensor in robot.accelerometers), default=np.inf)
    inertia = [drive.motor_inertia or 0.0 for drive in robot.drives]
    by_torque = [robot.config.torque.noise_std / b if torque and b else np.inf for b in inertia]
    told = [SHARE * min(by_links, own) for own in by_torque]
    least = robot.config.encoder.resolution / np.sqrt(12)
    pairs = zip(_uniform(robot, log).T, told, strict=True)
    return tuple(_corner(x, least, own if np.isfinite(own) else 0.0, 1 / log.period) for x, own in pairs)


def _corner(values: FloatArray, least: float, told: float, rate: float) -> float:
    """Corner frequency [Hz] for one motor's positions, recorded at ``rate`` [Hz] with noise of at least ``least``.

    Noise whose acceleration is less than ``told`` [rad/s²] stays.
    """
    noise = _noise(values, least)
    high, low = CORNERS[0] * rate, CORNERS[1]
    lowest = high
    for corner in np.geomspace(high, low, max(2, round(PER_OCTAVE * np.log2(high / low)))).tolist():
        settled = round(rate / corner)
        taken = (_smooth(values, corner, rate) - values)[settled : len(values) - settled]
        accelerated = noise * (2 * np.pi) ** 2 * corner**2.5 * np.sqrt(0.4 / rate)
        few = len(taken) < len(values) // 2
        if few or accelerated < told or float(np.sqrt(np.mean(taken**2))) > ALLOWED * noise:
            break
        lowest = corner
    return lowest


def _noise(values: FloatArray, least: float) -> float:
    """Standard deviation of one encoder's noise, at least ``least``, by what a motion cannot be."""
    return max(least, float(np.median(np.abs(np.diff(values, 4)))) / 0.6745 / FOURTH)


def _smooth(values: FloatArray, corner: float, rate: float) -> FloatArray:
    """Filter one motor's positions forwards and backwards."""
    if len(values) < SHORTEST or corner > CORNERS[0] * rate:
        return values
    sections = _butterworth(corner, rate)
    padding = min(len(values) - 1, round(3 * rate / corner))
    # The filter goes on beyond the ends as if motion were turned round there: what moves is taken off before.
    moving = _through_ends(values, max(SHORTEST, round(rate / corner)))
    return np.asarray(moving + scipy.signal.sosfiltfilt(sections, values - moving, padtype="odd", padlen=padding))


@lru_cache(256)
def _butterworth(corner: float, rate: float) -> FloatArray:
    """Design the filter, once for each corner: the same are tried for every motor and every log."""
    return np.asarray(scipy.signal.butter(3, corner, fs=rate, output="sos"))


def _through_ends(values: FloatArray, window: int) -> FloatArray:
    """Give a polynomial with both ends' position, velocity and acceleration, as cubics through windows show them."""
    count = len(values)
    window = min(window, count)
    at = np.arange(window) / window
    basis = np.polynomial.polynomial.polyvander(at, 3)
    ends = [np.linalg.lstsq(basis, side, rcond=None)[0] for side in (values[:window], values[::-1][:window])]
    length = (count - 1) / window
    scale, mirror = np.array([1.0, length, 2 * length**2]), np.array([1.0, -1.0, 1.0])
    first, last = (side[:3] * scale for side in ends)
    quintic = scipy.interpolate.BPoly.from_derivatives([0.0, 1.0], [first, last * mirror])
    return np.asarray(quintic(np.linspace(0.0, 1.0, count)))
