"""Kalman filter and smoother on the jerk-driven model: link state and tool position with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np

from linkside import _core
from linkside.arguments import time_step
from linkside.arrays import FloatArray, Signal
from linkside.recording.batch import Job
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.compiled import Compiles
from linkside.robot.considered import considered, core_settings, with_expected_damping
from linkside.robot.requirements import refuse_unsupported

from .filtering import CoreFilter, KalmanEstimate, KalmanMethod, LiveFilter, Startable
from .late_sensors import inside
from .linearisation import Linearisation
from .link_disturbance import LinkDisturbance, Wanted
from .losses import Losses
from .noise import LEAST_JERK, Noise
from .start import Moving, Readings, Start
from .starting import DecidingFilter, first_readings, in_pieces

Arrays = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class JerkDrivenCore(CoreFilter, Protocol):
    """A filter of the core on the jerk-driven model."""

    def step(
        self,
        dt: float,
        theta: Signal,
        acceleration: Signal | None,
        dtheta: Signal | None,
        ddqref: Signal | None,
        further: Signal | None,
    ) -> _core.State:
        """Take one sample and give the state at its time."""


Core = TypeVar("Core", bound=JerkDrivenCore)


class JerkDrivenFilter(LiveFilter[Core]):
    """A filter on the jerk-driven model, sample by sample."""

    def step(
        self,
        *,
        dt: float,
        theta: Signal,
        acceleration: Signal | None = None,
        dtheta: Signal | None = None,
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
        acceleration : (m,)
            Accelerometer channels in the order of ``robot.acceleration_channels`` [m/s²].
        dtheta, ddqref : (n,)
            Motor velocities [rad/s] and commanded link accelerations [rad/s²], where there are any.
        further : (k,)
            Readings of the kinds asked for, one after the other: ``dtheta``, ``rate``, ``q``, ``torque``,
            ``dq``, ``position``.

        Returns
        -------
        State
            The fields of an estimate's row; ``state`` is link positions, velocities, accelerations, then biases.

        Raises
        ------
        EstimatorError
            ``dt`` is not a positive, finite time, a reading is infinite, or a signal has a wrong shape. The filter
            is as it was before, and takes the next sample.
        NumericalError
            Readings so extreme that the estimate is no longer finite; the filter restarts at the next sample. Of a
            particle filter, also: no particle explains the sample, which counts as one without readings.
        """
        if self._started is None:
            self._period = time_step(dt)
        state = self._live.step(dt, theta, acceleration, dtheta, ddqref, further)
        self.status = state.status
        return state


