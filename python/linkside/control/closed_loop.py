"""The sampled closed loop of robot, observer and state feedback, linear about a posture at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.observers.acceleration import AccelerationObserver
from linkside.robot import Robot

from .linear import LinearRobot, sampled

ComplexArray = npt.NDArray[np.complex128]


def closed_loop_poles(
    observer: AccelerationObserver,
    gains: npt.ArrayLike,
    q: npt.ArrayLike,
    period: float,
    specimen: Robot | None = None,
) -> ComplexArray:
    """Poles of the sampled loop about a posture at rest; it is stable if all are inside the unit circle.

    The robot, rigid joints included, has its torque held between samples; the observer subtracts gravity from its
    accelerometers at its own estimate of the posture; the estimate is fed back. Dry friction and nonlinear springs are
    left out.

    Parameters
    ----------
    observer
        With the robot's model.
    gains : (n, 4 n)
        On θ, q, θ̇ and q̇.
    q : (n,)
        Posture [rad].
    period
        [s].
    specimen
        The real robot; by default the model.

    Returns
    -------
    poles : (p,)
        In the plane of z, the largest first. As rates [1/s] they are ``np.log(poles) / period``.

    Raises
    ------
    EstimatorError
        Gains or a specimen of other joints.
    """
    known, q, gains = observer.robot, np.asarray(q, float), np.asarray(gains, float)
    if (specimen or known).n != known.n or gains.shape != (known.n, 4 * known.n):
        raise EstimatorError(f"expected gains ({known.n}, {4 * known.n}) and a specimen of {known.n} joints")
    true, estimator, measure = (
        _Plant.of(specimen or known, q, period),
        _Estimator.of(observer, period),
        _measured_accelerations(observer, q),
    )
    coupling = known.coupling.T
    sizes = [len(true.transition), len(estimator.transition), known.n]
    x, predicted, measured = np.split(np.eye(sum(sizes)), np.cumsum(sizes)[:-1])

    z = predicted + estimator.gain @ (true.theta @ x - estimator.theta @ predicted)
    tau = -gains @ estimator.states @ (predicted if observer.form == "predictor" else z)
    x_next = true.transition @ x + true.held @ tau
    ddq = true.acceleration @ np.vstack([x_next, tau])
    coupled = tau - coupling @ (measured - estimator.bias @ z)
    held = estimator.transition @ z + estimator.held @ np.vstack([coupled, measured])
    own = estimator.ddq @ held
    now = own + measure @ np.vstack([true.q @ x_next - estimator.q @ held, ddq - own])
    change = now - measured
    after = held + estimator.ramp @ np.vstack([-coupling @ change, change])
    poles = np.linalg.eigvals(np.vstack([x_next, after, now]))
    return np.asarray(poles[np.argsort(-np.abs(poles))], np.complex128)


@dataclass(frozen=True)
class _Plant:
    """x₊ = transition x + held τ; motors θ and links q of x; q̈ = acceleration (x, τ). Rigid joints are links."""

    transition: FloatArray
    held: FloatArray
    acceleration: FloatArray
    theta: FloatArray
    q: FloatArray

    @classmethod
    def of(cls, robot: Robot, q: FloatArray, period: float) -> _Plant:
        zero = np.zeros((1, robot.n))
        linear = LinearRobot.along(robot, q[None], zero, zero)
        a, torque, free, n = linear.a[0], linear.torque[0], linear.free, robot.n
        transition, held, _ = sampled(a, torque, period)
        positions = np.hstack([free, np.zeros_like(free)])
        p = free.shape[1]
        acceleration = free[n:] @ np.hstack([a[p:], torque[p:]])
        return cls(transition, held, acceleration, positions[:n], positions[n:])


@dataclass(frozen=True)
class _Estimator:
    """z₊ = transition z + held (τ, q̈) + ramp (Δτ, Δq̈) + gain (θ − theta z), all joints; what of z is which state."""

    transition: FloatArray
    held: FloatArray
    ramp: FloatArray
    gain: FloatArray
    states: FloatArray
    ddq: FloatArray
    bias: FloatArray

    @property
    def theta(self) -> FloatArray:
        return self.states[: len(self.ddq)]

    @property
    def q(self) -> FloatArray:
        return self.states[len(self.ddq) : 2 * len(self.ddq)]

    @classmethod
    def of(cls, observer: AccelerationObserver, period: float) -> _Estimator:
        n, orders = observer.robot.n, [len(poles) for poles in observer.poles.values()]
        size, starts = sum(orders), np.cumsum([0, *orders])
        transition, gain = np.zeros((size, size)), np.zeros((size, n))
        held, ramp = np.zeros((2, size, 2 * n))
        states, ddq, bias = np.zeros((4 * n, size)), np.zeros((n, size)), np.zeros((n, size))
        for j, (drive, poles) in enumerate(zip(observer.robot.drives, observer.poles.values(), strict=True)):
            own = slice(starts[j], starts[j + 1])
            transition[own, own], held[own, [j, n + j]], ramp[own, [j, n + j]], gain[own, j] = _core.sampled_observer(
                observer.robot.core, j, poles, period
            )
            order = [0, 1, 2, 3] if drive.elastic else [0, 0, 1, 1]
            states[j + n * np.arange(4), starts[j] + np.array(order)] = 1.0
            if not drive.elastic:
                ddq[j, starts[j] + 2] = 1.0
            elif len(poles) == 5:
                bias[j, starts[j] + 4] = 1.0
        return cls(transition, held, ramp, gain, states, ddq, bias)


def _measured_accelerations(observer: AccelerationObserver, q: FloatArray) -> FloatArray:
    """Elastic joints' accelerations as measured, by the error of q and by all joints' q̈ that is unknown, (n, 2 n).

    By weighted least squares, damped where accelerometers tell too little; De Luca et al. (2007), eq. (12).
    """
    robot = observer.robot
    zero = np.zeros(robot.n)
    if observer.accelerations == "joints":
        return np.hstack([np.diag(zero), np.diag(robot.elastic.astype(float))])
    by_q, _, by_ddq = robot.core.specific_force_derivatives(q[None], zero[None], zero[None])[0]
    inverse = _core.acceleration_inverse(robot.core, q, observer.worst_acceleration_std)
    return np.asarray(inverse @ np.hstack([by_q, by_ddq]))
