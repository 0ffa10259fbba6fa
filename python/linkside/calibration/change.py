"""How much a calibration changes the path of the tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray
from linkside.robot import Robot

from .response import ResponseProblem

CERTAIN = 3.0
"""A change must be at least this many times its remaining uncertainty."""

NARROWED = 0.05
"""Unless that is no more than this share of what was uncertain by the tolerances of robot.yaml."""


@dataclass(frozen=True)
class Change:
    """Of the tool's path along recordings, of the links' positions where there is no tool; without its mean, RMS.

    Attributes
    ----------
    moved : float
        By how much it changes from robot.yaml to the outcome [m or rad].
    uncertain : float
        Its standard error at the outcome.
    before : float
        Its standard error by the tolerances of robot.yaml.
    """

    moved: float
    uncertain: float
    before: float

    @property
    def told(self) -> bool:
        """Whether the change is significant, or hardly any uncertainty remains."""
        return self.uncertain <= max(self.moved / CERTAIN, NARROWED * self.before)


def change(problem: ResponseProblem, z: FloatArray, covariance: FloatArray) -> Change:
    """Compare the outcome ``z``, uncertain by ``covariance`` (p, p), with robot.yaml."""
    robot = problem.robot
    root = np.linalg.cholesky(covariance)
    squares = np.zeros(3)
    for (start, _), (end, slopes) in zip(problem.paths(np.zeros(len(z))), problem.paths(z), strict=True):
        centre = _position(robot, end)
        # One standard error along each axis of the ellipsoid, as sigma points are laid.
        spreads = [
            sum(_square(_position(robot, end + slopes @ column) - centre) for column in matrix.T)
            for matrix in (root, np.eye(len(z)))
        ]
        squares += np.array([_square(_position(robot, start) - centre), *spreads]) / len(problem.logs)
    return Change(*np.sqrt(squares).tolist())


def _position(robot: Robot, q: FloatArray) -> FloatArray:
    return q if robot.tool is None else np.asarray(robot.tool_position(q))


def _square(path: FloatArray) -> float:
    return float(np.mean(np.sum((path - path.mean(axis=0)) ** 2, axis=1)))
