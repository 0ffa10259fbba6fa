"""What of joints a calibration finds only by the links' response, put into a robot."""

from __future__ import annotations

from collections.abc import Mapping

from linkside.robot import Robot
from linkside.robot.joints import JointConfig

STRENGTHS = (0, 3, 5)
"""Of γ₁ … γ₆ of a link's friction, those that are torques or in proportion to them."""

OF_BEARINGS = ("viscous", "coulomb", "stribeck")
"""Of a bearing's friction, likewise."""


def with_links(robot: Robot, found: Mapping[tuple[str, int], float]) -> Robot:
    """Give the robot with play and friction of links as they were ``found``, by kind and joint."""
    joints = tuple(_of_joint(drive, j, found) for j, drive in enumerate(robot.drives))
    return Robot(robot.config.model_copy(update={"joints": joints}), robot.tree)


def _of_joint(drive: JointConfig, joint: int, found: Mapping[tuple[str, int], float]) -> JointConfig:
    factor = found.get(("link_friction", joint), 1.0)
    bearing = {key: factor * getattr(drive.bearing_friction, key) for key in OF_BEARINGS}
    bearing["coulomb"] += found.get(("link_coulomb", joint), 0.0)
    gap = found.get(("half_gap", joint), drive.backlash.half_gap)
    return drive.model_copy(
        update={
            "link_friction": tuple(x * factor if i in STRENGTHS else x for i, x in enumerate(drive.link_friction)),
            "bearing_friction": drive.bearing_friction.model_copy(update=bearing),
            "backlash": drive.backlash.model_copy(update={"half_gap": gap}),
        }
    )
