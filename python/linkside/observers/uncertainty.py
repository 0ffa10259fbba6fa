"""What an observer takes as not known exactly."""

from __future__ import annotations

from typing import Any

from linkside.robot import Robot
from linkside.robot.considered import considered, core_settings


def uncertainty(robot: Robot, *, tolerances: bool) -> dict[str, Any]:
    """Give the settings of an observer of the core that say how uncertain ``robot`` and its readings are."""
    config = robot.config
    wide = config.tolerances
    return core_settings(robot, considered(robot, motors=True) if tolerances else []) | {
        "encoder": [config.encoder.resolution / 12**0.5] * robot.n,
        "torque": [config.torque.noise_std] * robot.n,
        "bias": wide.bias if tolerances else 0.0,
        "scale": wide.scale if tolerances else 0.0,
    }
