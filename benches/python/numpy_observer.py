"""The acceleration-driven observer as one would write it with NumPy, SciPy and Pinocchio: a loop over samples.

De Luca, Schröder and Thümmel (2007), equation (12), sampled exactly; for linear springs, no inertial coupling,
sensors of three axes.
Independent of linkside's kernels: from `linkside.Robot` it takes the settings of robot.yaml alone.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg import expm

from linkside import Robot
from linkside.robot.joints import JointConfig
from linkside.robot.sensors import FrameConfig

Array = NDArray[np.float64]

CREEP = 2e-3  # below this speed dry friction fades out [rad/s]
WORST = 10.0  # accelerations known worse than this are damped [rad/s²]
DAMPED, BRIDGED = 1, 2


class NumpyObserver:
    """Joints in the order of the URDF; `poles` are functions of a joint's order, in its order."""

    def __init__(self, urdf: Path, robot: Robot, poles: Callable[[int], Array], period: float) -> None:
        self.model = pin.buildModelFromUrdf(str(urdf))
        self.sensors = [_add_frame(self.model, sensor) for sensor in robot.accelerometers]
        self.tool = _add_frame(self.model, robot.tool)
        self.weights = np.concatenate([np.full(3, 1 / s.noise_std) for s in robot.accelerometers])
        self.data = self.model.createData()
        self.elastic = robot.elastic
        self.columns = np.flatnonzero(robot.elastic)
        self.stiffness = np.array([d.stiffness if d.elastic else np.inf for d in robot.drives])
        self.coulomb = [d.motor_friction.coulomb if d.elastic else 0.0 for d in robot.drives]
        self.joints = [_sampled(drive, poles, period) for drive in robot.drives]

    def run(self, theta: Array, tau: Array, acceleration: Array) -> dict[str, Array]:
        """The columns of an estimate, from rest."""
        count, n = theta.shape
        out = {name: np.empty((count, n)) for name in ("q", "dq", "ddq", "theta", "dtheta")}
        out |= {"tool": np.empty((count, 3)), "status": np.zeros(count, np.uint8)}
        states = self._rest(theta[0])
        held, measured = np.zeros(n), np.zeros(n)
        for k in range(count):
            if k > 0:
                states = [
                    joint.transition @ x + joint.by_torque * held[j] + joint.by_acceleration * measured[j]
                    for j, (joint, x) in enumerate(zip(self.joints, states, strict=True))
                ]
            before = measured
            measured, out["status"][k] = self._joint_accelerations(states, acceleration[k], before)
            for j, joint in enumerate(self.joints):
                if k > 0:
                    states[j] += joint.by_change * (measured[j] - before[j])
                innovation = theta[k, j] - states[j][0]
                if not np.isnan(innovation):
                    states[j] = states[j] + joint.gain * innovation
                rate = states[j][2] if self.elastic[j] else states[j][1]
                if not np.isnan(tau[k, j]):
                    held[j] = tau[k, j] - self.coulomb[j] * rate / np.sqrt(rate * rate + CREEP * CREEP)
            self._write(out, k, states, measured)
        return out

    def _write(self, out: dict[str, Array], k: int, states: list[Array], measured: Array) -> None:
        for j, x in enumerate(states):
            out["theta"][k, j] = x[0]
            if self.elastic[j]:
                out["q"][k, j], out["dtheta"][k, j], out["dq"][k, j] = x[1:]
                out["ddq"][k, j] = measured[j]
            else:
                out["q"][k, j] = x[0]
                out["dq"][k, j] = out["dtheta"][k, j] = x[1]
                out["ddq"][k, j] = x[2]
        pin.forwardKinematics(self.model, self.data, out["q"][k])
        out["tool"][k] = pin.updateFramePlacement(self.model, self.data, self.tool).translation

    def _joint_accelerations(self, states: list[Array], reading: Array, before: Array) -> tuple[Array, int]:
        """Accelerations of all joints: of the rigid ones as estimated, of the elastic ones by damped least squares."""
        q, dq, ddq = (np.array([x[i] for x in self._links(states)]) for i in range(3))
        pin.forwardKinematics(self.model, self.data, q, dq, ddq)
        pin.computeJointJacobians(self.model, self.data, q)
        rows, known = zip(*map(self._sensor, self.sensors), strict=True)
        there = ~np.isnan(reading)
        weights = np.where(there, self.weights, 0.0)
        prior = np.zeros(len(self.columns)) if there.all() else before[self.columns]
        matrix = np.concatenate(rows)[:, self.columns] * weights[:, None]
        residual = np.where(there, reading - np.concatenate(known), 0.0) * weights - matrix @ prior
        left, sizes, right = np.linalg.svd(matrix, full_matrices=False)
        floor = np.maximum(sizes, 1 / WORST)
        ddq[self.columns] = prior + right.T @ (left.T @ residual * sizes / floor**2)
        return ddq, (0 if there.all() else BRIDGED) | (DAMPED if sizes[-1] < 1 / WORST else 0)

    def _links(self, states: list[Array]) -> Iterator[tuple[float, float, float]]:
        for elastic, x in zip(self.elastic, states, strict=True):
            yield (x[1], x[3], 0.0) if elastic else (x[0], x[1], x[2])

    def _sensor(self, frame: int) -> tuple[Array, Array]:
        """T_A (3, n), and what the sensor would read if no elastic joint accelerated (3,)."""
        model, data = self.model, self.data
        classical = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL).linear
        rotation = pin.updateFramePlacement(model, data, frame).rotation
        jacobian = pin.getFrameJacobian(model, data, frame, pin.LOCAL)[:3]
        return jacobian, classical - rotation.T @ model.gravity.linear

    def _rest(self, theta: Array) -> list[Array]:
        q = theta.copy()
        for _ in range(100):
            q = theta - pin.computeGeneralizedGravity(self.model, self.data, q) / self.stiffness
        return [
            np.array([a, b, 0, 0] if elastic else [a, 0, 0])
            for a, b, elastic in zip(theta, q, self.elastic, strict=True)
        ]


