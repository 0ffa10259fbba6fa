"""The links' state in the first sample: how uncertain it is, and what another one would explain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkside.arrays import FloatArray
from linkside.robot import Robot

from .prepared import Prepared
from .problem import HUBER
from .products import products

FIRST = 0.05
"""Length of the beginning of a recording that decides whether it starts in motion [s]."""

LEAST_START, LEAST_SPEED = 1e-4, 1e-3
"""Uncertainty of the links' first positions [rad] and velocities [rad/s], beside what gravity and motion make of it."""


def uncertain_start(robot: Robot, recordings: Sequence[Prepared]) -> FloatArray:
    """How far positions and velocities of links may be from rest on their springs at first, (2n,).

    By what gravity twists the springs, and by what the first motion of the motors may do besides.
    """
    stiffness = np.array([drive.stiffness or np.inf for drive in robot.drives])
    twist, speed = np.full(robot.n, LEAST_START), np.full(robot.n, LEAST_SPEED)
    for recording in recordings:
        count = max(1, round(FIRST / recording.log.period))
        theta, dtheta, ddtheta = (recording.motors[name][:count] for name in ("theta", "dtheta", "ddtheta"))
        load = np.abs(robot.gravity_torque(theta)) + np.abs(robot.inverse_dynamics(theta, dtheta, ddtheta))
        twist = np.maximum(twist, load.max(axis=0) / stiffness)
        speed = np.maximum(speed, np.abs(dtheta).max(axis=0))
    return np.concatenate([twist, speed])


def restart(residual: FloatArray, start: FloatArray, std: FloatArray) -> FloatArray:
    """By how much another start of the links, uncertain by ``std``, explains the residuals better."""
    e = np.nan_to_num(residual)
    weight = np.minimum(1.0, HUBER / np.maximum(np.abs(e), HUBER))
    weighted = np.concatenate([start, e[:, :, None]], axis=2) * np.sqrt(weight)[:, :, None]
    gram = products(weighted.reshape(e.size, len(std) + 1))
    return np.asarray(np.linalg.solve(gram[:-1, :-1] + np.diag(1 / std**2), gram[:-1, -1]))
