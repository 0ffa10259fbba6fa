"""Velocity observers for rigid robots: velocities from positions and torques, sample by sample or whole logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arguments import one_of, per_joint, start_of
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
from linkside.robot.workspace import prismatic

from .gain_map import GainMap
from .inertia import rigid_inertia

GAIN = 100.0
"""Gain of a velocity observer that is given none [1/s]."""


@dataclass(frozen=True)
class HybridGain:
    """A gain that follows the estimated speed, so that no bound of the velocity has to be known in advance.

    Cristofaro and De Luca, "Reduced-order observer design for robot manipulators", 2023, eqs. (14)-(16), with switching
    sets that do not overlap and an estimate that is continuous at a jump. At level r the speed is at most
    ``r * bound``.

    Attributes
    ----------
    gains : tuple of float
        k1, k2, ... [1/s]; levels beyond the last use the last. `GainDesign.hybrid` computes them.
    bound : float
        Width of a level [rad/s].
    margin : float
        Largest error of the estimate that the gains are made for [rad/s].
    hysteresis : float, optional
        Between jumps up and down [rad/s]; by default a tenth of the bound.
    start : int, optional
        Level of the first sample; by default the least whose bound is above the margin.
    dwell : int
        Least number of samples between a jump and a jump down, so that noise does not cause one.
    logic
        ``"repaired"``: up at ``r * bound - margin``, down at ``(r - 1) * bound - margin - hysteresis``.
        ``"printed-sets"``: down at ``(r - 1) * bound + margin`` as printed, at which r chatters.
        ``"printed-map"``: the observer's inner state is kept at a jump as printed, and the estimate is not.
    """

    gains: tuple[float, ...]
    bound: float
    margin: float
    hysteresis: float | None = None
    start: int | None = None
    dwell: int = 0
    logic: Literal["repaired", "printed-sets", "printed-map"] = "repaired"

    def settings(self) -> dict[str, Any]:
        """Give all of them, defaults filled in."""
        least = int(np.floor(self.margin / self.bound)) + 1 if self.bound > 0 <= self.margin else 1
        start = least if self.start is None else self.start
        if start < 0 or self.dwell < 0:
            raise EstimatorError(f"start {start} and dwell {self.dwell} of a gain: expected at least 0")
        hysteresis = 0.1 * self.bound if self.hysteresis is None else self.hysteresis
        return asdict(self) | {"start": start, "hysteresis": hysteresis}


@dataclass(frozen=True, eq=False, repr=False)
class VelocityEstimate(Estimate):
    """An estimate with the gain's level.

    Attributes
    ----------
    level : (T,)
        Level r of a hybrid gain, 1 throughout for a constant one. Kept in memory only.
    """

    level: npt.NDArray[np.uint8] | None = None


class ReducedOrderObserver(PeriodicObserver[_core.VelocityObserver, VelocityEstimate], Compiles):
    """Reduced-order velocity observer.

    Cristofaro and De Luca, "Reduced-order observer design for robot manipulators", 2023, eq. (6). The joints are
    assumed to be rigid: motor inertia is added to that of the links, motor friction to theirs.

    Parameters
    ----------
    robot
        The robot; its masses and inertias are used.
    gain
        k0 [1/s]: one number, one for each joint, a `HybridGain`, or a `GainMap` that depends on the posture.
    side
        ``"motors"``: positions are the log's ``theta`` and torques its ``tau``. ``"links"``: positions are the log's
        ``q`` and torques its ``torque``, those of the transmission on the link; the motors are then not used.
    wrap
        Positions that jump by a multiple of this are an encoder's wrap, are corrected and flagged UNWRAPPED [rad]:
        one number, or one for each joint. By default a turn for revolute joints.
    period
        Sampling period for `step` [s]; by default ``rate_hz`` of robot.yaml. `run` takes the log's.
    start
        ``"auto"``: the first samples determine how fast the robot moves. ``"rest"``: it is at rest at the first sample.
        Or the velocity there, a mapping of ``dq`` (n,).

    Raises
    ------
    EstimatorError
        A gain that is not positive or above ``2 / period``; levels, bound, margin or hysteresis out of order; a map
        for another number of joints.

    Notes
    -----
    An error falls by ``exp(-gain * period)`` a sample, whatever the gain; beyond ``2 / period`` the estimate would be
    little more than a difference of two positions, so that is refused.
    """

    def __init__(
        self,
        robot: Robot,
        gain: float | Sequence[float] | FloatArray | HybridGain | GainMap = GAIN,
        *,
        side: Literal["motors", "links"] = "motors",
        wrap: float | Sequence[float] | None = None,
        period: float | None = None,
        start: Literal["auto", "rest"] | Mapping[str, npt.ArrayLike] = "auto",
    ) -> None:
        self._given = start_of(start, ("dq",), robot.n)
        one_of("side", side, ("motors", "links"))
        robot.require_masses("a velocity observer")
        refuse_unsupported(robot, "a velocity observer" + (" on the links" if side == "links" else ""))
        self.robot = robot
        self.side = side
        self.gain = gain
        self._wrap = _turns(robot) if wrap is None else per_joint("wrap", wrap, robot.n).tolist()
        self._rest = isinstance(start, str) and start == "rest"
        self._set_period(period)

    def _described(self) -> dict[str, Any]:
        return {"gain": self.gain, "side": self.side}

    def step(self, *, q: Signal, tau: Signal) -> _core.State:
        """Take one sample and give the state at its time.

        Parameters
        ----------
        q : (n,)
            Positions [rad]; NaN where a reading is missing, which is bridged by the model.
        tau : (n,)
            Torques, held until the next sample [N m]; NaN where one is missing, the one before stays.

        Returns
        -------
        State
            ``q``, ``dq``, ``ddq`` (n,), of motors ``theta`` and ``dtheta``, ``tool_position`` (3,),
            ``level`` and ``status``.

        Raises
        ------
        EstimatorError
            A reading is infinite, a signal has a wrong shape, or a position has been missing for more than 0.05 s. The
            observer is as it was before, and takes the next sample.
        NumericalError
            The inertia is singular, or readings are so extreme that the estimate is no longer finite; the observer
            restarts at the next sample.
        """
        return self._live().step(q, tau)

    def start(self, *, dq: Signal, lag: Signal | None = None) -> None:
        """Restart from a velocity (n,) [rad/s] at the next sample, and a position ``lag`` (n,) behind it [rad]."""
        self._live().start(dq, np.zeros(self.robot.n) if lag is None else lag)

    @overload
    def run(self, log: Log) -> VelocityEstimate: ...
    @overload
    def run(self, log: Sequence[Log]) -> list[VelocityEstimate]: ...
    def run(self, log: Log | Sequence[Log]) -> VelocityEstimate | list[VelocityEstimate]:
        """Estimate a recording, or several on all cores.

        Raises
        ------
        LogError
            A column is missing, time is uneven, or a reading is missing at the start or for too long.
        NumericalError
            The inertia is singular, or the estimate is no longer finite; names the sample.
        """
        return run_each(log, self._job, _core.VelocityObserver.run_all)

    def _estimate(self, log: Log, result: dict[str, Any]) -> VelocityEstimate:
        motor = {"theta": result["q"], "dtheta": result["dq"]}
        unknown = np.full(result["q"].shape, np.nan)
        if self.side == "links":
            motor = {"theta": unknown, "dtheta": unknown}
        return VelocityEstimate(t=log.t, names=self.robot.names, **motor, **without_waits(log, result))

    def _design(self, period: float) -> _core.VelocityObserver:
        core = _core.VelocityObserver(self.robot.core, self._settings(period))
        if self._given is not None:
            core.begin(self._given["dq"], np.zeros(self.robot.n))
        return core

    def _settings(self, period: float) -> dict[str, Any]:
        """Describe such an observer in plain numbers, as the core takes it."""
        gain = (
            [] if isinstance(self.gain, HybridGain | GainMap) else per_joint("gain", self.gain, self.robot.n).tolist()
        )
        return {
            "period": period,
            "gains": gain,
            "levels": self.gain.settings() if isinstance(self.gain, HybridGain) else None,
            "map": self.gain.settings() if isinstance(self.gain, GainMap) else None,
            "spring": self._spring(),
            "motors": self.side == "motors",
            "wrap": self._wrap,
            "rest": self._rest,
        }

    def _spring(self) -> list[float]:
        return [0.0] * self.robot.n

    def _controller(self, period: float | None) -> dict[str, dict[str, Any]]:
        period = period_of(self.robot, self._period if period is None else period, "for which an observer is designed")
        start = None if self._given is None else self._given["dq"].tolist()
        return {"velocity": {**self._settings(period), "start": start}}

    def _arrays(self, log: Log, before: Log | None, first: int) -> tuple[FloatArray, FloatArray]:
        position, torque = ("theta", "tau") if self.side == "motors" else ("q", "torque")
        log.require(position, torque, purpose="a velocity observer")
        refuse_uneven(log, before, first)
        q, tau = getattr(log, position), getattr(log, torque)
        if before is None:
            log.require_start("a velocity observer", (position, torque))
        for signal in (position, torque):
            refuse_dropouts(log, signal, np.ones(self.robot.n, np.bool_), before, first)
        return q, tau


class NicosiaTomeiObserver(ReducedOrderObserver):
    """Full-order velocity observer: the reduced-order one, with a spring on the position error.

    Nicosia and Tomei, "Robot control by using only joint position measurements", IEEE Transactions on Automatic
    Control, 1990. The estimate of velocity is the derivative of that of position. Without a spring, and started at the
    measured position, it is the reduced-order observer.

    Parameters
    ----------
    robot, gain, side, wrap, period, start
        As of `ReducedOrderObserver`; ``gain`` is k_D.
    position_gain
        Diagonal of K_P [N m/rad]: one number, or one for each joint. By default ``(gain / 4)**2`` times the inertia
        about each joint's axis at zero position.

    Raises
    ------
    EstimatorError
        As `ReducedOrderObserver`; from the first sample, when the largest eigenvalue of M⁻¹ K_P there is so large,
        never below ``4 / period**2``, that the sampled error would swing up.
    """

    def __init__(
        self,
        robot: Robot,
        gain: float | Sequence[float] | FloatArray | HybridGain = GAIN,
        position_gain: float | Sequence[float] | None = None,
        *,
        side: Literal["motors", "links"] = "motors",
        wrap: float | Sequence[float] | None = None,
        period: float | None = None,
        start: Literal["auto", "rest"] | Mapping[str, npt.ArrayLike] = "auto",
    ) -> None:
        if isinstance(gain, GainMap):
            raise EstimatorError("a gain map has no spring beside it: expected a ReducedOrderObserver")
        least = (gain.gains or (0.0,))[0] if isinstance(gain, HybridGain) else per_joint("gain", gain, robot.n).tolist()
        self._least_gain = np.asarray(least)
        self._position_gain = (
            None if position_gain is None else per_joint("position_gain", position_gain, robot.n).tolist()
        )
        super().__init__(robot, gain, side=side, wrap=wrap, period=period, start=start)

    def _spring(self) -> list[float]:
        if self._position_gain is not None:
            return list(self._position_gain)
        inertia = np.diag(rigid_inertia(self.robot, np.zeros(self.robot.n), self.side))
        return list((self._least_gain / 4) ** 2 * inertia)


def _turns(robot: Robot) -> list[float]:
    """After what an encoder wraps: a turn of a revolute joint."""
    return [np.inf if slides else 2 * np.pi for slides in prismatic(robot)]