def _add_frame(model: pin.Model, sensor: FrameConfig) -> int:
    link = model.frames[model.getFrameId(sensor.link)]
    pose = link.placement * pin.SE3(pin.rpy.rpyToMatrix(*sensor.rpy), np.array(sensor.xyz))
    return model.addFrame(pin.Frame(f"frame {model.nframes}", link.parentJoint, pose, pin.FrameType.OP_FRAME))


@dataclass
class Sampled:
    """Transition, responses to torque, to acceleration and to its change, and gain of one joint."""

    transition: Array
    by_torque: Array
    by_acceleration: Array
    by_change: Array
    gain: Array


def _sampled(drive: JointConfig, poles: Callable[[int], Array], period: float) -> Sampled:
    a, inputs = _model(drive)
    n = len(a)
    block = np.zeros((n + 4, n + 4))
    block[:n, :n], block[:n, n : n + 2], block[n : n + 2, n + 2 :] = a * period, inputs * period, np.eye(2)
    exponential = expm(block)
    transition = exponential[:n, :n]
    gain = np.linalg.solve(transition, _ackermann(transition, np.exp(poles(n) * period)))
    return Sampled(transition, *(exponential[:n, n + k] for k in (0, 1, 3)), gain)


def _model(drive: JointConfig) -> tuple[Array, Array]:
    """Continuous-time A and inputs (torque, acceleration): states (θ, q, θ̇, q̇), or (θ, θ̇, θ̈) of a rigid joint."""
    if not drive.elastic:
        return np.eye(3, k=1), np.zeros((3, 2))
    k, d, b = drive.stiffness, drive.damping, drive.motor_inertia
    a, inputs = np.zeros((4, 4)), np.zeros((4, 2))
    a[0, 2] = a[1, 3] = inputs[3, 1] = 1
    a[2] = np.array([-k, k, -d - drive.motor_friction.viscous, d]) / b
    inputs[2, 0] = 1 / b
    return a, inputs


def _ackermann(transition: Array, poles: Array) -> Array:
    """Gain that gives Φ − L C the poles, the first state being measured."""
    n = len(transition)
    powers = [np.linalg.matrix_power(transition, k) for k in range(n + 1)]
    polynomial = sum(c * power for c, power in zip(np.poly(poles).real[::-1], powers, strict=True))
    observability = np.stack([power[0] for power in powers[:n]])
    return polynomial @ np.linalg.solve(observability, np.eye(n)[-1])
