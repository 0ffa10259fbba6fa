"""A robot with elastic joints, linear about a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray
from linkside.robot import Robot


@dataclass(frozen=True)
class LinearRobot:
    """ẋ = a x + torque τ of deviations from a motion, at each of T points of it.

    Left out are dry friction and what nonlinear springs have beside their stiffness.

    Attributes
    ----------
    a : (T, 2 p, 2 p)
        On x: positions that are free, then their velocities. Motors of elastic joints are free, and all links.
    torque : (T, 2 p, n)
        On motor torques.
    free : (2 n, p)
        Motors, then links, by what is free: motors of rigid joints are tied to their links.
    """

    a: FloatArray
    torque: FloatArray
    free: FloatArray

    @classmethod
    def along(cls, robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> LinearRobot:
        """Linearise about links that move so, (T, n) each."""
        n, count = robot.n, len(q)
        by_q, by_dq, mass = robot.inverse_dynamics_derivatives(q, dq, ddq)
        k, d, b = (_diagonal(robot, name) for name in ("stiffness", "damping", "motor_inertia"))
        friction = np.diag([drive.motor_friction.viscous for drive in robot.drives])
        free = np.eye(2 * n)
        rigid = np.flatnonzero(~robot.elastic)
        free[rigid, n + rigid] = 1.0
        free = free[:, np.concatenate([robot.elastic, np.ones(n, bool)])]
        inertia = free.T @ _blocks(count, b, robot.coupling.T, robot.coupling, mass) @ free
        spring = free.T @ _blocks(count, k, -k, -k, k + by_q) @ free
        damper = free.T @ _blocks(count, d + friction, -d, -d, d + by_dq) @ free
        p = free.shape[1]
        zero, one = np.zeros((count, p, p)), np.broadcast_to(np.eye(p), (count, p, p))
        lower = -np.linalg.solve(inertia, np.concatenate([spring, damper], axis=2))
        moved = np.linalg.solve(inertia, np.broadcast_to(free[:n].T, (count, p, n)))
        a = np.concatenate([np.concatenate([zero, one], axis=2), lower], axis=1)
        return cls(a, np.concatenate([np.zeros((count, p, n)), moved], axis=1), free)


def sampled(a: FloatArray, b: FloatArray, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Φ, and the responses to inputs held over a period and to their change on a straight line over it.

    Of one system, or of a stack of them.
    """
    from scipy.linalg import expm

    n, m = b.shape[-2:]
    both = np.zeros((*a.shape[:-2], n + 2 * m, n + 2 * m))
    both[..., :n, :n], both[..., :n, n : n + m] = period * a, period * b
    both[..., n : n + m, n + m :] = np.eye(m)
    response = expm(both)
    return response[..., :n, :n], response[..., :n, n : n + m], response[..., :n, n + m :]


def _blocks(count: int, a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    """[[a, b], [c, d]], each a matrix or one a point."""
    a, b, c, d = (np.broadcast_to(part, (count, *part.shape[-2:])) for part in (a, b, c, d))
    return np.concatenate([np.concatenate([a, b], axis=2), np.concatenate([c, d], axis=2)], axis=1)


def _diagonal(robot: Robot, name: str) -> FloatArray:
    return np.diag([getattr(drive, name) or 0.0 for drive in robot.drives])
