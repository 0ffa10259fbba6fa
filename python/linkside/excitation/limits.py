"""Limits of joints that a planned motion keeps."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.files.yaml_source import suggest
from linkside.robot import Robot
from linkside.robot.starter import ABSURD
from linkside.robot.workspace import joint_limits


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of each joint, link side.

    Attributes
    ----------
    position : (2, n)
        Least and greatest position [rad, m].
    velocity, acceleration, torque : (n,)
        Greatest magnitudes, infinite where there is none [rad/s, rad/s², N m].
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    torque: FloatArray

    @classmethod
    def of(
        cls,
        robot: Robot,
        *,
        ranges: Mapping[str, tuple[float, float]] | None = None,
        velocity: Mapping[str, float] | None = None,
        acceleration: Mapping[str, float] | None = None,
        torque: Mapping[str, float] | None = None,
    ) -> Limits:
        """Take positions, velocities and torques from the URDF, and from what is given by joint.

        Raises
        ------
        EstimatorError
            A joint that there is not, a limit that is none, a joint without a limit of velocity, or of both torque and
            acceleration.
        """
        position = joint_limits(robot)
        for name, (low, high) in (ranges or {}).items():
            if not low < high:
                raise EstimatorError(f"range of '{name}': {low:g} to {high:g} leave no position")
            position[:, _index(robot, name, "range")] = low, high
        own = [robot.model.getJointId(name) for name in robot.names]
        columns = [robot.model.joints[joint].idx_v for joint in own]
        stated = {"velocity": robot.model.velocityLimit[columns], "torque": robot.model.effortLimit[columns]}
        limits = {
            "velocity": _given(robot, "velocity", _plausible(stated["velocity"]), velocity),
            "acceleration": _given(robot, "acceleration", np.full(robot.n, np.inf), acceleration),
            "torque": _given(robot, "torque", _plausible(stated["torque"]), torque),
        }
        for j, name in enumerate(robot.names):
            if np.isinf(limits["velocity"][j]):
                raise EstimatorError(f"joint '{name}': the URDF has no limit of velocity; give one (velocity)")
            if np.isinf(limits["torque"][j]) and np.isinf(limits["acceleration"][j]):
                raise EstimatorError(
                    f"joint '{name}': the URDF has no limit of effort; give one (torque), or one of acceleration"
                )
        return cls(position, **limits)


def _plausible(values: FloatArray) -> FloatArray:
    """Limits of a URDF; zero and what is too large stand for none."""
    return np.where((values > 0) & (values < ABSURD), values, np.inf)


def _given(robot: Robot, what: str, limits: FloatArray, given: Mapping[str, float] | None) -> FloatArray:
    for name, value in (given or {}).items():
        if not 0 < value < np.inf:
            raise EstimatorError(f"{what} of '{name}': expected a limit greater than 0, got {value:g}")
        limits[_index(robot, name, what)] = value
    return limits


def _index(robot: Robot, name: str, what: str) -> int:
    if name not in robot.names:
        raise EstimatorError(f"{what}: no joint '{name}'; {suggest(name, robot.names)}")
    return robot.names.index(name)
