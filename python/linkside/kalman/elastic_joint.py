"""Kalman filter and smoother on the elastic-joint model: links and motors moved by the measured motor torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np

from linkside import _core
from linkside.arguments import one_of, per_joint, time_step
from linkside.arrays import FloatArray, Signal
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.compiled import Compiles
from linkside.robot.considered import considered
from linkside.robot.requirements import refuse_unsupported

from .elastic_dynamics import Arrays, LiveOnElasticDynamics, OnElasticDynamics
from .linearisation import Linearisation
from .link_disturbance import LinkDisturbance, Wanted
from .losses import Losses
from .noise import (
    PositiveStd,
    ReadingNoise,
    Std,
    channel_arrays,
    friction_at_unit_speed,
    jerk_scale,
    motor_noise,
    torque_noise,
)
from .start import Moving, Readings, Start

TORQUE_TIME = 0.5
"""Times over which a log is asked how far its torques wander end here [s]."""


class ElasticNoise(ReadingNoise):
    """Standard deviations of the elastic-joint model, the same for all joints or sensors unless given joint by joint.

    Attributes
    ----------
    link_acceleration, motor_acceleration
        Density of accelerations that the equations of links and motors lack: the random walk of velocity in one second
        [rad/s/√s].
    torque
        Noise of the motor torques, in multiples of robot.yaml's ``torque.noise_std``.
    torque_walk
        Random walk of a motor torque in one second without readings [N m/√s]. None: the largest walk
        of the log's torques over any time up to `TORQUE_TIME`.
    disturbance, disturbance_walk
        Initial uncertainty of each motor's disturbance torque, and its random walk in one second, in multiples of the
        motor's friction torque at 1 rad/s (of 1 N m if it has none).
    transmission, motor_velocity, acceleration, rate, link, joint_torque, link_velocity, position, velocity
        And biases and disturbance torques of links: as of `ReadingNoise`, at the first sample of links and of motors.
    """

    link_acceleration: Std | tuple[Std, ...] = 3e-3
    motor_acceleration: Std | tuple[Std, ...] = 1e-2
    torque: Std = 1.0
    torque_walk: Std | tuple[Std, ...] | None = None
    disturbance: Std = 0.1
    disturbance_walk: Std = 0.1
    motor_velocity: PositiveStd = 1e-3

    def for_log(self, log: Log, robot: Robot) -> ElasticNoise:
        """Fill in what is estimated from the log: the random walk of torques that are missing."""
        if self.torque_walk is not None or log.tau is None or not np.isnan(log.tau).any():
            return self
        walk = torque_walk(log, self.torque * torque_noise(robot))
        return self.updated(torque_walk=tuple(walk.tolist()))

    def arrays(self, robot: Robot, kinds: tuple[str, ...]) -> dict[str, list[float]]:
        """Arrays for the filter: one number a joint or channel, the channels being those of ``kinds`` in order."""
        n = robot.n
        drag = friction_at_unit_speed(robot)
        initial = [np.repeat([self.position, self.velocity], n), self.disturbance * drag]
        channels = channel_arrays(self, motor_noise(robot, self.transmission), robot, kinds)
        arrays = channels | {
            "link": per_joint("link_acceleration", self.link_acceleration, n),
            "motor": per_joint("motor_acceleration", self.motor_acceleration, n),
            "torque": self.torque * torque_noise(robot),
            "torque_walk": per_joint("torque_walk", self.torque_walk or 0.0, n),
            "disturbance_walk": self.disturbance_walk * drag,
            "initial": np.concatenate(initial),
        }
        return {name: values.tolist() for name, values in arrays.items()}


class ElasticJoint(OnElasticDynamics):
    """What filter and smoother on the elastic-joint model share; parameters as of `ElasticJointFilter`."""

    def __init__(
        self,
        robot: Robot,
        noise: ElasticNoise | None = None,
        *,
        accelerations: bool | None = None,
        dtheta: bool | None = None,
        rate: bool | None = None,
        q: bool | None = None,
        torque: bool | None = None,
        dq: bool | None = None,
        biases: Sequence[str] = ("acceleration", "rate", "position"),
        disturbances: bool = True,
        motor_torque: Literal["sampled", "held"] = "sampled",
        transition: Literal["exact", "first-order"] = "exact",
        gate: float | None = None,
        iterations: int = 1,
        tolerances: bool = True,
        start: Start = "auto",
        link_disturbance: Wanted = "auto",
        loss: Losses = "squares",
        linearisation: Linearisation = "derivatives",
        exclude_faulty: bool = False,
    ) -> None:
        wanted = {"acceleration": accelerations, "dtheta": dtheta, "rate": rate, "q": q, "torque": torque, "dq": dq}
        refuse_unsupported(robot, "a filter on the elastic-joint model")
        also = link_disturbance, loss, linearisation, exclude_faulty
        super().__init__(robot, wanted, biases, gate, iterations, start, *also)
        one_of("transition", transition, ("exact", "first-order"))
        one_of("motor_torque", motor_torque, ("sampled", "held"))
        self.noise = noise or ElasticNoise()
        self._uncertain = considered(robot, motors=True) if tolerances else []
        self._held = motor_torque == "held"
        self._disturbances, self._transition = disturbances, transition

    def kinds(self, log: Log) -> tuple[str, ...]:
        """Kinds of channels to use, in the filter's order."""
        purpose = "the elastic-joint filter"
        log.require("theta", purpose=purpose)
        log.require("tau", purpose=purpose)
        return self._with_wanted(("motor",), log, purpose)

    def started_core(
        self, kinds: tuple[str, ...], log: Log, first: Readings, law: LinkDisturbance | None = None
    ) -> _core.ElasticJointFilter:
        """Build a filter of the core that starts where the ``first`` samples say."""
        noise = self.noise.for_log(log, self.robot)
        core = self.core(kinds, log.period, noise, held=self._held, law=law)
        self._begin(core, first, kinds, noise, jerk_scale(first), law)
        return core

    def _state(
        self, moving: Moving, arrays: Mapping[str, Any], kinds: tuple[str, ...]
    ) -> tuple[FloatArray, FloatArray]:
        mean, std = self._begun(moving, arrays, kinds)
        if self._disturbances:
            mean.append(np.zeros(self.robot.n))
            std.append(np.array(arrays["initial"])[2 * self.robot.n :])
        return np.concatenate(mean), np.concatenate(std)

    def core(
        self,
        kinds: tuple[str, ...],
        period: float,
        noise: ElasticNoise,
        *,
        held: bool,
        law: LinkDisturbance | None = None,
    ) -> _core.ElasticJointFilter:
        """Build a filter of the core, without a sample yet, for channels of these kinds every ``period`` [s]."""
        return _core.ElasticJointFilter(self.robot.core, self.described(kinds, period, noise, held, law))

    def described(
        self, kinds: tuple[str, ...], period: float, noise: ElasticNoise, held: bool, law: LinkDisturbance | None
    ) -> dict[str, Any]:
        """Describe such a filter in plain numbers, as the core takes it."""
        return {
            **self._common(kinds, period, noise, law),
            "disturbances": self._disturbances,
            "first_order": self._transition == "first-order",
            "held": held,
        }

    def arrays(self, log: Log, kinds: tuple[str, ...], before: Log | None = None) -> Arrays:
        """Steps of time, readings and motor torques, one row a sample; ``before`` ends with the last sample before.

        Held torques belong to the sample at which they end.
        """
        if before is None:
            log.require_start("a filter", ("theta", "tau"))
        tau = log.tau
        assert tau is not None  # `kinds` has asked for it
        if self._held:
            earlier = None if before is None else before.tau
            tau = np.vstack([tau[:1] if earlier is None else earlier[-1:], tau[:-1]])
        return *self._sampled(log, kinds, before), tau


