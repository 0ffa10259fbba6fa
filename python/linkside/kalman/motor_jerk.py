"""Kalman filter and smoother on the elastic-joint dynamics with motors moved by jerk: they need no motor torques."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from linkside import _core
from linkside.arguments import finite_or_missing, per_joint, sized, time_step
from linkside.arrays import FloatArray, Signal
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.considered import considered, with_expected_damping
from linkside.robot.requirements import refuse_unsupported

from .elastic_dynamics import Arrays, LiveOnElasticDynamics, OnElasticDynamics
from .jerk_driven import commanded_jerk
from .linearisation import Linearisation
from .link_disturbance import LinkDisturbance, Wanted
from .losses import Losses
from .noise import (
    LEAST_JERK,
    PositiveStd,
    ReadingNoise,
    Std,
    Time,
    channel_arrays,
    friction_at_unit_speed,
    jerk_scale,
    motor_noise,
)
from .start import Moving, Readings, Start

PURPOSE = "a filter on motors moved by jerk"


class MotorJerkNoise(ReadingNoise):
    """Standard deviations of the model, the same for all joints or sensors unless given joint by joint.

    Attributes
    ----------
    jerk
        Density of the motors' jerk beside the commanded one: acceleration wanders by this in a second
        [rad/s³/√Hz]. None: read off the log.
    link_acceleration
        Density of what the links' equations leave out: velocity wanders by this in a second [rad/s/√s].
    initial_acceleration
        Uncertainty of the motors' acceleration at the first sample, where the robot is taken to be at rest [rad/s²].
    motor_torque
        Noise of the motor torques, in multiples of robot.yaml's ``torque.noise_std``.
    tau_bias, tau_bias_walk, tau_bias_time
        What of a motor torque nothing explains, such as friction that robot.yaml does not know: initial uncertainty,
        how far it wanders in a second, both in multiples of the torque that the motor's friction has at 1 rad/s (N m
        if it has none), and over which time it forgets [s].
    transmission, motor_velocity, acceleration, rate, link, joint_torque, link_velocity, position, velocity
        And biases and disturbance torques of links: as of `ReadingNoise`, at the first sample of links and of motors.
    """

    jerk: PositiveStd | tuple[PositiveStd, ...] | None = None
    link_acceleration: Std | tuple[Std, ...] = 3e-3
    motor_velocity: PositiveStd = 1e-3
    initial_acceleration: Std = 0.1
    motor_torque: PositiveStd = 1.0
    tau_bias: Std = 0.1
    tau_bias_walk: Std = 0.1
    tau_bias_time: Time | None = np.inf

    def for_log(self, log: Log) -> MotorJerkNoise:
        """Fill in what is to be read off the log: the scale of jerk."""
        return self if self.jerk is not None else self.updated(jerk=tuple(jerk_scale(log).tolist()))

    def arrays(self, robot: Robot, kinds: tuple[str, ...]) -> dict[str, list[float]]:
        """Arrays for the filter: one number a joint or channel, the channels being those of ``kinds`` in order."""
        initial = np.repeat([self.position, self.velocity, self.initial_acceleration], robot.n)
        channels = channel_arrays(self, motor_noise(robot, self.transmission), robot, kinds)
        if "tau" in kinds:  # the last channels
            channels["initial_bias"][-robot.n :] *= friction_at_unit_speed(robot)
            channels["bias_walk"][-robot.n :] *= friction_at_unit_speed(robot)
        arrays = channels | {
            "jerk": per_joint("jerk", LEAST_JERK if self.jerk is None else self.jerk, robot.n),
            "link": per_joint("link_acceleration", self.link_acceleration, robot.n),
            "initial": initial,
        }
        return {name: values.tolist() for name, values in arrays.items()}


class MotorJerk(OnElasticDynamics):
    """What filter and smoother on motors moved by jerk share; parameters as of `MotorJerkFilter`."""

    def __init__(
        self,
        robot: Robot,
        noise: MotorJerkNoise | None = None,
        *,
        accelerations: bool | None = None,
        dtheta: bool | None = False,
        rate: bool | None = None,
        q: bool | None = None,
        torque: bool | None = None,
        dq: bool | None = None,
        tau: bool | None = False,
        biases: Sequence[str] = ("acceleration", "rate", "position", "tau"),
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
        wanted["tau"] = tau
        refuse_unsupported(robot, PURPOSE)
        also = link_disturbance, loss, linearisation, exclude_faulty
        known = with_expected_damping(robot) if tolerances else robot
        super().__init__(known, wanted, biases, gate, iterations, start, *also)
        self.noise = noise or MotorJerkNoise()
        # Of a motor nothing counts whose torque is not read: without such readings these columns are zero.
        self._uncertain = considered(self.robot, motors=tau is not False) if tolerances else []

    def kinds(self, log: Log) -> tuple[str, ...]:
        """Kinds of channels to use, in the filter's order."""
        log.require("theta", purpose=PURPOSE)
        return self._with_wanted(("motor",), log, PURPOSE)

    def started_core(
        self, kinds: tuple[str, ...], log: Log, first: Readings, law: LinkDisturbance | None = None
    ) -> _core.ElasticJointFilter:
        """Build a filter of the core that starts where the ``first`` samples say."""
        noise = self.noise.for_log(log)
        core = self.core(kinds, noise, log.period, law)
        self.begin(core, first, kinds, noise, law)
        return core

    def begin(
        self,
        core: _core.ElasticJointFilter,
        first: Readings | None,
        kinds: tuple[str, ...],
        noise: MotorJerkNoise,
        law: LinkDisturbance | None,
    ) -> None:
        """Tell a filter of the core where the ``first`` samples say that it starts."""
        self._begin(core, first, kinds, noise, np.array(noise.arrays(self.robot, kinds)["jerk"]), law)

    def _state(
        self, moving: Moving, arrays: Mapping[str, Any], kinds: tuple[str, ...]
    ) -> tuple[FloatArray, FloatArray]:
        mean, std = self._begun(moving, arrays, kinds)
        return np.concatenate([*mean, moving.ddtheta]), np.concatenate([*std, moving.ddtheta_std])

    def _tied(self, covariance: FloatArray, moving: Moving) -> FloatArray:
        """Links are where their motors' positions, velocities and accelerations say: what these turn out to be, too."""
        n, elastic = self.robot.n, np.flatnonzero(self.robot.elastic)
        motors = 2 * n + np.arange(len(elastic))
        accelerations = 2 * (n + len(elastic)) + sum(len(drive.hysteresis) for drive in self.robot.drives)
        ties = np.eye(len(covariance))
        ties[elastic, motors], ties[n + elastic, motors + len(elastic)] = 1.0, moving.by_dtheta
        ties[:n, accelerations : accelerations + n] = np.where(self.robot.elastic[:, None], moving.by_ddtheta, 0.0)
        return np.asarray(ties @ super()._tied(covariance, moving) @ ties.T)

    def core(
        self, kinds: tuple[str, ...], noise: MotorJerkNoise, period: float, law: LinkDisturbance | None = None
    ) -> _core.ElasticJointFilter:
        """Build a filter of the core, without a sample yet, for channels of these kinds every ``period`` [s]."""
        return _core.ElasticJointFilter.moved_by_jerk(self.robot.core, self.described(kinds, noise, period, law))

    def described(
        self, kinds: tuple[str, ...], noise: MotorJerkNoise, period: float, law: LinkDisturbance | None
    ) -> dict[str, Any]:
        """Describe such a filter in plain numbers, as the core takes it."""
        return self._common(kinds, period, noise, law)

    def arrays(self, log: Log, kinds: tuple[str, ...], before: Log | None = None) -> Arrays:
        """Steps of time, readings and commanded jerk, one row a sample; ``before`` ends with the last sample before."""
        if before is None:
            log.require_start("a filter")
        dt, readings = self._sampled(log, kinds, before)
        return dt, readings, commanded_jerk(log, dt, before)


