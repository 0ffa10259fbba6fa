"""Feedforward torques for robots with elastic joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.requirements import refuse_unsupported

from .trajectories import Trajectory


@dataclass(frozen=True, eq=False)
class Desired:
    """A motion of the whole robot and the motor torques that produce it; arrays in log order.

    Attributes
    ----------
    t : (T,)
        Times [s].
    q, dq, ddq : (T, n)
        Links [rad, rad/s, rad/s²].
    theta, dtheta : (T, n)
        Motors, link side [rad, rad/s].
    tau : (T, n)
        Motor torques, link side [N m].
    """

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    theta: FloatArray
    dtheta: FloatArray
    tau: FloatArray

    @property
    def torsion(self) -> FloatArray:
        """Motors minus links, θ − q, (T, n) [rad]."""
        return self.theta - self.q


def derivative_order(robot: Robot) -> int:
    """Give the highest derivative of link positions that a robot's motor torque depends on.

    4 without damping and without inertial coupling, 3 with damping; a chain of ℓ coupled motors (model (2) of De Luca,
    Schröder and Thümmel, 2007) makes it 4 + 2ℓ and 3 + ℓ.
    """
    return _core.derivative_order(robot.core)


def inverse_dynamics(robot: Robot, trajectory: Trajectory) -> Desired:
    """Find the motor motion and torque with which a robot with elastic joints follows a trajectory exactly.

    The links' recursive Newton–Euler algorithm runs on power series in time, which gives the links' torques with all
    derivatives; each transmission, D δ̇ + K δ = r, then gives its motor. Link and motor friction, nonlinear springs
    and inertial coupling are accounted for where robot.yaml gives them. A joint that is damped starts from rest.

    Parameters
    ----------
    robot
        The robot.
    trajectory
        With derivatives up to `derivative_order` at least; its derivative before that must be continuous, for the
        motor's velocity not to jump. Two derivatives more make damped joints more exact between samples.

    Raises
    ------
    EstimatorError
        A trajectory that is not known, or not smooth, up to the derivative that the robot needs; other joints.
    """
    refuse_unsupported(robot, "inverse dynamics along a motion")
    if trajectory.derivatives.shape[2] != robot.n:
        raise EstimatorError(f"trajectory: {trajectory.derivatives.shape[2]} joints, the robot has {robot.n}")
    needed = derivative_order(robot)
    if trajectory.continuity < needed - 1:
        raise EstimatorError(
            f"trajectory: continuous up to derivative {trajectory.continuity}, this robot's torque needs derivative "
            f"{needed} and all below it continuous; from trajectories, take rest_to_rest(…, degree={2 * needed - 1}), "
            f"spline(…, continuity={needed - 1}) or smoother"
        )
    arrays = (np.ascontiguousarray(a, dtype=np.float64) for a in (trajectory.t, trajectory.derivatives))
    motors = _core.feedforward(robot.core, *arrays)
    return Desired(trajectory.t, trajectory.q, trajectory.dq, trajectory.ddq, **motors)
