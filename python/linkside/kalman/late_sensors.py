"""Filters and delays inside sensors, as the core makes states of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkside.channels import CHANNELS
from linkside.robot import Robot
from linkside.robot.sensors import Lateness, ThreeAxes

Inside = tuple[float, float, int]
"""Time constant [s], delay [s], and how many steps of time the delay can have."""


def inside(robot: Robot, kinds: Sequence[str], period: float) -> list[Inside | None]:
    """What is inside the sensor of each channel of ``kinds``, sampled every ``period`` [s]."""
    return [_inside(sensor, period) for kind in kinds for sensor in sensors(robot, kind)]


def sensors(robot: Robot, kind: str) -> list[Lateness | None]:
    """What robot.yaml says of the sensor of each channel of a kind; None where it says nothing."""
    carriers: dict[str, Sequence[ThreeAxes]] = {
        "acceleration": robot.accelerometers,
        "rate": robot.gyroscopes,
        "position": robot.trackers,
    }
    if kind in carriers:
        return [sensor for sensor in carriers[kind] for _ in sensor.axes]
    if kind == "wrench":
        return [None] * len(robot.wrench_channels)
    of_joints = {"q": robot.config.link_encoder, "torque": robot.config.joint_torque}
    return [of_joints.get(kind)] * CHANNELS[kind].width(robot)


def _inside(sensor: Lateness | None, period: float) -> Inside | None:
    if sensor is None or not (sensor.corner_frequency or sensor.delay):
        return None
    time_constant = 1 / (2 * np.pi * sensor.corner_frequency) if sensor.corner_frequency else 0.0
    return time_constant, sensor.delay, int(np.ceil(sensor.delay / period)) + 1 if sensor.delay else 0