class ElasticJointFilter(ElasticJoint, LiveOnElasticDynamics, Compiles):
    """EKF on the full elastic-joint dynamics, driven by the motor torques of the log.

    Ulrich and Sasiadek, "Extended Kalman filtering for flexible joint space robot control", ACC 2011. The paper
    measures motor positions and velocities alone; here every sensor of the log is used. State: position and velocity of
    every link and of every elastic joint's motor, a disturbance torque of each motor, and biases. Any spring, friction
    and coupling that robot.yaml can describe is in the model, with exact derivatives.

    Parameters
    ----------
    robot
        The robot.
    noise
        Noise levels.
    accelerations
        Whether accelerometers are used; by default if the log has them, in `step` if the robot has them.
    dtheta, rate, q, torque, dq
        Whether motor velocities, gyroscopes, link encoders, joint torque sensors and link tachometers are used; by
        default if the log has them, in `step` motor velocities only.
    biases
        Kinds of channels with a bias state: any of ``"motor"``, ``"acceleration"``, ``"rate"``,
        ``"position"``.
    disturbances
        Whether to estimate a slowly changing torque on each motor in addition to the measured one, such as friction
        that robot.yaml lacks.
    transition
        How the covariance is propagated over a step: ``"exact"``, with the matrix exponential of A h, or
        ``"first-order"``, with 1 + A h, as in the paper.
    gate, iterations, tolerances, start, link_disturbance, loss, linearisation, exclude_faulty
        As of `ExtendedKalmanFilter`; sigma points are also propagated over the time step. With
        ``link_disturbance=True``, motor torques alone determine a disturbance, as accurately as the motor friction is
        known.

    Raises
    ------
    EstimatorError
        Settings out of range.

    Notes
    -----
    Between samples the mean is integrated by the fourth-order Runge–Kutta method, in as many substeps as the robot's
    fastest mode needs.
    """

    def step(
        self,
        *,
        dt: float,
        theta: Signal,
        tau: Signal,
        dtheta: Signal | None = None,
        acceleration: Signal | None = None,
        further: Signal | None = None,
    ) -> _core.State:
        """Take one sample and give the state at its time.

        Parameters
        ----------
        dt
            Time since the sample before [s].
        theta, tau : (n,)
            Motor positions [rad] and motor torques [N m], link side. A position may be NaN where missing.
        dtheta : (n,)
            Motor velocities [rad/s]; NaN, or not given, where missing.
        acceleration : (m,)
            Accelerometer channels in the order of ``robot.acceleration_channels`` [m/s²].
        further : (k,)
            Readings of the kinds asked for (``rate``, ``q``, ``torque``, ``dq``), one after the other in this order.

        Returns
        -------
        State
            The fields of an estimate's row; ``state`` is link positions (n) and velocities (n), motor positions and
            velocities of the elastic joints, disturbance torques, biases.

        Raises
        ------
        EstimatorError
            ``dt`` is not a positive, finite time, a reading is infinite, or a signal has a wrong shape. The filter
            is as it was before, and takes the next sample.
        NumericalError
            Readings so extreme that the estimate is no longer finite; the filter restarts at the next sample.
        """
        if self._deciding():
            sample: dict[str, Any] = {"dt": dt, "theta": theta, "tau": tau, "dtheta": dtheta}
            sample |= {"acceleration": acceleration, "further": further}

            def begin(first: Readings) -> None:
                self._begin(self._live, first, self.live_kinds, self.noise, jerk_scale(first), self.live_law)

            return self._decide(sample, self._step, begin)
        return self._step(dt, theta, tau, dtheta, acceleration, further)

    def _step(
        self,
        dt: float,
        theta: Signal,
        tau: Signal,
        dtheta: Signal | None,
        acceleration: Signal | None,
        further: Signal | None,
    ) -> _core.State:
        if self._started is None:
            self._period = time_step(dt)
        state = self._live.step(dt, theta, tau, dtheta, acceleration, further)
        self.status = state.status
        return state

    def _controller(self, period: float | None) -> dict[str, dict[str, Any]]:
        kinds, law = self.live_kinds, self.live_law
        period = self._compiled_period(period, kinds)
        own_states = self.core(kinds, period, self.noise, held=self._held, law=law).own_states
        start = self._compiled_start(own_states, kinds, self.noise, law)
        return {"elastic-ekf": self.described(kinds, period, self.noise, self._held, law) | {"start": start}}

    def _start(self) -> _core.ElasticJointFilter:
        return self._told(self._period, held=self._held)

    def _told(self, period: float, *, held: bool) -> _core.ElasticJointFilter:
        """Build a filter of the core that starts where the user says, if that is a state."""
        core = self.core(self.live_kinds, period, self.noise, held=held, law=self.live_law)
        self._begin(core, None, self.live_kinds, self.noise, np.zeros(self.robot.n), self.live_law)
        return core

    def fresh(self, period: float) -> tuple[_core.ElasticJointFilter, tuple[str, ...]]:
        """Build a filter of the core for a loop of this period [s], and the kinds of its channels.

        It has taken no sample. The torques of a sample are those that were held since the sample before.
        """
        return self._told(period, held=True), self.live_kinds


