"""Where a robot can be: limits of its joints, and postures spread over them."""

from __future__ import annotations

import numpy as np

from linkside.arrays import FloatArray

from .robot import Robot
from .tree import Joint

SAMPLES = 2**15
"""Postures over the workspace."""


def workspace(robot: Robot) -> FloatArray:
    """Postures over the workspace, evenly spread, (SAMPLES, n) [rad, m]; those of `check`."""
    low, high = joint_limits(robot)
    return np.asarray(low + sobol(2 * robot.n)[:, : robot.n] * (high - low))


def joint_limits(robot: Robot) -> FloatArray:
    """Least and largest position of each joint, (2, n); a turn, or 2 m, of one without limits."""
    rows = [_range(robot.tree.joint(name)) for name in robot.names]
    return np.array(list(zip(*rows, strict=True)))


def prismatic(robot: Robot) -> list[bool]:
    """Which joints slide instead of turning."""
    return [robot.tree.joint(name).slides for name in robot.names]


def _range(joint: Joint) -> tuple[float, float]:
    """Limits of a joint; where there are none, or they leave more than a turn, one turn (or 1 m either way)."""
    low, high = joint.limits
    turn = 1.0 if joint.slides else np.pi
    bounded = 0 < high - low < (np.inf if joint.slides else 2 * np.pi)
    return (low, high) if bounded else (-turn, turn)


def sobol(dimensions: int) -> FloatArray:
    """The first `SAMPLES` points of Sobol's sequence in the unit cube."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(dimensions, scramble=False).random(SAMPLES))
