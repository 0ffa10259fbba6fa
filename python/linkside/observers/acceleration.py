"""Observers: link state from motor positions, motor torques and accelerometers, one sample at a time or whole logs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arguments import one_of, start_of, time_step
from linkside.arrays import FloatArray, Signal
from linkside.errors import EstimatorError
from linkside.recording.batch import run_each
from linkside.recording.continuity import refuse_dropouts, refuse_uneven
from linkside.recording.estimate import Estimate, without_waits
from linkside.recording.log import Log
from linkside.recording.periodic import PeriodicObserver
from linkside.robot import Robot
from linkside.robot.compiled import Compiles, period_of
from linkside.robot.requirements import refuse_unsupported

from .bound import ErrorBound, error_bound
from .poles import PolePattern, damped
from .uncertainty import uncertainty

Poles = float | PolePattern | Mapping[str, "PolePattern | Sequence[complex]"]


class AccelerationObserver(PeriodicObserver[_core.AccelerationObserver, Estimate], Compiles):
    """Observer driven by measured accelerations; it needs no model of the links' dynamics.

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
        Combinations of link accelerations that the sensors determine worse than this [rad/s²], as near a singular
        posture, are damped and flagged in ``status``.
    start
        ``"auto"``: the first samples determine how fast the robot moves. ``"rest"``: the robot is at rest at the first
        sample. Or a state one period before the first sample, a mapping of ``theta``, ``q``, ``dtheta`` and ``dq``,
        each (n,).
    std
        Whether the estimate has standard deviations, ``q_std`` and ``tool_std``. It is the same without, and faster.
    tolerances
        Whether the ``tolerances`` of robot.yaml count in them. The estimate itself is the same.

    Raises
    ------
    EstimatorError
        Poles that are unstable, unpaired, too many, too few or too fast for the sampling period; fewer measured
        accelerations than elastic joints; what `robot.requirements` lists.

    Notes
    -----
    Motor positions may come at a lower rate than the rows of the log, at least one in 0.05 s, with NaN in between: each
    then counts for the time since the one before. If innovations have been as large for 0.05 s as an error of
    ``worst_acceleration_std`` in the measured accelerations would make them, ``status`` is CONTRADICTED. With
    ``std``, also if they stay on one side by more than three standard deviations of what noise and ``tolerances`` make
    of them, or if a channel repeats a reading that it cannot have.

    The innovation is used at the sampling instants only; between them the model is integrated exactly, with the
    torque held and the acceleration interpolated.
    """

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
        start: Literal["auto", "rest"] | Mapping[str, npt.ArrayLike] = "auto",
        std: bool = True,
        tolerances: bool = True,
    ) -> None:
        self._given = start_of(start, ("theta", "q", "dtheta", "dq"), robot.n)
        one_of("form", form, ("current", "predictor"))
        one_of("accelerations", accelerations, ("sensors", "joints"))
        on_joints = " on joint accelerations" if accelerations == "joints" else ""
        refuse_unsupported(robot, f"the acceleration-driven observer{on_joints}")
        self.robot, self.form, self.accelerations = robot, form, accelerations
        self.worst_acceleration_std = worst_acceleration_std
        self.poles = {name: _joint_poles(poles, name, order) for name, order in _orders(robot, bias).items()}
        self._settings: dict[str, Any] = {
            "poles": [[[pole.real, pole.imag] for pole in poles] for poles in self.poles.values()],
            "bias": bias,
            "predictor": form == "predictor",
            "joint_accelerations": accelerations == "joints",
            "worst_acceleration_std": worst_acceleration_std,
            "rest": isinstance(start, str) and start == "rest",
            "uncertainty": uncertainty(robot, tolerances=tolerances) if std else None,
        }
        self._signal = "acceleration" if accelerations == "sensors" else "ddq"
        self._set_period(period)

    def _described(self) -> dict[str, Any]:
        sizes = sorted({f"{abs(pole):.4g}" for poles in self.poles.values() for pole in poles}, key=float)
        poles = " to ".join(dict.fromkeys((sizes[0], sizes[-1])))
        return {"poles": f"{poles} rad/s", "form": self.form, "accelerations": self.accelerations}

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
            ``q``, ``dq``, ``ddq``, ``theta``, ``dtheta`` (n,), ``tool_position`` (3,) and ``status``; with ``std``
            also ``q_std`` (n,) and ``tool_std`` (3,).

        Raises
        ------
        EstimatorError
            A reading is infinite, a signal has a wrong shape, or a motor position has been missing for more than
            0.05 s. The observer is as it was before, and takes the next sample.
        NumericalError
            Readings so extreme that the estimate is no longer finite; the observer restarts at the next sample.
        """
        return self._live().step(theta, tau, acceleration)

    def hold(self, tau: Signal) -> None:
        """Replace the torque (n,) of the last `step` [N m]: in a closed loop it follows from that step's state."""
        self._live().hold(tau)

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

    def _estimate(self, log: Log, result: dict[str, Any]) -> Estimate:
        return Estimate(t=log.t, names=self.robot.names, **without_waits(log, result))

    def gains(self) -> dict[str, FloatArray]:
        """Continuous-time gains L of each joint in closed form (Remark 3), in the order of its states."""
        names = self.robot.names
        return {name: _core.observer_gains(self.robot.core, names.index(name), p) for name, p in self.poles.items()}

    def bound(
        self,
        *,
        torque: npt.ArrayLike = 0.0,
        acceleration: npt.ArrayLike = 0.0,
        theta: npt.ArrayLike = 0.0,
        period: float | None = None,
    ) -> ErrorBound:
        """Give the ultimate bound of the error: how far off links can get by what is bounded, whatever its course.

        The sum of the error's impulse response without signs (its L₁ norm), from the gains alone. Nonlinear springs and
        dry friction are taken to be compensated: what is left of them is a torque.

        Parameters
        ----------
        torque
            Largest torque on a motor beside those of the model, for all joints or (n,) [N m].
        acceleration
            Largest error of a measured link acceleration, likewise [rad/s²].
        theta
            Largest error of a motor position, likewise [rad].
        period
            Sampling period [s]; by default that of `step`.

        Returns
        -------
        ErrorBound
            ``q`` and ``dq`` (n,), and what a unit of each disturbance does.

        Raises
        ------
        EstimatorError
            No period is known, or a disturbance has neither 1 nor n entries.
        """
        period = self._period if period is None else time_step(period)
        if period is None:
            raise EstimatorError("bound needs the sampling period: give period=…, or rate_hz in robot.yaml")
        self._designed(period)  # what is wrong is said with names of joints
        disturbances = {"torque": torque, "acceleration": acceleration, "theta": theta}
        return error_bound(self.robot, self.poles, period, disturbances, predictor=self.form == "predictor")

    def fresh(self, period: float) -> _core.AccelerationObserver:
        """Build a new observer of the core, driven by accelerometers, that has taken no sample."""
        if self._signal != "acceleration":
            raise EstimatorError("feedback: link accelerations are not simulated as readings; accelerations='sensors'")
        return self._designed(period)

    def _design(self, period: float) -> _core.AccelerationObserver:
        try:
            core = _core.AccelerationObserver(self.robot.core, {"period": period, **self._settings})
        except EstimatorError as error:
            raise EstimatorError(_named(str(error), self.robot.names)) from None
        if self._given is not None:
            core.begin(**self._given)
        return core

    def _controller(self, period: float | None) -> dict[str, dict[str, Any]]:
        period = period_of(self.robot, self._period if period is None else period, "for which an observer is designed")
        self._designed(period)  # what is wrong is said with names of joints
        start = None if self._given is None else {name: values.tolist() for name, values in self._given.items()}
        return {"observer": {"period": period, **self._settings, "start": start}}

    def _arrays(self, log: Log, before: Log | None, first: int) -> tuple[FloatArray, FloatArray, FloatArray]:
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


def _named(message: str, joints: Sequence[str]) -> str:
    """Joints by their names, which the core does not know."""
    return re.sub(r"\bjoint (\d+)", lambda match: f"joint '{joints[int(match[1])]}'", message)


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