class ElasticJointSmoother(ElasticJoint):
    """Smoother on the elastic-joint model: each sample from all samples. Parameters as of `ElasticJointFilter`."""

    _way = "smooth"


class ElasticJointIteratedSmoother(ElasticJoint):
    """Most probable motion on the elastic-joint model, as `IteratedSmoother`; parameters as of `ElasticJointFilter`."""

    _way = "iterate"


def torque_walk(log: Log, noise: FloatArray) -> FloatArray:
    """Density of a random walk (n,) that wanders at least as far as the log's torques over any time [N m/√s].

    For each lag, a power of two of samples, the mean square of the change beyond ``noise`` (n,) [N m], over the lag.
    """
    assert log.tau is not None
    longest = min(TORQUE_TIME, float(log.t[-1] - log.t[0]) / 2)
    squares = [np.zeros(log.tau.shape[1])]
    lag = 1
    while lag < len(log) and (lag == 1 or lag * log.period <= longest):
        change, time = log.tau[lag:] - log.tau[:-lag], log.t[lag:] - log.t[:-lag]
        there = ~np.isnan(change)
        total = np.where(there, change**2 - 2 * noise**2, 0.0).sum(axis=0)
        squares.append(total / np.maximum((there * time[:, None]).sum(axis=0), log.period))
        lag *= 2
    return np.asarray(np.sqrt(np.max(squares, axis=0)))