class JerkDriven(KalmanMethod):
    """What filter and smoother on the jerk-driven model share; parameters as of `ExtendedKalmanFilter`."""

    # The state has no motor velocity: what springs, damping and link accelerations say of it is 20 times further off
    # than a usual reading of it, or than the slope of motor positions.
    left_out = ("dtheta",)

    def __init__(
        self,
        robot: Robot,
        noise: Noise | None = None,
        *,
        biases: Sequence[str] = ("motor", "acceleration", "rate", "position"),
        damping: bool = True,
        dtheta: bool = False,
        rate: bool | None = None,
        q: bool | None = None,
        torque: bool | None = None,
        dq: bool | None = None,
        gate: float | None = None,
        iterations: int = 1,
        tolerances: bool = True,
        start: Start = "auto",
        link_disturbance: Wanted = "auto",
        loss: Losses = "squares",
        linearisation: Linearisation = "derivatives",
        exclude_faulty: bool = False,
    ) -> None:
        refuse_unsupported(robot, "a filter on the jerk-driven model")
        wanted = {"dtheta": dtheta, "rate": rate, "q": q, "torque": torque, "dq": dq}
        also = link_disturbance, loss, linearisation, exclude_faulty
        known = with_expected_damping(robot) if tolerances else robot
        super().__init__(known, wanted, biases, gate, iterations, start, *also)
        self.noise = noise or Noise()
        self._damping = damping
        self._uncertain = considered(self.robot) if tolerances else []

    _run_all = staticmethod(_core.ExtendedKalmanFilter.run_all)

    def _job(self, log: Log, law: LinkDisturbance | None = None) -> Job[KalmanEstimate]:
        kinds = self.kinds(log)
        core = self.started_core(kinds, self.noise_for(log, law), first_readings(log), log.period, law)
        return Job(log, core, self.arrays(log, kinds), partial(self._estimate, log, kinds))

    def noise_for(self, log: Log | None, law: LinkDisturbance | None) -> Noise:
        """The noise with what is to be read off a recording, and of what disturbances give links; None: in `step`."""
        noise: Noise = self.noise if log is None else self.noise.for_log(log, self.robot)
        if law is None or self.noise.jerk is not None:
            return noise
        jerk = np.full(self.robot.n, LEAST_JERK) if noise.jerk is None else np.ravel(noise.jerk)
        posture = np.zeros(self.robot.n) if log is None else np.nan_to_num(log.theta[0])
        return noise.updated(jerk=tuple(np.hypot(jerk, law.jerk(self.robot, posture)).tolist()))

    def kinds(self, log: Log) -> tuple[str, ...]:
        """Kinds of channels to use, in the filter's order."""
        log.require("theta", purpose="the Kalman filter")
        if self.robot.acceleration_channels:
            log.require("acceleration", purpose="the Kalman filter")
        return self._with_wanted(("motor", "acceleration"), log, "the Kalman filter")

    def core(
        self, kinds: tuple[str, ...], noise: Noise, period: float, law: LinkDisturbance | None = None
    ) -> _core.ExtendedKalmanFilter:
        """Build a filter of the core, without a sample yet, for channels of these kinds every ``period`` [s]."""
        return _core.ExtendedKalmanFilter(self.robot.core, self.described(kinds, noise, period, law))

    def described(
        self, kinds: tuple[str, ...], noise: Noise, period: float, law: LinkDisturbance | None
    ) -> dict[str, Any]:
        """Describe such a filter in plain numbers, as the core takes it."""
        return self.settings(kinds, noise, period) | {
            "gate": self._gate,
            "iterations": self._iterations,
            "losses": self._loss_names(kinds),
            "points": self._points,
            "link_disturbance": None if law is None else law.arrays,
            "wrenches": self._wrench_law,
        }

    def started_core(
        self,
        kinds: tuple[str, ...],
        noise: Noise,
        first: Readings | None,
        period: float,
        law: LinkDisturbance | None = None,
    ) -> _core.ExtendedKalmanFilter:
        """Build a filter of the core that starts where the ``first`` samples say, if they are to."""
        core = self.core(kinds, noise, period, law)
        self.begin(core, first, kinds, noise, law)
        return core

    def begin(
        self,
        core: Startable,
        first: Readings | None,
        kinds: tuple[str, ...],
        noise: Noise,
        law: LinkDisturbance | None = None,
    ) -> None:
        """Tell a filter of the core where the ``first`` samples say that it starts."""
        self._begin(core, first, kinds, noise, np.array(noise.arrays(self.robot, kinds)["jerk"]), law)

    def _state(
        self, moving: Moving, arrays: Mapping[str, Any], kinds: tuple[str, ...]
    ) -> tuple[FloatArray, FloatArray]:
        mean = np.concatenate([moving.q, moving.dq, moving.ddq])
        return mean, np.concatenate([moving.q_std, moving.dq_std, moving.ddq_std])

    def settings(self, kinds: tuple[str, ...], noise: Noise, period: float) -> dict[str, Any]:
        """Settings of the model: its channels, which have a bias, which are late, noise, damping, tolerances."""
        return self._channels(kinds) | {
            "noise": noise.arrays(self.robot, kinds),
            "damping": self._damping,
            "late": inside(self.robot, kinds, period),
            **core_settings(self.robot, self._uncertain),
        }

    def arrays(self, log: Log, kinds: tuple[str, ...], before: Log | None = None) -> Arrays:
        """Steps of time, readings, motor velocities and commanded jerk, one row a sample."""
        signals = {"motor": log.theta, "acceleration": log.acceleration}
        parts = [signals[k] if k in signals else getattr(log, k) for k in kinds]
        readings = np.hstack([np.zeros((len(log), 0)) if part is None else part for part in parts])
        if before is None:
            log.require_start("a filter")
        dt = np.diff(log.t, prepend=log.t[0] - log.period if before is None else before.t[-1])
        dtheta = log.dtheta if log.dtheta is not None else np.full_like(log.theta, np.nan)
        return dt, np.ascontiguousarray(readings), dtheta, commanded_jerk(log, dt, before)


