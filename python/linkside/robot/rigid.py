"""Poses and rigid bodies: rotation, translation, mass and inertia.

The arithmetic is element by element, so that the same numbers give the same bits on every processor; products of
matrices by BLAS do not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray

UPRIGHT = 1e-7
"""So near to a pitch of a quarter turn, roll and yaw are not told apart [rad]."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a frame is in another: rotation (3, 3) and translation (3,) [m]."""

    rotation: FloatArray
    translation: FloatArray

    @classmethod
    def neutral(cls) -> Pose:
        """Of a frame that coincides with the other."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def of(cls, xyz: Sequence[float], rpy: Sequence[float]) -> Pose:
        """At xyz [m], turned by roll, pitch, yaw about the fixed axes x, y, z, one after the other [rad]."""
        return cls(rotation(rpy), np.array(xyz, float))

    def __mul__(self, other: Pose) -> Pose:
        """Where a frame is that is at ``other`` in this one."""
        return Pose(product(self.rotation, other.rotation), self.act(other.translation))

    def act(self, point: FloatArray) -> FloatArray:
        """Where a point of this frame is, (3,) [m]."""
        return self.turn(point) + self.translation

    def turn(self, vector: FloatArray) -> FloatArray:
        """What a vector of this frame is in the other, (3,)."""
        return product(self.rotation, vector)


def rotation(rpy: Sequence[float]) -> FloatArray:
    """Rotation by roll, pitch, yaw about the fixed axes x, y, z, one after the other [rad], (3, 3)."""
    (sr, sp, sy), (cr, cp, cy) = map(math.sin, rpy), map(math.cos, rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def roll_pitch_yaw(turned: FloatArray) -> tuple[float, float, float]:
    """Angles of which `rotation` makes this matrix; no yaw where only it and roll together are determined [rad]."""
    flat = math.hypot(turned[0, 0], turned[1, 0])
    pitch = math.atan2(-turned[2, 0], flat)
    if flat < UPRIGHT:
        return math.atan2(-turned[1, 2], turned[1, 1]), pitch, 0.0
    return math.atan2(turned[2, 1], turned[2, 2]), pitch, math.atan2(turned[1, 0], turned[0, 0])


def product(left: FloatArray, right: FloatArray) -> FloatArray:
    """Product of a matrix (3, 3) with a matrix or a vector, always summed in the same order."""
    column = left[:, :, None] if right.ndim == 2 else left
    return np.asarray(column[:, 0] * right[0] + column[:, 1] * right[1] + column[:, 2] * right[2])


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body in some frame.

    Attributes
    ----------
    mass : float
        [kg].
    com : (3,)
        Centre of mass [m].
    inertia : (3, 3)
        About the centre of mass, in the axes of the frame [kg m²].
    """

    mass: float
    com: FloatArray
    inertia: FloatArray

    @classmethod
    def nothing(cls) -> Body:
        """No mass at all."""
        return cls(0.0, np.zeros(3), np.zeros((3, 3)))

    @classmethod
    def point(cls, mass: float, at: FloatArray) -> Body:
        """A mass [kg] at one point (3,) [m]."""
        return cls(mass, at, np.zeros((3, 3)))

    def __add__(self, other: Body) -> Body:
        """Both in one; a part is taken off by adding it with a negative mass and inertia."""
        for one, rest in ((self, other), (other, self)):
            if not one.mass and not one.inertia.any():
                return rest  # bit by bit
        mass = self.mass + other.mass
        share = 1 / mass if mass else 0.0
        apart = self.com - other.com
        spread = (self.mass * other.mass * share) * (
            (apart[0] * apart[0] + apart[1] * apart[1] + apart[2] * apart[2]) * np.eye(3)
            - apart[:, None] * apart[None, :]
        )
        com = (self.mass * self.com + other.mass * other.com) * share
        return Body(mass, com, self.inertia + other.inertia + spread)

    def seen_from(self, pose: Pose) -> Body:
        """Give the same body in the frame in which this one's is at ``pose``."""
        turned = product(product(pose.rotation, self.inertia), pose.rotation.T)
        return Body(self.mass, pose.act(self.com), (turned + turned.T) / 2)

    def scaled(self, factor: float) -> Body:
        """Give a body of the same shape, denser by a factor."""
        return Body(factor * self.mass, self.com, factor * self.inertia)
