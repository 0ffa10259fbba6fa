"""Response of the links to a change of their motors' reference: the closed loop, linearised along a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arrays import FloatArray
from linkside.control.linear import LinearRobot, sampled
from linkside.errors import EstimatorError
from linkside.robot import Robot

EVERY = 0.01
"""Time between the postures about which the loop is linear [s]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """How the links are to move: times (T,) [s], evenly spaced, and positions, velocities and accelerations (T, n)."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray

    def __post_init__(self) -> None:
        """Check shapes and times."""
        t, q = np.asarray(self.t, float), np.asarray(self.q, float)
        if t.ndim != 1 or q.ndim != 2 or len(q) != len(t) or len(t) < 3:
            raise EstimatorError(
                f"motion: expected times (T,) and positions (T, n) of 3 or more, got {t.shape}, {q.shape}"
            )
        for name in ("dq", "ddq"):
            if np.shape(getattr(self, name)) != q.shape:
                raise EstimatorError(f"motion: {name} has shape {np.shape(getattr(self, name))}, expected {q.shape}")
        if not all(np.isfinite(getattr(self, name)).all() for name in ("t", "q", "dq", "ddq")):
            raise EstimatorError("motion: a value is not finite")
        steps = np.diff(t)
        if not (steps > 0).all() or np.abs(steps - self.period).max() > 0.01 * self.period:
            raise EstimatorError("motion: times are not evenly spaced; `Log.resample` brings a recording to one rate")

    @classmethod
    def through(cls, t: npt.ArrayLike, q: npt.ArrayLike) -> Motion:
        """Differentiate positions twice, by a spline through them."""
        from scipy.interpolate import make_interp_spline

        times, positions = np.asarray(t, float), np.asarray(q, float)
        if times.ndim != 1 or positions.ndim != 2 or len(times) != len(positions) or len(times) < 6:
            raise EstimatorError(
                f"motion: expected times (T,) and positions (T, n) of 6 or more, got {times.shape}, {positions.shape}"
            )
        if not (np.isfinite(times).all() and np.isfinite(positions).all() and (np.diff(times) > 0).all()):
            raise EstimatorError("motion: times do not rise, or a value is not finite")
        spline = make_interp_spline(times, positions, k=5)
        return cls(times, positions, spline.derivative(1)(times), spline.derivative(2)(times))

    @property
    def period(self) -> float:
        """Time between samples [s]."""
        return float(self.t[-1] - self.t[0]) / (len(self.t) - 1)


class Loop:
    """Deviation of the links due to the second derivative v of a correction of the motors' reference: δq = G v.

    Motors follow a reference r by τ = k_p (r − θ) + k_d (ṙ − θ̇), held between samples. With r = motion + u and the
    state (free positions, their velocities, u, u̇) a correction u is smooth whatever v is.

    Parameters
    ----------
    robot
        The robot.
    motion
        About which it is linear.
    kp, kd : (n,)
        Gains on motors' positions and velocities.

    Attributes
    ----------
    core
        G, for the step of `linkside._core.LearningStep`.
    period
        Between samples [s].
    transition, entry : (postures, s, s) and (s, n)
        x₊ = A x + B v about each posture.
    posture : (T,)
        That of each sample.
    links, command, rate, torque : (n, s)
        Deviations of links, of the motors' reference and its velocity, and of torques, by x.
    """

    def __init__(self, robot: Robot, motion: Motion, kp: FloatArray, kd: FloatArray) -> None:
        n, self.period = robot.n, motion.period
        if motion.q.shape[1] != n:
            raise EstimatorError(f"motion: {motion.q.shape[1]} joints, the robot has {n}")
        every = max(1, round(EVERY / self.period))
        at = np.arange(0, len(motion.t), every)
        linear = LinearRobot.along(robot, motion.q[at], motion.dq[at], motion.ddq[at])
        free, held, _ = sampled(linear.a, linear.torque, self.period)
        motors = linear.free[:n]
        p, one = motors.shape[1], np.eye(n)
        a = np.zeros((len(at), 2 * p + 2 * n, 2 * p + 2 * n))
        a[:, : 2 * p, : 2 * p] = free - held @ np.hstack([kp[:, None] * motors, kd[:, None] * motors])
        a[:, : 2 * p, 2 * p :] = held @ np.hstack([np.diag(kp), np.diag(kd)])
        a[:, 2 * p :, 2 * p :] = np.block([[one, self.period * one], [0 * one, one]])
        largest = np.abs(np.linalg.eigvals(a[:, : 2 * p, : 2 * p])).max()
        if largest >= 1:
            raise EstimatorError(f"the loop is not stable with these gains: a pole of {largest:.6f} in the plane of z")
        self.transition, self.posture = a, np.arange(len(motion.t)) // every
        self.entry = np.vstack([np.zeros((2 * p, n)), self.period**2 / 2 * one, self.period * one])
        self.links = np.hstack([linear.free[n:], np.zeros((n, p + 2 * n))])
        self.command = np.hstack([np.zeros((n, 2 * p)), one, 0 * one])
        self.rate = np.hstack([np.zeros((n, 2 * p)), 0 * one, one])
        position, velocity = np.diag(kp), np.diag(kd)
        self.torque = np.hstack([-position @ motors, -velocity @ motors, position, velocity])
        self.core = self.seen(self.links)

    def seen(self, outputs: FloatArray) -> _core.LearningLoop:
        """Responses of other outputs of x, (n, s)."""
        return _core.LearningLoop(self.transition, self.posture.tolist(), self.entry, outputs)

    def correction(self, v: FloatArray) -> FloatArray:
        """Correction of the motors' reference, u (T, n), by v (T, n)."""
        return self.smooth(v)[0]

    def smooth(self, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Correction of the motors' reference and its velocity, u and u̇ (T, n), by v (T, n)."""
        zero = np.zeros((1, v.shape[1]))
        velocity = np.vstack([zero, np.cumsum(self.period * v, axis=0)[:-1]])
        return np.vstack([zero, np.cumsum(self.period * velocity + self.period**2 / 2 * v, axis=0)[:-1]]), velocity
