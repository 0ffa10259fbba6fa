"""Collisions by generalized momentum, on an estimated velocity.

De Luca and Mattone, "Actuator failure detection and isolation using generalized momenta", ICRA 2003; with the velocity
of an observer instead of a measured one. With elastic joints the momenta of a joint's motor and link are added, as in
De Luca, Albu-Schäffer, Haddadin and Hirzinger, "Collision detection and safe reaction with the DLR-III lightweight
manipulator arm", IROS 2006: the torque of the spring between them cancels.
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

from .inertia import motor_inertia

SIDES = ("motors", "links", "both")

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
    side: Literal["motors", "links", "both"] = "motors",
    quiet: tuple[float, float] | None = None,
    deviations: float = 6.0,
) -> Residual:
    """Find external torques from positions, torques and estimated velocities.

    Parameters
    ----------
    robot, log
        The robot and its recording.
    estimate
        Of a velocity observer, on the same ``side``; for both, of an observer or filter for elastic joints. External
        torques do not disturb the acceleration-driven observer; a filter that knows the links' dynamics they do.
    side
        Whose torques are in balance: ``"motors"`` with joints taken as rigid, ``"links"`` behind measured joint
        torques, or ``"both"``, motors and links that move apart. None of them needs a stiffness.
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
    if side not in SIDES:
        raise EstimatorError(f"side is {side!r}, expected one of {', '.join(map(repr, SIDES))}")
    refuse_unsupported(robot, "the momentum residual" + (" on the links" if side == "links" else ""))
    if len(estimate) != len(log) or len(log) < 2:
        raise EstimatorError(
            f"the estimate has {len(estimate)} rows, the log {len(log)}, expected as many and at least 2"
        )
    for name, value in (("bandwidth", bandwidth), ("deviations", deviations)):
        if not (np.isfinite(value) and value > 0):
            raise EstimatorError(f"{name} is {value}, expected a positive number")
    (torque,) = log.require("torque" if side == "links" else "tau", purpose="a momentum residual")
    # A drive holds its torque from one sample to the next; what a sensor reads changes in between.
    applied = _between(torque) if side == "links" else torque[:-1]
    known = applied + _between(_forces(robot, estimate, side))
    unknown = np.diff(_momentum(robot, estimate, side), axis=0) / log.period - known
    keep = np.exp(-bandwidth * log.period)
    filtered = np.asarray(lfilter([1 - keep], [1, -keep], np.vstack([np.zeros(robot.n), unknown]), axis=0))
    rows = np.ones(len(log), bool) if quiet is None else (log.t >= quiet[0]) & (log.t <= quiet[1])
    if not rows.any():
        raise EstimatorError(f"quiet is {quiet}, expected a stretch of the log, from {log.t[0]} to {log.t[-1]}")
    threshold = deviations * NOISE_TO_STD * np.median(np.abs(filtered[rows]), axis=0)
    return Residual(log.t, filtered, threshold, (np.abs(filtered) > threshold).any(axis=1))


def _between(samples: FloatArray) -> FloatArray:
    """Mean of each sample and the next (T - 1, n)."""
    return 0.5 * (samples[:-1] + samples[1:])


def _momentum(robot: Robot, estimate: Estimate, side: str) -> FloatArray:
    """Sum of M q̇ + S θ̇ of the links and Sᵀ q̇ + B θ̇ of the motors (T, n)."""
    q, dq = np.ascontiguousarray(estimate.q), np.ascontiguousarray(estimate.dq)
    links = np.einsum("tij,tj->ti", robot.mass_matrix(q), dq)
    if side == "links":
        return np.asarray(links)
    motors = dq if side == "motors" else estimate.dtheta
    return np.asarray(links + motors * motor_inertia(robot) + motors @ robot.coupling.T + dq @ robot.coupling)


def _forces(robot: Robot, estimate: Estimate, side: str) -> FloatArray:
    """Cᵀ q̇ - g - friction (T, n): what changes the momentum beside the torques."""
    q, dq = np.ascontiguousarray(estimate.q), np.ascontiguousarray(estimate.dq)
    coriolis = np.einsum("tji,tj->ti", robot.coriolis_matrix(q, dq), dq)
    links = coriolis - robot.gravity_torque(q) - robot.link_friction(dq)
    if side == "links":
        return np.asarray(links)
    return np.asarray(links - robot.motor_friction(dq if side == "motors" else estimate.dtheta))
