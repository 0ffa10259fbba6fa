"""Observers: link state from motor positions, motor torques and accelerometers, one sample at a time or whole logs."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.errors import EstimatorError, LogError, NumericalError
from linkside.recording.batch import Copies, Job, run_each
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot

from .poles import PolePattern, damped

FloatArray = npt.NDArray[np.float64]
Signal = FloatArray | Sequence[float]
Poles = float | PolePattern | Mapping[str, "PolePattern | Sequence[complex]"]

LONGEST_DROPOUT = 0.05
"""An observer bridges readings that are missing for up to this long [s]."""

UNEVEN = 0.2
"""A step of time may differ from the period by this share of it."""


class AccelerationObserver(Copies):
    """Observer driven by measured accelerations; it needs nothing of the links' dynamics.

    De Luca, Schröder and Thümmel, "An acceleration-based state observer for robot manipulators with elastic joints",
    ICRA 2007: Theorem 1, Theorem 2 (inertial coupling, where robot.yaml gives it) and equation (12).

    Parameters
    ----------
    robot
        The robot. Elastic joints need stiffness, damping and motor inertia; motor friction and nonlinear springs are
        compensated where robot.yaml gives them.
    poles
        Poles of the error dynamics: one frequency [rad/s] for a well-damped pattern, a pattern of `linkside.poles`,
        or for each joint by name a pattern or the poles themselves [1/s].
    bias
        Adds a state per joint for a slowly varying bias of the measured link acceleration, and a pole.
    form
        ``"current"`` reports the state after the sample's own motor positions are used, ``"predictor"`` before.
    accelerations
        ``"sensors"``: from the robot's accelerometers. ``"joints"``: from the log's columns ``ddq_<joint>``.
    period
        Sampling period for `step` [s]; by default ``rate_hz`` of robot.yaml. `run` takes the log's.
    worst_acceleration_std
        Combinations of link accelerations that the sensors determine worse than this [rad/s²] are damped, as near a
        singular posture, and flagged in ``status``.
    start
        ``"auto"``: the first samples tell how fast the robot moves. ``"rest"``: it does not at the first one. A state
        can be given to `start`.

    Raises
    ------
    EstimatorError
        Poles that are unstable, unpaired, too many, too few or too fast for the sampling period; fewer measured
        accelerations than elastic joints.

    Notes
    -----
    Motor positions may be slower than the log, NaN between, as slow as one in 0.05 s: each then counts for the time
    since the one before. Where innovations have for 0.05 s been as large as an error of
    ``worst_acceleration_std`` in the measured accelerations makes them, ``status`` says CONTRADICTED.

    The innovation is used at the sampling instants only; between them the model is integrated exactly, with the
    torque held and the acceleration interpolated.
    """

    _cores = ("_core",)

    def __init__(
        self,
        robot: Robot,
        poles: Poles = 250.0,
        *,
        bias: bool = False,
        form: Literal["current", "predictor"] = "current",
        accelerations: Literal["sensors", "joints"] = "sensors",
        period: float | None = None,
        worst_acceleration_std: float = 10.0,
        start: Literal["auto", "rest"] = "auto",
    ) -> None:
        _one_of("start", start, ("auto", "rest"))
        _one_of("form", form, ("current", "predictor"))
        _one_of("accelerations", accelerations, ("sensors", "joints"))
        self.robot, self.form, self.accelerations = robot, form, accelerations
        self.worst_acceleration_std = worst_acceleration_std
        self.poles = {name: _joint_poles(poles, name, order) for name, order in _orders(robot, bias).items()}
        self._settings: dict[str, Any] = {
            "poles": list(self.poles.values()),
            "bias": bias,
            "predictor": form == "predictor",
            "joint_accelerations": accelerations == "joints",
            "worst_acceleration_std": worst_acceleration_std,
            "rest": start == "rest",
        }
        self._signal = "acceleration" if accelerations == "sensors" else "ddq"
        rate = robot.config.rate_hz
        self._period = period if period is not None or rate is None else 1 / rate
        self._core: _core.AccelerationObserver | None = None
        if self._period is not None:
            self._core = self._designed(self._period)

    def step(self, *, theta: Signal, tau: Signal, acceleration: Signal) -> _core.State:
        """Take one sample and give the state at its time.

        Parameters
        ----------
        theta : (n,)
            Motor positions, link side [rad].
        tau : (n,)
            Motor torques, link side, held until the next sample [N m].
        acceleration : (m,)
            Accelerometer channels in the order of ``robot.acceleration_channels`` [m/s²]; link accelerations (n,)
            [rad/s²] with ``accelerations="joints"``. NaN where a reading is missing.

        Returns
        -------
        State
            ``q``, ``dq``, ``ddq``, ``theta``, ``dtheta`` (n,), ``tool_position`` (3,) and ``status``.

        Raises
        ------
        EstimatorError
            A reading is infinite, a signal has a wrong shape, or a motor position has been missing for more than
            0.05 s. The observer is as it was before, and takes the next sample.
        NumericalError
            Readings so absurd that the estimate is no longer finite: the next sample starts anew.
        """
        return self._live().step(theta, tau, acceleration)

    def hold(self, tau: Signal) -> None:
        """Replace the torque (n,) of the last `step` [N m]: in a closed loop it follows from that step's state."""
        self._live().hold(tau)

    def reset(self) -> None:
        """Forget the state: the next sample starts anew."""
        self._live().reset()

    def start(self, *, theta: Signal, q: Signal, dtheta: Signal, dq: Signal) -> None:
        """Start `step` from a given state, each (n,), one period before the next sample."""
        self._live().start(theta, q, dtheta, dq)

    @overload
    def run(self, log: Log) -> Estimate: ...
    @overload
    def run(self, log: Sequence[Log]) -> list[Estimate]: ...
    def run(self, log: Log | Sequence[Log]) -> Estimate | list[Estimate]:
        """Estimate a recording, or several on all cores.

        Raises
        ------
        LogError
            A column is missing, time is uneven, or a reading is missing at the start or for more than 0.05 s.
        NumericalError
            The estimate is no longer finite; names the sample.
        """
        return run_each(log, self._job, _core.AccelerationObserver.run_all)

    def _job(self, log: Log) -> Job[Estimate]:
        def finish(result: dict[str, Any]) -> Estimate:
            return Estimate(t=log.t, names=self.robot.names, **result)

        return Job(log, self._designed(log.period), self._arrays(log), finish)

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[Estimate]:
        """Estimate a recording that comes piece by piece, in bounded memory; the same bits as `run`."""
        core: _core.AccelerationObserver | None = None
        seen, first = None, 0
        for piece in pieces:
            core = core or self._designed(piece.period)
            arrays = self._arrays(piece, seen, first)
            try:
                result = core.run(*arrays)
            except NumericalError as error:
                raise NumericalError(f"{piece.source}: {error}") from None
            seen, first = piece[-longest_dropout(piece) :], first + len(piece)
            yield Estimate(t=piece.t, names=self.robot.names, **result)

    def gains(self) -> dict[str, FloatArray]:
        """Continuous-time gains L of each joint in closed form (Remark 3), by the order of its states."""
        names = self.robot.names
        return {name: _core.observer_gains(self.robot.core, names.index(name), p) for name, p in self.poles.items()}

    def fresh(self, period: float) -> _core.AccelerationObserver:
        """Build an observer of the core, of accelerometers, that has taken no sample."""
        if self._signal != "acceleration":
            raise EstimatorError("feedback: link accelerations are not simulated as readings; accelerations='sensors'")
        return self._designed(period)

    def _live(self) -> _core.AccelerationObserver:
        if self._core is None:
            if self._period is None:
                raise EstimatorError("step needs the sampling period: give period=…, or rate_hz in robot.yaml")
            self._core = self._designed(self._period)
        return self._core

    def _designed(self, period: float) -> _core.AccelerationObserver:
        # A rate that was stated is exact; the log's time stamps only have it to their own rounding.
        if self._period is not None and np.isclose(period, self._period, rtol=1e-6):
            period = self._period
        try:
            return _core.AccelerationObserver(self.robot.core, period=period, **self._settings)
        except EstimatorError as error:
            raise EstimatorError(_named(str(error), self.robot.names)) from None

    def _arrays(self, log: Log, before: Log | None = None, first: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Check a log, or a piece of one that begins at row ``first`` after the rows ``before``; give its arrays."""
        log.require("theta", "tau", self._signal, purpose="the acceleration-driven observer")
        refuse_uneven(log, before, first)
        elastic = self.robot.elastic
        every = np.ones(len(self.robot.acceleration_channels), bool)
        needed = {"theta": np.ones_like(elastic), "tau": elastic}
        needed[self._signal] = elastic if self._signal == "ddq" else every
        for signal, channels in needed.items():
            refuse_dropouts(log, signal, channels, before, first)
        if before is None:
            log.require_start("an observer")
        tau = log.tau if log.tau is not None else np.full_like(log.theta, np.nan)
        return log.theta, tau, getattr(log, self._signal)


def longest_dropout(log: Log) -> int:
    """Rows for which an observer bridges a missing reading."""
    return max(1, round(LONGEST_DROPOUT / log.period))


def refuse_uneven(log: Log, before: Log | None = None, first: int = 0) -> None:
    """Raise `LogError` at the first step of time that is not the period, for methods that need an even rate."""
    steps = np.diff(log.t, prepend=log.t[0] - log.period if before is None else before.t[-1])
    off = np.abs(steps - log.period) > UNEVEN * log.period
    if off.any():
        row = int(np.argmax(off))
        raise LogError(
            f"{log.source}: row {first + row} (t = {log.t[row]:.6g}): {steps[row]:.6g} s after the row before, where "
            f"the period is {log.period:.6g} s; this estimator needs an even rate, so resample the log"
        )


def refuse_dropouts(
    log: Log, signal: str, channels: npt.NDArray[np.bool_], before: Log | None = None, first: int = 0
) -> None:
    """Raise `LogError` where one of a signal's ``channels`` is missing for longer than an observer can bridge."""
    values = getattr(log, signal)
    if values is None:
        return
    missing = np.isnan(values) & channels
    earlier = np.zeros((0, missing.shape[1]), bool) if before is None else np.isnan(getattr(before, signal)) & channels
    if not missing.any():
        return
    # A run of more than `longest` rows: the count of missing rows over a window equals its length.
    longest = longest_dropout(log)
    counts = np.cumsum(np.vstack([np.zeros((1, missing.shape[1]), int), earlier, missing]), axis=0)
    runs = counts[longest + 1 :] - counts[: -longest - 1] > longest
    if runs.any():
        start, channel = np.argwhere(runs)[0]
        row = int(start) - len(earlier)
        time = log.t[0] + row * log.period
        raise LogError(
            f"{log.source}: row {first + row} (t = {time:.6g}): '{log.columns(signal)[int(channel)]}' is missing for "
            f"more than {LONGEST_DROPOUT} s, longer than an observer can bridge"
        )


def _named(message: str, joints: Sequence[str]) -> str:
    """Joints by their names, which the core does not know."""
    return re.sub(r"\bjoint (\d+)", lambda match: f"joint '{joints[int(match[1])]}'", message)


def _one_of(name: str, value: object, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise EstimatorError(f"{name} is {value!r}, expected one of {', '.join(map(repr, allowed))}")


def _orders(robot: Robot, bias: bool) -> dict[str, int]:
    """States of each joint's model."""
    return {name: (4 + bias if elastic else 3) for name, elastic in zip(robot.names, robot.elastic, strict=True)}


def _joint_poles(poles: Poles, name: str, order: int) -> list[complex]:
    if isinstance(poles, Mapping):
        try:
            own = poles[name]
        except KeyError:
            raise EstimatorError(f"poles: none given for joint '{name}'") from None
        return list(own.poles(order)) if isinstance(own, PolePattern) else [complex(p) for p in own]
    pattern = poles if isinstance(poles, PolePattern) else damped(float(poles))
    return list(pattern.poles(order))
