"""Filters and delays inside accelerometers, as the core makes states of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkside.channels import CHANNELS
from linkside.robot import Robot

Inside = tuple[float, float, int]
"""Time constant [s], delay [s], and how many steps of time the delay can have."""


def is_late(robot: Robot) -> bool:
    """Whether an accelerometer has a filter or a delay inside."""
    return any(sensor.corner_frequency or sensor.delay for sensor in robot.accelerometers)


def inside(robot: Robot, kinds: Sequence[str], period: float) -> list[Inside | None] | None:
    """What is inside the sensor of each channel of ``kinds``, sampled every ``period`` [s]; None where nothing is."""
    if not is_late(robot) or "acceleration" not in kinds:
        return None
    sensors = [_inside(s.corner_frequency, s.delay, period) for s in robot.accelerometers for _ in s.axes]
    nothing: dict[str, list[Inside | None]] = {kind: [None] * CHANNELS[kind].width(robot) for kind in kinds}
    return [entry for kind in kinds for entry in (sensors if kind == "acceleration" else nothing[kind])]


def _inside(corner_frequency: float | None, delay: float, period: float) -> Inside | None:
    if not corner_frequency and not delay:
        return None
    time_constant = 1 / (2 * np.pi * corner_frequency) if corner_frequency else 0.0
    return time_constant, delay, int(np.ceil(delay / period)) + 1 if delay else 0