class MotorJerkFilter(MotorJerk, LiveOnElasticDynamics):
    """EKF on the elastic-joint dynamics with motors moved by jerk: links follow the motors through their springs.

    State: position and velocity of every link and of every elastic joint's motor, the motors' accelerations, and
    biases. A motor moves as it is measured to move, a chain of integrators of commanded and random jerk; torques are
    not needed, and nothing of springs or masses reaches the motors. Any spring, friction of links and coupling that
    robot.yaml can describe is in the model, with exact derivatives. The link of a rigid joint moves as its motor.

    Parameters
    ----------
    robot
        The robot.
    noise
        Noise levels; the scale of jerk comes from the log.
    accelerations
        Whether accelerometers are used; by default where the log has them, in `step` where the robot has them.
    rate, q, torque, dq
        Whether gyroscopes, link encoders, joint torque sensors and link tachometers are used; by default where the log
        has them, in `step` not.
    dtheta, tau
        Whether motor velocities and motor torques are read; None: where the log has them. Most velocities are
        derivatives of the positions, and say nothing more.
    biases
        Kinds of channels with a bias state: any of ``"motor"``, ``"acceleration"``, ``"rate"``,
        ``"position"``, ``"tau"``.
    gate, iterations, tolerances, start, link_disturbance, loss, linearisation, exclude_faulty
        As of `ElasticJointFilter`.

    Raises
    ------
    EstimatorError
        Settings out of range.
    """

    _commanded: FloatArray | None = None
    """Commanded accelerations at the last sample, (n,)."""

    def step(
        self,
        *,
        dt: float,
        theta: Signal,
        dtheta: Signal | None = None,
        acceleration: Signal | None = None,
        ddqref: Signal | None = None,
        further: Signal | None = None,
    ) -> _core.State:
        """Take one sample and give the state at its time.

        Parameters
        ----------
        dt
            Time since the sample before [s].
        theta : (n,)
            Motor positions, link side [rad]; NaN where missing, as in all signals.
        dtheta : (n,)
            Motor velocities [rad/s].
        acceleration : (m,)
            Accelerometer channels in the order of ``robot.acceleration_channels`` [m/s²].
        ddqref : (n,)
            Commanded accelerations [rad/s²], where there are any.
        further : (k,)
            Readings of the kinds asked for (``rate``, ``q``, ``torque``, ``dq``, ``tau``), one after the other in this
            order.

        Returns
        -------
        State
            The fields of an estimate's row; ``state`` is link positions (n) and velocities (n), motor positions and
            velocities of the elastic joints, deflections of friction elements, motor accelerations (n), biases.

        Raises
        ------
        EstimatorError
            ``dt`` is not a positive, finite time, a reading is infinite, or a signal has a wrong shape. The filter
            is as it was before, and takes the next sample.
        NumericalError
            Readings so extreme that the estimate is no longer finite; the filter restarts at the next sample.
        """
        sample: dict[str, Any] = {"dt": dt, "theta": theta, "dtheta": dtheta}
        sample |= {"acceleration": acceleration, "ddqref": ddqref, "further": further}
        if not self._deciding():
            return self._step(**sample)

        def begin(first: Readings) -> None:
            noise = (
                self.noise.updated(jerk=tuple(jerk_scale(first).tolist())) if self.noise.jerk is None else self.noise
            )
            self.begin(self._live, first, self.live_kinds, noise, self.live_law)

        return self._decide(sample, self._step, begin)

    def reset(self) -> None:
        """Reset: the next `step` starts from the beginning."""
        super().reset()
        self._commanded = None

    def _start_anew(self) -> None:
        super()._start_anew()
        self._commanded = None

    def _step(
        self,
        dt: float,
        theta: Signal,
        dtheta: Signal | None,
        acceleration: Signal | None,
        ddqref: Signal | None,
        further: Signal | None,
    ) -> _core.State:
        if self._started is None:
            self._period = time_step(dt)
        commanded = finite_or_missing("ddqref", sized("ddqref", ddqref, self.robot.n))
        before = commanded if self._commanded is None else self._commanded
        jerk = np.nan_to_num((commanded - before) / time_step(dt))
        state = self._live.step(dt, theta, jerk, dtheta, acceleration, further)
        self._commanded, self.status = commanded, state.status
        return state

    def _start(self) -> _core.ElasticJointFilter:
        core = self.core(self.live_kinds, self.noise, self._period, self.live_law)
        self.begin(core, None, self.live_kinds, self.noise, self.live_law)
        return core


class MotorJerkSmoother(MotorJerk):
    """Smoother on motors moved by jerk: each sample by all of the recording. Parameters as of the filter."""

    _way = "smooth"
