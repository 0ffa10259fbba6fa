"""The map from link accelerations to accelerometer readings, for the design of sensor sets.

Computed by Pinocchio, independently of the core. A reading is

    specific force = T_A(q) q̈ + W_A(q, q̇)        (De Luca, Schröder, Thümmel 2007, eqs. (8)–(11))

T_A being the sensors' Jacobian in sensor axes and W_A its centripetal part J̇ q̇ minus gravity; an ideal
accelerometer at rest reads +9.81 m/s² along the upward direction. Link accelerations follow from readings if
T_A has full column rank over the elastic joints; the acceleration of any other joint is known from its motor.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.sensors import AccelerometerConfig

from .result import Observability


@dataclass(frozen=True, eq=False)
class AccelerationMap:
    """Map from link accelerations to accelerometer readings in one state, and how well it can be inverted.

    Attributes
    ----------
    matrix : (M, n) array
        T_A, all joints in log order.
    bias : (M,) array
        W_A [m/s²].
    noise_std : (M,) array
        Standard deviation of each channel's noise [m/s²].
    channels : tuple of str
        Names of the M channels.
    joints : tuple of str
        Names of the n joints.
    elastic : (n,) array of bool
        Which joints' accelerations are unknown.
    """

    matrix: FloatArray
    bias: FloatArray
    noise_std: FloatArray
    channels: tuple[str, ...]
    joints: tuple[str, ...]
    elastic: NDArray[np.bool_]

    @cached_property
    def whitened(self) -> FloatArray:
        """Elastic columns of T_A, each row over its noise, (M, n_elastic) [1/(rad/s²)]."""
        return self.matrix[:, self.elastic] / self.noise_std[:, None]

    @cached_property
    def _seen(self) -> Observability:
        return Observability.of_maps(self.whitened[None])

    @property
    def singular_values(self) -> FloatArray:
        """Singular values of `whitened`, falling, 0 where nothing is seen, (n_elastic,) [1/(rad/s²)].

        One over the least is the standard deviation of the worst combination of link accelerations.
        """
        return np.asarray(self._seen.values[0])

    @property
    def condition(self) -> float:
        """Largest over least singular value; inf where some combination of accelerations leaves no trace."""
        return float(self._seen.condition[0])

    @property
    def worst_direction(self) -> FloatArray:
        """The combination of elastic joints' accelerations that is seen worst, a unit vector (n_elastic,)."""
        return np.asarray(self._seen.directions[0, -1]) if self.elastic.any() else np.zeros(0)

    @property
    def acceleration_std(self) -> FloatArray:
        """Standard deviation of each elastic joint's acceleration, (n_elastic,) [rad/s²]; inf where not seen."""
        return np.asarray(self._seen.joints[0])


def acceleration_map(robot: Robot, q: ArrayLike, dq: ArrayLike | None = None) -> AccelerationMap:
    """Map link accelerations to what a robot's accelerometers read.

    Parameters
    ----------
    robot
        With accelerometers, or without: then the map has no rows.
    q : (n,) array
        Link positions in log order [rad].
    dq : (n,) array, optional
        Link velocities [rad/s]; at rest if not given.

    Raises
    ------
    EstimatorError
        `q` or `dq` is not of shape (n,).
    """
    q = _state("q", q, robot.n)
    dq = _state("dq", np.zeros(robot.n) if dq is None else dq, robot.n)
    data = _kinematics(robot, q, dq)
    rows = [_rows(robot, data, sensor) for sensor in robot.accelerometers]
    return AccelerationMap(
        matrix=np.vstack([np.empty((0, robot.n)), *(matrix for matrix, _ in rows)]),
        bias=np.concatenate([np.empty(0), *(bias for _, bias in rows)]),
        noise_std=np.array([sensor.noise_std for sensor in robot.accelerometers for _ in sensor.axes]),
        channels=robot.acceleration_channels,
        joints=robot.names,
        elastic=robot.elastic,
    )


def _kinematics(robot: Robot, q: FloatArray, dq: FloatArray) -> Any:
    import pinocchio as pin

    data = robot.model.createData()
    position, velocity = robot.to_pinocchio(q), robot.velocity_to_pinocchio(dq)
    pin.forwardKinematics(robot.model, data, position, velocity, np.zeros(robot.model.nv))
    pin.computeJointJacobians(robot.model, data, position)
    return data


def _rows(robot: Robot, data: Any, sensor: AccelerometerConfig) -> tuple[FloatArray, FloatArray]:
    """Rows of one accelerometer, in sensor axes: T_A, and W_A from the classical acceleration at q̈ = 0."""
    import pinocchio as pin

    body, mounted = robot.tree.mount(sensor)
    joint, pose = body + 1, pin.SE3(mounted.rotation, mounted.translation)
    local = (robot.model, data, joint, pose, pin.ReferenceFrame.LOCAL)
    centripetal = pin.getFrameClassicalAcceleration(*local).linear
    gravity = (data.oMi[joint] * pose).rotation.T @ robot.model.gravity.linear
    axes = ["xyz".index(axis) for axis in sensor.axes]
    jacobian = pin.getFrameJacobian(*local).reshape(6, -1)[:3] @ robot.velocity_map  # flat for a single joint
    return jacobian[axes], (centripetal - gravity)[axes]


def _state(name: str, value: ArrayLike, n: int) -> FloatArray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (n,):
        raise EstimatorError(f"{name}: expected shape ({n},), got {array.shape}")
    return array
