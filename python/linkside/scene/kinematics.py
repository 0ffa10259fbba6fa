"""Where the bodies of a robot are, for many samples at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from linkside.arrays import FloatArray
from linkside.robot import Robot


@dataclass(frozen=True)
class Poses:
    """Poses in the base frame.

    Attributes
    ----------
    rotation : (T, 3, 3)
        Axes.
    translation : (T, 3)
        Origin [m].
    """

    rotation: FloatArray
    translation: FloatArray

    @property
    def quaternion(self) -> FloatArray:
        """The same rotations as x, y, z, w, (T, 4); NaN where they are not known."""
        known = np.asarray(np.isfinite(self.rotation).all(axis=(1, 2)))
        out = np.full((len(self.rotation), 4), np.nan)
        if known.any():
            out[known] = Rotation.from_matrix(self.rotation[known]).as_quat()
        return out


def body_poses(robot: Robot, q: FloatArray) -> dict[str, Poses]:
    """Where each joint's body is, positions q (T, n) in log order, by the joint's name; those of parents come first."""
    count = len(q)
    base = Poses(np.broadcast_to(np.eye(3), (count, 3, 3)), np.zeros((count, 3)))
    poses: dict[int, Poses] = {0: base}
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    positions = robot.joint_positions(q)
    for index in range(1, model.njoints):
        parent, placement = poses[model.parents[index]], model.jointPlacements[index]
        linear, angular = np.split(np.asarray(data.joints[index].S).reshape(6), 2)
        rotation = parent.rotation @ placement.rotation
        translation = parent.translation + parent.rotation @ placement.translation
        value = positions[model.names[index]]
        if linear.any():
            translation = translation + value[:, None] * (rotation @ linear)
        else:
            rotation = rotation @ _about(angular, value)
        poses[index] = Poses(rotation, translation)
    return {model.names[index]: pose for index, pose in poses.items() if index > 0}


def _about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations about an axis (Rodrigues), (T, 3, 3)."""
    cross = pin.skew(axis)
    sine, versine = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