class ExtendedKalmanFilter(
    JerkDriven, DecidingFilter[_core.ExtendedKalmanFilter], JerkDrivenFilter[_core.ExtendedKalmanFilter], Compiles
):
    """EKF on the jerk-driven model: jerk moves the links; motor positions and sensors are measurements.

    Axelsson, Karlsson and Norrlöf, "Tool position estimation of a flexible industrial robot using recursive Bayesian
    methods", ICRA 2012. State: link position, velocity and acceleration of every joint, and a bias of each motor and
    sensor channel. The links' dynamics are in the measurement: a motor position is that of its link plus the torsion of
    the spring under the torque that the links need.

    Parameters
    ----------
    robot
        The robot, with its accelerometers and gyroscopes.
    noise
        Noise levels; defaults come from robot.yaml, and the scale of jerk from the log.
    biases
        Kinds of channels with a bias state: any of ``"motor"``, ``"acceleration"``, ``"rate"``,
        ``"position"``.
    damping
        Whether the damping torque D(dtheta - dq), which the paper drops, is predicted: from the log's motor velocity,
        and where that is missing from the motor positions.
    dtheta
        Whether motor velocities are also measurements, in addition to their use for the damping torque.
    rate, q, torque, dq
        Whether gyroscopes, link encoders (``q_<joint>``), joint torque sensors (``torque_<joint>``) and tachometers on
        the links (``dq_<joint>``) are used; by default if the log has them, and not in `step`.
    gate
        Leave a reading out when its innovation exceeds this many standard deviations; None uses all.
    iterations
        How often a sample's measurement is linearised; 1 is the plain update.
    tolerances
        Whether the ``tolerances`` of robot.yaml count in standard deviations, as far as independent sensors have not
        narrowed them (Schmidt–Kalman); the estimate itself is the same, but for springs without ``damping`` on a robot
        without sensors on its links, whose vibrations are then damped as far as their frequency is uncertain.
    start
        The state at the first sample: ``"auto"``, from the first 32 samples, at rest or in motion; ``"rest"``; or a
        mean and a covariance of the state, with or without its biases. `step` gives an estimate from the first sample
        on, with the uncertainty that the samples so far leave.
    link_disturbance
        Whether to estimate a disturbance torque on each link, of something that the model lacks: a contact, a push, a
        payload or a counterbalance. It adds to the torque of the transmission, and is ``disturbance`` of the estimate.
        ``"auto"``, where joint torque sensors or link encoders are read and a recording's innovations show such torques
        and no broken sensor; not in `step`. Its size is estimated from the recording unless ``noise`` states it.
    loss
        What an error of a sensor's readings costs: ``"squares"``, for Gaussian noise, or where there are outliers
        ``"huber"`` or ``"student-t"``; for all sensors, or by kind as in ``{"acceleration": "student-t"}``. The larger
        an error is compared with its expectation, the less its sensor counts at that sample.
    linearisation
        ``"derivatives"`` at the estimate; or values at points about it, ``"unscented"`` or ``"cubature"``: see
        `UnscentedKalmanFilter`.
    exclude_faulty
        Whether `run` goes on without a channel that it finds faulty: its readings are left out from the row where the
        fault began, and the recording is estimated once more, until no other channel is found; ``findings`` has all.
        Not in `step`, nor in pieces.

    Raises
    ------
    EstimatorError
        Settings out of range.

    Notes
    -----
    ``corner_frequency`` and ``delay`` of accelerometers, gyroscopes, ``link_encoder`` and ``joint_torque`` in
    robot.yaml are accounted for: the internal state of such a sensor is part of the state, behind the biases. In `step`
    the first ``dt`` determines how many samples a delay spans.

    A reading that is NaN is missing, as if it were deleted. Time steps may vary, and sensors may have different rates:
    leave NaN where a sensor has no sample.
    """

    def step(self, **sample: Any) -> _core.State:
        """Take one sample and give the state at its time; arguments as of `JerkDrivenFilter.step`."""
        if not self._deciding():
            return super().step(**sample)
        return self._decide(
            sample,
            super().step,
            lambda first: self.begin(
                self._live, first, self.live_kinds, self.noise_for(None, self.live_law), self.live_law
            ),
        )

    def _controller(self, period: float | None) -> dict[str, dict[str, Any]]:
        kinds, law = self.live_kinds, self.live_law
        noise, period = self.noise_for(None, law), self._compiled_period(period, kinds)
        own_states = self.core(kinds, noise, period, law).own_states
        start = self._compiled_start(own_states, kinds, noise, law)
        return {"ekf": self.described(kinds, noise, period, law) | {"start": start}}

    @property
    def live_kinds(self) -> tuple[str, ...]:
        """Kinds of channels that `step` takes."""
        return ("motor", "acceleration", *(kind for kind, wanted in self._wanted.items() if wanted))

    def _start(self) -> _core.ExtendedKalmanFilter:
        law = self.live_law
        return self.started_core(self.live_kinds, self.noise_for(None, law), None, self._period, law)

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[KalmanEstimate]:
        """Estimate a recording that comes piece by piece, in bounded memory.

        Bit-identical to `run` when ``noise.jerk`` is given; otherwise the scale of jerk is estimated from the first
        piece. The first piece also decides whether disturbance torques are estimated.
        """
        self.refuse_pieces()

        def start(piece: Log, first: Readings) -> tuple[_core.ExtendedKalmanFilter, tuple[str, ...]]:
            kinds, law = self.kinds(piece), self.law(piece)
            return self.started_core(kinds, self.noise_for(piece, law), first, piece.period, law), kinds

        def run(
            core: _core.ExtendedKalmanFilter, kinds: tuple[str, ...], piece: Log, before: Log | None
        ) -> dict[str, Any]:
            return core.run(self.arrays(piece, kinds, before), False, False)

        return in_pieces(pieces, start, run, self._estimate)


