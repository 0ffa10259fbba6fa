"""Limits of joints that a planned motion keeps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

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
            position[:, joint_index(robot, name, "range")] = low, high
        joints = [robot.tree.joint(name) for name in robot.names]
        limits = {
            "velocity": _given(robot, "velocity", _plausible([joint.velocity for joint in joints]), velocity),
            "acceleration": _given(robot, "acceleration", np.full(robot.n, np.inf), acceleration),
            "torque": _given(robot, "torque", _plausible([joint.torque for joint in joints]), torque),
        }
        _require(robot, np.isfinite(limits["velocity"]), "velocity", "give one (velocity)")
        forces = np.isfinite(limits["torque"]) | np.isfinite(limits["acceleration"])
        _require(robot, forces, "effort", "give one (torque), or one of acceleration")
        return cls(position, **limits)


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


def _require(robot: Robot, known: npt.NDArray[np.bool_], what: str, remedy: str) -> None:
    """Name the joints without a limit, all of them."""
    if not known.all():
        names = ", ".join(name for name, there in zip(robot.names, known, strict=True) if not there)
        joints = "joint" if np.count_nonzero(~known) == 1 else "joints"
        raise EstimatorError(f"{joints} {names}: the URDF has no limit of {what}; {remedy}")


def joint_index(robot: Robot, name: str, what: str) -> int:
    """Find a joint that a user names, of ``what``."""
    if name not in robot.names:
        raise EstimatorError(f"{what}: no joint '{name}'; {suggest(name, robot.names)}")
    return robot.names.index(name)
