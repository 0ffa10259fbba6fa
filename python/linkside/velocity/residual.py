"""Collisions by generalized momentum, on an estimated velocity.

De Luca and Mattone, "Actuator failure detection and isolation using generalized momenta", ICRA 2003; with the
velocity of Cristofaro and De Luca's observer instead of a measured one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy.signal import lfilter

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.requirements import refuse_unsupported

from .inertia import rigid_inertia

NOISE_TO_STD = 1.4826
"""Standard deviation of a normal variable whose median absolute value is one."""


@dataclass(frozen=True, eq=False)
class Residual:
    """External joint torques, and whether they exceed the noise.

    Attributes
    ----------
    t : (T,)
        Time [s].
    torque : (T, n)
        External torque on the joints, through a first-order filter [N m].
    threshold : (n,)
        A level that noise hardly ever exceeds [N m].
    collision : (T,)
        Whether a joint's residual is above its threshold.
    """

    t: FloatArray
    torque: FloatArray
    threshold: FloatArray
    collision: npt.NDArray[np.bool_]


def momentum_residual(
    robot: Robot,
    log: Log,
    estimate: Estimate,
    bandwidth: float = 50.0,
    *,
    side: Literal["motors", "links"] = "motors",
    quiet: tuple[float, float] | None = None,
    deviations: float = 6.0,
) -> Residual:
    """Find external torques from positions, torques and estimated velocities.

    Parameters
    ----------
    robot, log
        The robot and its recording.
    estimate
        Of a velocity observer, on the same ``side``.
    bandwidth
        Of the residual's filter [rad/s].
    quiet
        From when to when nothing touches the robot, for the threshold [s]; by default the whole recording, whose median
        a short contact does not change.
    deviations
        The threshold in standard deviations of the quiet residual.

    Raises
    ------
    EstimatorError
        An estimate of other rows than the log, or a setting out of its range.
    """
    refuse_unsupported(robot, "the momentum residual" + (" on the links" if side == "links" else ""))
    if len(estimate) != len(log) or len(log) < 2:
        raise EstimatorError(
            f"the estimate has {len(estimate)} rows, the log {len(log)}, expected as many and at least 2"
        )
    for name, value in (("bandwidth", bandwidth), ("deviations", deviations)):
        if not (np.isfinite(value) and value > 0):
            raise EstimatorError(f"{name} is {value}, expected a positive number")
    signal = "tau" if side == "motors" else "torque"
    log.require(signal, purpose="a momentum residual")
    q, dq = np.ascontiguousarray(estimate.q), np.ascontiguousarray(estimate.dq)
    momentum = np.einsum("tij,tj->ti", rigid_inertia(robot, q, side), dq)
    known = getattr(log, signal) + _forces(robot, q, dq, side)
    unknown = np.diff(momentum, axis=0) / log.period - 0.5 * (known[:-1] + known[1:])
    keep = np.exp(-bandwidth * log.period)
    filtered = np.asarray(lfilter([1 - keep], [1, -keep], np.vstack([np.zeros(robot.n), unknown]), axis=0))
    rows = np.ones(len(log), bool) if quiet is None else (log.t >= quiet[0]) & (log.t <= quiet[1])
    if not rows.any():
        raise EstimatorError(f"quiet is {quiet}, expected a stretch of the log, from {log.t[0]} to {log.t[-1]}")
    threshold = deviations * NOISE_TO_STD * np.median(np.abs(filtered[rows]), axis=0)
    return Residual(log.t, filtered, threshold, (np.abs(filtered) > threshold).any(axis=1))


def _forces(robot: Robot, q: FloatArray, dq: FloatArray, side: str) -> FloatArray:
    """Cᵀ q̇ - g - friction (T, n): what changes the momentum beside the torques."""
    coriolis = np.einsum("tji,tj->ti", robot.coriolis_matrix(q, dq), dq)
    motors = robot.motor_friction(dq) if side == "motors" else 0.0
    return np.asarray(coriolis - robot.gravity_torque(q) - robot.link_friction(dq) - motors)
