"""What of the next repeat has limits: the motors' reference, its velocity and acceleration, and the motors' torques."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.limits import Limits

from .loop import Loop, Motion

KINDS = ("position", "velocity", "acceleration", "torque")
"""Signals with limits, in the order of the arrays (T, 4, n)."""

WANTED = ("position", "velocity", "acceleration", "torque against gravity")
"""What the motion needs at least of them."""

CLOSE = np.array([[1e-4], [1e-4], [1e-4], [1e-3]])
"""Share of a limit by which steps stay away from it, so that what is between blocks' ends does not pass it."""


@dataclass(frozen=True, eq=False)
class Bounds:
    """How far signals may deviate from those of the last repeat, (T, 4, n): from ``low`` to ``high``.

    ``close`` (4, n) is what steps stay away from limits.
    """

    low: FloatArray
    high: FloatArray
    close: FloatArray

    @classmethod
    def of(cls, limits: Limits, last: FloatArray) -> Bounds:
        """Bounds beside the signals of the last repeat, (T, 4, n)."""
        low, high = _stacked(limits)
        sizes = [np.where(np.isfinite(limit), np.abs(limit), 0.0) for limit in (low, high)]
        close = CLOSE * np.maximum(*sizes)
        return cls(low + close - last, high - close - last, close)

    def reachable(self) -> Bounds:
        """Bounds that the last repeat does not pass: where it was beyond a limit, no repeat may go further."""
        return replace(self, low=np.minimum(self.low, 0.0), high=np.maximum(self.high, 0.0))

    def passed(self, deviation: FloatArray) -> npt.NDArray[np.bool_]:
        """Which of them pass their bounds by more than rounding, (4, n)."""
        excess = np.maximum(deviation - self.high, self.low - deviation)
        return np.asarray((excess > self.close).any(axis=0))

    def share(self, deviation: FloatArray) -> float:
        """The largest part of a step that does not pass them, up to 1."""
        with np.errstate(divide="ignore", invalid="ignore"):
            up, down = (self.high + self.close) / deviation, (self.low - self.close) / deviation
        return float(min(1.0, up[deviation > 0].min(initial=1.0), down[deviation < 0].min(initial=1.0)))


class Signals:
    """Signals with limits, and how they deviate by a step.

    Parameters
    ----------
    loop, motion, limits
        The closed loop, how links are to move, and the limits.

    Raises
    ------
    EstimatorError
        The motion itself is beyond a limit, or gravity is beyond that of a torque.
    """

    def __init__(self, robot: Robot, loop: Loop, motion: Motion, limits: Limits) -> None:
        self._loop, self._motion = loop, motion
        self._torque = loop.seen(loop.torque)
        wanted = np.stack([motion.q, motion.dq, motion.ddq, robot.gravity_torque(motion.q)], axis=1)
        _refuse_beyond(robot, motion, wanted, limits)

    def of(self, v: FloatArray, tau: FloatArray) -> FloatArray:
        """Signals of a repeat with this correction and these torques, (T, 4, n)."""
        motion = self._motion
        u, du = self._loop.smooth(v)
        return np.stack([motion.q + u, motion.dq + du, motion.ddq + v, tau], axis=1)

    def deviation(self, v: FloatArray) -> FloatArray:
        """How they deviate by a change of the correction's second derivative, (T, 4, n)."""
        u, du = self._loop.smooth(v)
        return np.stack([u, du, v, self._torque.answer(np.ascontiguousarray(v))], axis=1)


def _stacked(limits: Limits) -> tuple[FloatArray, FloatArray]:
    """Least and greatest values, (4, n)."""
    low, high = limits.position
    others = [limits.velocity, limits.acceleration, limits.torque]
    return np.stack([low, *(-limit for limit in others)]), np.stack([high, *others])


def _refuse_beyond(robot: Robot, motion: Motion, wanted: FloatArray, limits: Limits) -> None:
    """Raise where the motion without a correction is beyond a limit, with the torque that gravity alone takes."""
    low, high = _stacked(limits)
    beyond = np.argwhere((wanted < low) | (wanted > high))
    if len(beyond):
        i, kind, j = beyond[0]
        limit = low[kind, j] if wanted[i, kind, j] < low[kind, j] else high[kind, j]
        raise EstimatorError(
            f"motion: {WANTED[kind]} of {robot.names[j]} is {wanted[i, kind, j]:.4g} at {motion.t[i]:.4g} s, "
            f"beyond its limit of {limit:.4g}"
        )
