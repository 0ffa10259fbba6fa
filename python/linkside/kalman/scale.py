"""Settings that are out of scale, to be named when numbers overflow."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np
from pydantic import BaseModel

from linkside.errors import NumericalError
from linkside.robot import Robot

LARGEST_NOISE = 1e7
"""No standard deviation of a robot's motion or sensors, in SI units, is as large."""

INERTIAS = (1e-8, 1e8)
"""Motor inertias [kg m²], reflected."""

STIFFNESSES = (1e-3, 1e12)
"""Stiffnesses [N m/rad]."""


def out_of_scale(robot: Robot, noise: BaseModel) -> Iterator[str]:
    """Name settings that no robot has, with their values."""
    for name, value in noise.model_dump().items():
        for one in np.ravel(np.asarray(value if value is not None else [], np.float64)):
            if abs(one) > LARGEST_NOISE:
                yield f"noise.{name} = {one:g}"
    for drive in robot.drives:
        for name, (low, high) in (("motor_inertia", INERTIAS), ("stiffness", STIFFNESSES)):
            given = getattr(drive, name)
            if given is not None and not low <= given <= high:
                yield f"{name} of joint '{drive.name}' = {given:g}"


def blame_settings(error: NumericalError, robot: Robot, noise: BaseModel) -> NumericalError:
    """Name settings that are out of scale, if there are any, as the cause instead of readings."""
    named = list(out_of_scale(robot, noise))
    if not named:
        return error
    what = re.sub(r": look for .*", "", str(error))
    return NumericalError(f"{what}: settings are out of scale, {', '.join(named)}")
