"""Where the bodies and the tool of a robot are."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray

from .rigid import Pose
from .robot import Robot
from .tree import BASE


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
        from scipy.spatial.transform import Rotation

        known = np.asarray(np.isfinite(self.rotation).all(axis=(1, 2)))
        out = np.full((len(self.rotation), 4), np.nan)
        if known.any():
            out[known] = Rotation.from_matrix(self.rotation[known]).as_quat()
        return out

    def then(self, pose: Pose) -> Poses:
        """Poses of what is at ``pose`` in these frames."""
        return Poses(self.rotation @ pose.rotation, self.translation + self.rotation @ pose.translation)


def body_poses(robot: Robot, q: FloatArray) -> dict[str, Poses]:
    """Where each joint's body is, positions q (T, n) in log order, by the joint's name; those of parents come first."""
    base = Poses(np.broadcast_to(np.eye(3), (len(q), 3, 3)), np.zeros((len(q), 3)))
    poses: list[Poses] = []
    positions = robot.joint_positions(q)
    for joint in robot.tree.joints:
        at = (base if joint.parent == BASE else poses[joint.parent]).then(joint.placement)
        value = positions[joint.name]
        if joint.slides:
            at = Poses(at.rotation, at.translation + value[:, None] * (at.rotation @ joint.axis))
        else:
            at = Poses(at.rotation @ _about(joint.axis, value), at.translation)
        poses.append(at)
    return {joint.name: pose for joint, pose in zip(robot.tree.joints, poses, strict=True)}


def tool_jacobian(robot: Robot, q: FloatArray) -> tuple[Pose, FloatArray]:
    """Pose of a robot's tool at q (n,), and velocity and angular velocity of it by those of the joints, (6, n)."""
    assert robot.tool is not None
    tree, poses = robot.tree, list(body_poses(robot, q[None]).values())
    carrier, mounted = tree.mount(robot.tool)
    tool = poses[carrier].then(mounted)
    moves = np.zeros((6, len(tree.joints)))
    for index in tree.carriers(carrier):
        axis = poses[index].rotation[0] @ tree.joints[index].axis
        arm = tool.translation[0] - poses[index].translation[0]
        moves[:, index] = [*axis, 0, 0, 0] if tree.joints[index].slides else [*np.cross(axis, arm), *axis]
    by_joints = np.zeros((len(tree.joints), robot.n))
    for column, one in enumerate(np.eye(robot.n)):
        turned = robot.joint_velocities(one)
        by_joints[:, column] = [turned[joint.name] for joint in tree.joints]
    return Pose(tool.rotation[0], tool.translation[0]), moves @ by_joints


def _about(axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rotations about an axis (Rodrigues), (T, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    sine, versine = np.sin(angle)[:, None, None], (1 - np.cos(angle))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
