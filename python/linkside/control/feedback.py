"""State feedback on the estimate: full state, or motors alone for comparison.

De Luca, Schröder and Thümmel (2007), eq. (13): τ = K_P (x_d − ξ) + τ_d with x = (θ, q, θ̇, q̇), ξ the observer's estimate
and τ_d from inverse dynamics.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from linkside._core import State
from linkside.arrays import FloatArray, Signal
from linkside.errors import EstimatorError
from linkside.observers.acceleration import AccelerationObserver
from linkside.observers.poles import damped
from linkside.robot import Robot
from linkside.robot.requirements import refuse_unsupported

from .closed_loop import closed_loop_poles
from .controllers import knots
from .feedforward import Desired

SLOW = 60.0
"""Frequency of the two slow closed-loop poles [rad/s]: near the frequency at which links swing on their springs."""

RIGID = 25.0
"""Frequency of a rigid joint's closed-loop poles [rad/s].

The observer gets no torque of rigid joints, so that estimation and control do not separate there: the loop swings up
at observer poles of about twice this frequency, and is well damped from four times on.
"""

LIMIT = 1.0 - 1e-6
"""Magnitude that no pole of the sampled loop may reach."""


def pole_placement(
    robot: Robot, q: npt.ArrayLike, slow: float = SLOW, fast: float | None = None, *, rigid: float = RIGID
) -> FloatArray:
    """Gains that place four poles for each elastic joint, two for each rigid one.

    Each joint is designed separately, with the link's inertia at `q`. Two poles are at ``slow``; the other two stay at
    the joint's resonance frequency, but are damped.

    Parameters
    ----------
    robot
        The robot.
    q : (n,)
        Working point [rad].
    slow, fast
        Frequencies of the pairs [rad/s]; ``fast`` is √(K (1/B + 1/M_ii)) by default.
    rigid
        Frequency of rigid joints' poles [rad/s]; at most a quarter of the observer's.

    Returns
    -------
    gains : (n, 4 n)
        On θ, q, θ̇ and q̇. A well-damped design may need negative ones on q or q̇.
    """
    if not all(0 < frequency < np.inf for frequency in (slow, rigid, fast or slow)):
        raise EstimatorError(f"poles: {slow}, {fast} and {rigid} rad/s, expected positive frequencies")
    blocks = np.zeros((4, robot.n))
    for joint, (drive, m) in enumerate(zip(robot.drives, _inertia(robot, q), strict=True)):
        b = drive.motor_inertia or 0.0
        if not drive.elastic or drive.stiffness is None:
            _, a1, a0 = np.poly(damped(rigid).poles(2)).real
            blocks[[0, 2], joint] = (m + b) * a0, (m + b) * a1
            continue
        k, d = drive.stiffness, drive.damping
        pairs = damped(slow).poles(4)[:2], damped(fast or np.sqrt(k / b + k / m)).poles(4)[2:]
        _, a3, a2, a1, a0 = np.poly(np.concatenate(pairs)).real
        theta = b * a2 - b * k / m - k - b * d / k * a1 + b * d**2 / k**2 * a0
        dtheta = b * a3 - b * d / m - d
        total, total_rate = b * m / k * a0, b * m / k * a1 - b * d * m / k**2 * a0
        blocks[:, joint] = theta, total - theta, dtheta, total_rate - dtheta
    return _diagonal(blocks)


def motor_only(robot: Robot, q: npt.ArrayLike, frequency: float = SLOW, *, rigid: float = RIGID) -> FloatArray:
    """Gains on θ and θ̇ alone, as for a rigid robot: poles for motor and link together, (n, 4 n).

    At ``frequency``, those of rigid joints at ``rigid`` [rad/s], as of `pole_placement`.
    """
    if not (0 < frequency < np.inf and 0 < rigid < np.inf):
        raise EstimatorError(f"poles: {frequency} and {rigid} rad/s, expected positive frequencies")
    _, a1, a0 = np.poly(damped(1.0).poles(2)).real
    omega = np.where(robot.elastic, frequency, rigid)
    total = _inertia(robot, q) + [drive.motor_inertia or 0.0 for drive in robot.drives]
    return _diagonal(np.stack([total * a0 * omega**2, 0 * total, total * a1 * omega, 0 * total]))


def lqr(
    robot: Robot, q: npt.ArrayLike, *, position: float = 1e-3, velocity: float = 0.05, torque: float = 50.0
) -> FloatArray:
    """Gains of the linear-quadratic regulator at a working point, all elastic joints together (SciPy).

    It weighs link positions, link velocities and torques by one over the square of their tolerable deviation. Rigid
    joints are as in `pole_placement`.

    Parameters
    ----------
    robot
        The robot.
    q : (n,)
        Working point [rad].
    position, velocity, torque
        Tolerable deviations [rad, rad/s, N m].

    Returns
    -------
    gains : (n, 4 n)
    """
    from scipy.linalg import solve_continuous_are

    if not min(position, velocity, torque) > 0:
        raise EstimatorError(f"lqr: tolerances {position}, {velocity}, {torque}, expected positive numbers")
    a, b = linearised(robot, q)
    e = b.shape[1]
    weights = np.repeat([0.0, position**-2.0, 0.0, velocity**-2.0], e)
    riccati = solve_continuous_are(a, b, np.diag(weights), np.eye(e) / torque**2)
    gains = pole_placement(robot, q)
    elastic = np.flatnonzero(robot.elastic)
    columns = np.concatenate([elastic + block * robot.n for block in range(4)])
    gains[np.ix_(elastic, columns)] = torque**2 * b.T @ riccati
    return gains


def linearised(robot: Robot, q: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
    """A (4 e, 4 e) and B (4 e, e) of ẋ = A x + B τ for the e elastic joints at rest at `q`, rigid ones held."""
    q = np.asarray(q, float)
    elastic, zero = robot.elastic, np.zeros(robot.n)
    drives = [drive for drive in robot.drives if drive.elastic]
    k, d, b = (np.diag([getattr(x, name) or 0.0 for x in drives]) for name in ("stiffness", "damping", "motor_inertia"))
    gravity, _, mass = (m[np.ix_(elastic, elastic)] for m in robot.inverse_dynamics_derivatives(q, zero, zero))
    s, none, one = robot.coupling[np.ix_(elastic, elastic)], np.zeros_like(k), np.eye(len(drives))
    inverse = np.linalg.inv(np.block([[b, s.T], [s, mass]]))
    lower = inverse @ np.block([[-k, k, -d, d], [k, -k - gravity, d, -d]])
    upper = np.block([[none, none, one, none], [none, none, none, one]])
    return np.vstack([upper, lower]), np.vstack([none, none, inverse @ np.vstack([one, none])])


class StateFeedback:
    """Torque from readings, one sample at a time: observer, feedback and feedforward.

    In simulation the core runs it: ``simulate(specimen, controller, …, feedback=controller.observer)``.

    Parameters
    ----------
    robot
        The robot's model.
    desired
        The desired motion, from `control.inverse_dynamics`, with a row a sample.
    gains : (n, 4 n)
        From `pole_placement`, `lqr` or `motor_only`.
    observer
        By default an `AccelerationObserver` of 250 rad/s.

    Raises
    ------
    EstimatorError
        Shapes that do not fit, or a loop that is unstable with this observer at this sampling rate.

    Attributes
    ----------
    estimate : State or None
        The observer's estimate at the last sample.
    """

    estimate: State | None = None

    def __init__(
        self, robot: Robot, desired: Desired, gains: npt.ArrayLike, observer: AccelerationObserver | None = None
    ) -> None:
        refuse_unsupported(robot, "state feedback")
        self.gains = np.array(gains, float)
        if self.gains.shape != (robot.n, 4 * robot.n) or not np.isfinite(self.gains).all():
            raise EstimatorError(f"gains: expected finite numbers ({robot.n}, {4 * robot.n}), got {self.gains.shape}")
        if len(desired.t) < 2 or desired.q.shape[1] != robot.n:
            raise EstimatorError(f"desired: expected 2 rows or more of {robot.n} joints, got {desired.q.shape}")
        period = float(desired.t[1] - desired.t[0])
        self.desired = desired
        self.observer = observer or AccelerationObserver(robot, period=period)
        for q in (desired.q[0], desired.q[-1]):
            _refuse_unstable(self.observer, self.gains, q, period)
        self._states = np.hstack([desired.theta, desired.q, desired.dtheta, desired.dq])
        self._torque = desired.tau[0].copy()
        self._row = 0

    def law(self, robot: Robot) -> dict[str, Any]:
        """Describe the controller to the core, for `simulate`; its state is what the simulation's feedback says."""
        if self.gains.shape[0] != robot.n:
            raise EstimatorError(f"controller is of {self.gains.shape[0]} joints, expected {robot.n}")
        rows = np.hstack([self._states, self.desired.tau])
        return {"states": knots(self.desired.t, rows, 5 * robot.n, "desired"), "gains": self.gains.ravel().tolist()}

    def step(self, *, theta: Signal, acceleration: Signal) -> FloatArray:
        """Take a sample's motor positions (n,) and accelerations (m,); give the torque until the next, (n,) [N m]."""
        state = self.estimate = self.observer.step(theta=theta, tau=self._torque, acceleration=acceleration)
        row = min(self._row, len(self._states) - 1)  # at the end the last state is held
        estimate = np.concatenate([state.theta, state.q, state.dtheta, state.dq])
        self._torque = self.gains @ (self._states[row] - estimate) + self.desired.tau[row]
        self.observer.hold(self._torque)
        self._row += 1
        return np.array(self._torque)


def _inertia(robot: Robot, q: npt.ArrayLike) -> FloatArray:
    return np.array(np.diagonal(robot.mass_matrix(q)))


def _diagonal(blocks: FloatArray) -> FloatArray:
    return np.hstack([np.diag(block) for block in blocks])


def _refuse_unstable(observer: AccelerationObserver, gains: FloatArray, q: FloatArray, period: float) -> None:
    largest = abs(closed_loop_poles(observer, gains, q, period)[0])
    if largest > LIMIT:
        raise EstimatorError(
            f"gains: unstable at a period of {period:g} s (a pole of magnitude {largest:.4g}): take slower poles, "
            "rigid joints' included, a faster observer, or sample faster"
        )
