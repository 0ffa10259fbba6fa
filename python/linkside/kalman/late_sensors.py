"""Filters and delays inside accelerometers and gyroscopes, as the core makes states of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkside.channels import CHANNELS
from linkside.robot import Robot

Inside = tuple[float, float, int]
"""Time constant [s], delay [s], and how many steps of time the delay can have."""


def is_late(robot: Robot) -> bool:
    """Whether an accelerometer or a gyroscope has a filter or a delay inside."""
    return any(sensor.corner_frequency or sensor.delay for sensor in (*robot.accelerometers, *robot.gyroscopes))


def inside(robot: Robot, kinds: Sequence[str], period: float) -> list[Inside | None]:
    """What is inside the sensor of each channel of ``kinds``, sampled every ``period`` [s]."""
    sensors = {"acceleration": robot.accelerometers, "rate": robot.gyroscopes}
    channels: list[Inside | None] = []
    for kind in kinds:
        if kind in sensors:
            channels += [_inside(s.corner_frequency, s.delay, period) for s in sensors[kind] for _ in s.axes]
        else:
            channels += [None] * CHANNELS[kind].width(robot)
    return channels


def _inside(corner_frequency: float | None, delay: float, period: float) -> Inside | None:
    if not corner_frequency and not delay:
        return None
    time_constant = 1 / (2 * np.pi * corner_frequency) if corner_frequency else 0.0
    return time_constant, delay, int(np.ceil(delay / period)) + 1 if delay else 0