class UnscentedKalmanFilter(ExtendedKalmanFilter):
    """`ExtendedKalmanFilter` with sigma points, values of the channels about the estimate, in place of derivatives.

    S. J. Julier and J. K. Uhlmann, "Unscented filtering and nonlinear estimation", Proc. IEEE 92 (2004), with α = 1,
    β = 2 and κ = 0: no weight is negative. Mean, slope and remainder are those of a regression of the channels on the
    points; with ``iterations`` it is repeated at the corrected estimate. Readings of sensors with an internal filter or
    delay are predicted with derivatives. Parameters are those of `ExtendedKalmanFilter`.
    """

    _default: Linearisation = "unscented"

    def __init__(self, robot: Robot, noise: Noise | None = None, **settings: Any) -> None:
        super().__init__(robot, noise, **{"linearisation": self._default} | settings)


class CubatureKalmanFilter(UnscentedKalmanFilter):
    """`UnscentedKalmanFilter` without its centre: Arasaratnam and Haykin, IEEE Trans. Automatic Control 54 (2009)."""

    _default = "cubature"


class RauchTungStriebelSmoother(JerkDriven):
    """Smoother: estimates each sample of a recording from all of its samples. Parameters as of `ExtendedKalmanFilter`.

    Rauch, Tung and Striebel (1965), in Bierman's (1973) form on the filter's own updates, which inverts no
    covariance. Memory is bounded whatever the recording's length.
    """

    _way = "smooth"


class UnscentedSmoother(RauchTungStriebelSmoother):
    """`RauchTungStriebelSmoother` with sigma points in place of derivatives, as `UnscentedKalmanFilter`.

    S. Särkkä, "Unscented Rauch–Tung–Striebel smoother", IEEE Trans. Automatic Control 53 (2008). Parameters as of
    `ExtendedKalmanFilter`.
    """

    _default: Linearisation = "unscented"

    def __init__(self, robot: Robot, noise: Noise | None = None, **settings: Any) -> None:
        super().__init__(robot, noise, **{"linearisation": self._default} | settings)


class CubatureSmoother(UnscentedSmoother):
    """`UnscentedSmoother` without its centre: the backward pass of `CubatureKalmanFilter`."""

    _default = "cubature"


class IteratedSmoother(JerkDriven):
    """Smoother that finds the most probable motion: linearised at its own estimate, and robust with a ``loss``.

    Parameters as of `ExtendedKalmanFilter`; ``iterations`` has no effect here. Each Gauss–Newton pass is a linear
    smoother of the model at the trajectory of the pass before (Bell 1994), so that time and memory are proportional to
    the length of the recording. With a ``loss`` for outliers, a reading is judged by how far it is from the smoothed
    trajectory, later samples included. Student's t starts from the result with Huber's loss.

    A row that another pass would move by more than a fifth of ``q_std`` has the status ``CONTRADICTED``, and one at
    which a sensor has a weight below a tenth ``GATED``.
    """

    _way = "iterate"


def commanded_jerk(log: Log, dt: FloatArray, before: Log | None) -> FloatArray:
    """Commanded jerk since the sample before (T, n), zero where the log does not tell."""
    if log.ddqref is None:
        return np.zeros_like(log.theta)
    first = log.ddqref[:1] if before is None or before.ddqref is None else before.ddqref[-1:]
    return np.nan_to_num(np.diff(log.ddqref, axis=0, prepend=first) / dt[:, None])
