"""Where a robot can be: limits of its joints, and postures spread over them."""

from __future__ import annotations

from typing import Any

import numpy as np

from linkside.arrays import FloatArray

from .robot import Robot

SAMPLES = 2**15
"""Postures over the workspace."""


def workspace(robot: Robot) -> FloatArray:
    """Postures over the workspace, evenly spread, (SAMPLES, n) [rad, m]; those of `check`."""
    low, high = joint_limits(robot)
    return np.asarray(low + sobol(2 * robot.n)[:, : robot.n] * (high - low))


def joint_limits(robot: Robot) -> FloatArray:
    """Least and largest position of each joint, (2, n); a turn, or 2 m, of one without limits."""
    rows = [_range(robot, name, slides) for name, slides in zip(robot.names, prismatic(robot), strict=True)]
    return np.array(list(zip(*rows, strict=True)))


def prismatic(robot: Robot) -> list[bool]:
    """Which joints slide instead of turning."""
    return [_model(robot, name).shortname().startswith("JointModelP") for name in robot.names]


def _range(robot: Robot, name: str, slides: bool) -> tuple[float, float]:
    """Limits of a joint; where there are none, or they leave more than a turn, one turn (or 1 m either way)."""
    joint, model = _model(robot, name), robot.model
    low, high = float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])
    turn = 1.0 if slides else np.pi
    bounded = joint.nq == 1 and 0 < high - low < (np.inf if slides else 2 * np.pi)
    return (low, high) if bounded else (-turn, turn)


def _model(robot: Robot, name: str) -> Any:
    return robot.model.joints[robot.model.getJointId(name)]


def sobol(dimensions: int) -> FloatArray:
    """The first `SAMPLES` points of Sobol's sequence in the unit cube."""
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(dimensions, scramble=False).random(SAMPLES))
