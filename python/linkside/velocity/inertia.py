"""Inertia of a robot whose joints are taken as rigid."""

from __future__ import annotations

from typing import Literal

import numpy as np

from linkside.arrays import FloatArray
from linkside.robot import Robot


def rigid_inertia(robot: Robot, q: FloatArray, side: Literal["motors", "links"] = "motors") -> FloatArray:
    """Inertia with rigid joints at positions (n,) or (T, n): M, and with ``"motors"`` B + S + Sᵀ [kg m²]."""
    mass: FloatArray = robot.mass_matrix(q)
    if side == "links":
        return mass
    return np.asarray(mass + np.diag(motor_inertia(robot)) + robot.coupling + robot.coupling.T)


def motor_inertia(robot: Robot) -> FloatArray:
    """Inertia of the motors, reflected through the gears; zero where robot.yaml has none (n,) [kg m²]."""
    return np.array([drive.motor_inertia or 0.0 for drive in robot.drives])
