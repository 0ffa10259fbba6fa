"""Kalman filter and smoother on the acceleration-driven model: link state and tool position with their uncertainty."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.errors import EstimatorError, NumericalError
from linkside.recording.batch import Job
from linkside.recording.log import Log
from linkside.robot import Robot

from .filtering import CoreFilter, KalmanEstimate, KalmanFilter, LiveFilter, Signal
from .late_sensors import Schedule, is_late, unfiltered
from .noise import Noise

FloatArray = npt.NDArray[np.float64]
Arrays = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class JerkDrivenCore(CoreFilter, Protocol):
    """A filter of the core on the acceleration-driven model."""

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
    """A filter on the acceleration-driven model, sample by sample."""

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
            Readings of the kinds asked for, one after the other: ``dtheta``, ``rate``, ``q``, ``torque``.

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
            Readings so absurd that the estimate is no longer finite: the next sample starts anew. Of a particle filter,
            also: no particle explains the sample, which counts as one without readings.
        """
        state = self._live.step(dt, theta, acceleration, dtheta, ddqref, further)
        self.status = state.status
        return state


class ExtendedKalmanFilter(JerkDrivenFilter[_core.ExtendedKalmanFilter], KalmanFilter[_core.ExtendedKalmanFilter]):
    """EKF on the acceleration-driven model: jerk moves the links, motor and sensors measure.

    Axelsson, Karlsson and Norrlöf, "Tool position estimation of a flexible industrial robot using recursive Bayesian
    methods", ICRA 2012. State: link position, velocity and acceleration of every joint, and a bias of each motor and
    sensor channel. The links' dynamics are in the measurement: a motor stands where the torque that the links need
    twists its spring to.

    Parameters
    ----------
    robot
        The robot, with its accelerometers and gyroscopes.
    noise
        How uncertain everything is; defaults come from robot.yaml, and the scale of jerk from the log.
    biases
        Kinds of channels with a bias state: any of ``"motor"``, ``"acceleration"``, ``"rate"``.
    damping
        Whether the damping torque D(dtheta - dq), which the paper drops, is predicted: from the log's motor velocity,
        and where that is missing from the motor positions.
    dtheta
        Whether motor velocities measure the state, too: a second use of what the damping torque is computed from.
    rate, q, torque
        Whether gyroscopes, link encoders (``q_<joint>``) and joint torque sensors (``torque_<joint>``) are used; by
        default where the log has them, in `step` not.
    gate
        Leave a reading out when its innovation exceeds this many standard deviations; None uses all.
    iterations
        How often a sample's measurement is linearised; 1 is the plain update.

    Raises
    ------
    EstimatorError
        Settings out of range.

    Notes
    -----
    An accelerometer's ``corner_frequency`` and ``delay`` in robot.yaml are accounted for: each of its readings is used
    at the time that it is of, so that a row then rests on readings that come up to the delay later.

    A reading that is NaN is missing, which equals deleting it. Steps of time may vary, and sensors have rates of their
    own: leave NaN where a sensor has no sample.
    """

    def __init__(
        self,
        robot: Robot,
        noise: Noise | None = None,
        *,
        biases: Sequence[str] = ("motor", "acceleration", "rate"),
        damping: bool = True,
        dtheta: bool = False,
        rate: bool | None = None,
        q: bool | None = None,
        torque: bool | None = None,
        gate: float | None = None,
        iterations: int = 1,
    ) -> None:
        wanted = {"dtheta": dtheta, "rate": rate, "q": q, "torque": torque}
        super().__init__(robot, wanted, biases, gate, iterations)
        self.noise = noise or Noise()
        self._damping = damping

    def _refuse_late(self, what: str) -> None:
        if is_late(self.robot):
            raise EstimatorError(
                f"{what} takes readings as they come, and robot.yaml gives an accelerometer a corner_frequency or a "
                "delay; call run on the whole log"
            )

    @property
    def _live_kinds(self) -> tuple[str, ...]:
        """Kinds of channels that `step` takes."""
        return ("motor", "acceleration", *(kind for kind, wanted in self._wanted.items() if wanted))

    def _start(self) -> _core.ExtendedKalmanFilter:
        self._refuse_late("step")
        return self._core(self._live_kinds, self.noise)

    _run_all = staticmethod(_core.ExtendedKalmanFilter.run_all)

    def _job(self, log: Log) -> Job[KalmanEstimate]:
        kinds = self._kinds(log)
        noise = self.noise.for_log(log)
        if is_late(self.robot):
            return self._late_job(log, kinds, noise)
        finish = partial(self._estimate, log, kinds)
        return Job(log, self._core(kinds, noise), self._arrays(log, kinds), finish)

    def _late_job(self, log: Log, kinds: tuple[str, ...], noise: Noise) -> Job[KalmanEstimate]:
        """Accelerometers with a filter or a delay inside: each reading is used at the time that it is of."""
        assert log.acceleration is not None  # `_kinds` has asked for it
        acceleration, late, factor = unfiltered(self.robot, log.acceleration, log.period)
        arrays = self._arrays(replace(log, acceleration=acceleration), kinds)
        lag = np.zeros(arrays[1].shape[1])
        lag[self.robot.n :][: len(late)] = late
        schedule = Schedule(log.t, lag)
        core = self._core(kinds, noise, factor)

        def finish(result: dict[str, Any]) -> KalmanEstimate:
            return self._estimate(log, kinds, schedule.gather(result, arrays[1]))

        return Job(log, core, schedule.spread(arrays, log.period), finish)

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[KalmanEstimate]:
        """Estimate a recording that comes piece by piece, in bounded memory.

        The same bits as `run` when ``noise.jerk`` is given; otherwise the scale of jerk is read off the first piece.
        """
        self._refuse_late("run_pieces")
        core: _core.ExtendedKalmanFilter | None = None
        kinds: tuple[str, ...] = ()
        before: Log | None = None
        for piece in pieces:
            if core is None:
                kinds = self._kinds(piece)
                core = self._core(kinds, self.noise.for_log(piece))
            arrays = self._arrays(piece, kinds, before)
            try:
                result = core.run(arrays, False, False)
            except NumericalError as error:
                raise NumericalError(f"{piece.source}: {error}") from None
            before = piece[-1:]
            yield self._estimate(piece, kinds, result)

    def _kinds(self, log: Log) -> tuple[str, ...]:
        """Kinds of channels to use, in the filter's order."""
        log.require("theta", purpose="the Kalman filter")
        if self.robot.acceleration_channels:
            log.require("acceleration", purpose="the Kalman filter")
        return self._with_wanted(("motor", "acceleration"), log, "the Kalman filter")

    def _core(
        self, kinds: tuple[str, ...], noise: Noise, factor: FloatArray | float = 1.0
    ) -> _core.ExtendedKalmanFilter:
        return _core.ExtendedKalmanFilter(
            self.robot.core, **self._settings(kinds, noise, factor), gate=self._gate, iterations=self._iterations
        )

    def _settings(self, kinds: tuple[str, ...], noise: Noise, factor: FloatArray | float = 1.0) -> dict[str, Any]:
        """Settings of the model: its channels, which of them have a bias, noise, damping."""
        arrays = noise.arrays(self.robot, kinds)
        sensors = slice(self.robot.n, self.robot.n + self._width("acceleration"))
        factors = np.broadcast_to(factor, self._width("acceleration"))
        arrays["reading"][sensors] = list(arrays["reading"][sensors] * factors)
        return self._channels(kinds) | {"noise": arrays, "damping": self._damping}

    def _arrays(self, log: Log, kinds: tuple[str, ...], before: Log | None = None) -> Arrays:
        """Steps of time, readings, motor velocities and commanded jerk, one row a sample."""
        signals = {"motor": log.theta, "acceleration": log.acceleration}
        parts = [signals[k] if k in signals else getattr(log, k) for k in kinds]
        readings = np.hstack([np.zeros((len(log), 0)) if part is None else part for part in parts])
        if before is None:
            log.require_start("a filter")
        dt = np.diff(log.t, prepend=log.t[0] - log.period if before is None else before.t[-1])
        dtheta = log.dtheta if log.dtheta is not None else np.full_like(log.theta, np.nan)
        return dt, np.ascontiguousarray(readings), dtheta, commanded_jerk(log, dt, before)


class RauchTungStriebelSmoother(ExtendedKalmanFilter):
    """Smoother: the estimate at each sample of a recording by all of its samples. Parameters as of the filter.

    Rauch, Tung and Striebel (1965), in Bierman's (1973) form on the filter's own updates, which inverts no
    covariance. Memory is bounded whatever the recording's length.
    """

    _smooth = True

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[KalmanEstimate]:
        """Not for a smoother, which needs what comes later; see `run`."""
        raise EstimatorError("a smoother looks back from a recording's end; read the log whole and call run")


def commanded_jerk(log: Log, dt: FloatArray, before: Log | None) -> FloatArray:
    """Commanded jerk since the sample before (T, n), zero where the log does not tell."""
    if log.ddqref is None:
        return np.zeros_like(log.theta)
    first = log.ddqref[:1] if before is None or before.ddqref is None else before.ddqref[-1:]
    return np.nan_to_num(np.diff(log.ddqref, axis=0, prepend=first) / dt[:, None])
