"""Limits of joints that a motion keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.files.yaml_source import suggest

from .robot import Robot
from .starter import ABSURD
from .tree import Joint


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of each joint, link side; infinite where there is none.

    Attributes
    ----------
    position : (2, n)
        Least and greatest position [rad, m].
    velocity, acceleration, torque : (n,)
        Greatest magnitudes [rad/s, rad/s², N m].
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
            A joint that there is not, or a limit that is none.
        """
        joints = [robot.tree.joint(name) for name in robot.names]
        position = np.array([_bounded(joint) for joint in joints]).T
        for name, (low, high) in (ranges or {}).items():
            if not low < high:
                raise EstimatorError(f"range of '{name}': {low:g} to {high:g} leave no position")
            position[:, joint_index(robot, name, "range")] = low, high
        return cls(
            position,
            _given(robot, "velocity", _plausible([joint.velocity for joint in joints]), velocity),
            _given(robot, "acceleration", np.full(robot.n, np.inf), acceleration),
            _given(robot, "torque", _plausible([joint.torque for joint in joints]), torque),
        )


def _bounded(joint: Joint) -> tuple[float, float]:
    """Limits of a URDF on a position; equal ones stand for none."""
    low, high = joint.limits
    return (low, high) if low < high else (-np.inf, np.inf)


def _plausible(limits: Sequence[float]) -> FloatArray:
    """Limits of a URDF; zero and what is too large stand for none."""
    values = np.array(limits)
    return np.where((values > 0) & (values < ABSURD), values, np.inf)


def _given(robot: Robot, what: str, limits: FloatArray, given: Mapping[str, float] | None) -> FloatArray:
    for name, value in (given or {}).items():
        if not 0 < value < np.inf:
            raise EstimatorError(f"{what} of '{name}': expected a limit greater than 0, got {value:g}")
        limits[joint_index(robot, name, what)] = value
    return limits


def joint_index(robot: Robot, name: str, what: str) -> int:
    """Find a joint that a user names, of ``what``."""
    if name not in robot.names:
        raise EstimatorError(f"{what}: no joint '{name}'; {suggest(name, robot.names)}")
    return robot.names.index(name)
