"""Limits that planning a motion needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.limits import Limits
from linkside.robot.workspace import joint_limits, prismatic


def complete(robot: Robot, limits: Limits) -> Limits:
    """Limit positions to a turn where limits leave more.

    Raises
    ------
    EstimatorError
        A joint without a limit of velocity, or of both torque and acceleration.
    """
    _require(robot, np.isfinite(limits.velocity), "velocity", "give one (velocity)")
    forces = np.isfinite(limits.torque) | np.isfinite(limits.acceleration)
    _require(robot, forces, "effort", "give one (torque), or one of acceleration")
    widest = np.where(prismatic(robot), np.inf, 2 * np.pi)
    bounded = np.diff(limits.position, axis=0)[0] < widest
    return replace(limits, position=np.where(bounded, limits.position, joint_limits(robot)))


def _require(robot: Robot, known: npt.NDArray[np.bool_], what: str, remedy: str) -> None:
    """Name the joints without a limit, all of them."""
    if not known.all():
        names = ", ".join(name for name, there in zip(robot.names, known, strict=True) if not there)
        joints = "joint" if np.count_nonzero(~known) == 1 else "joints"
        raise EstimatorError(f"{joints} {names}: the URDF has no limit of {what}; {remedy}")
