"""What filters share, whatever their model: readings by kind, one recording or many, the live state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import chain
from typing import Any, Generic, Protocol, TypeVar, overload

import numpy as np
import numpy.typing as npt

from .errors import EstimatorError
from .estimate import Estimate
from .log import Log
from .robot import Robot
from .start import WINDOW, Moving, Readings, Spread, Start, find_start, given

FloatArray = npt.NDArray[np.float64]
Signal = FloatArray | Sequence[float]

BIASED = ("motor", "acceleration", "rate")
"""Kinds of channels that may have a bias."""


@dataclass(frozen=True, eq=False, repr=False)
class KalmanEstimate(Estimate):
    """An estimate with what tells whether to believe it.

    Attributes
    ----------
    nis : (T,)
        Normalised innovation squared; its mean should be that of ``used``.
    used : (T,)
        Readings used at each sample.
    log_likelihood : (T,)
        Logarithm of the probability density of the sample's readings, given those before.
    state : (T, k), optional
        The filter's whole state, biases last. ``covariance`` is its.
    innovation, innovation_std : (T, m), optional
        Readings less their predictions, and the standard deviations of these differences.
    channels : tuple of str
        The m columns of the log that were read.
    """

    nis: FloatArray | None = None
    used: npt.NDArray[np.uint32] | None = None
    log_likelihood: FloatArray | None = None
    state: FloatArray | None = None
    innovation: FloatArray | None = None
    innovation_std: FloatArray | None = None
    channels: tuple[str, ...] = ()


class CoreFilter(Protocol):
    """A filter of the core, with the belief after the samples that it took."""

    @property
    def states(self) -> int:
        """Number of states."""

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state, (states, states)."""


class Startable(CoreFilter, Protocol):
    """A filter of the core that can be told where it starts."""

    def reset(self) -> None:
        """Forget the state."""

    def set_start(self, mean: FloatArray, covariance: FloatArray) -> None:
        """Let a first sample find this belief."""


Core = TypeVar("Core", bound=CoreFilter)


class LiveFilter(ABC, Generic[Core]):
    """The state between calls of ``step``."""

    def __init__(self) -> None:
        self.status = 0
        self._started: Core | None = None

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state after the last `step`, (states, states)."""
        return self._live.covariance

    def reset(self) -> None:
        """Forget the state: the next `step` starts anew."""
        self._started = None

    @property
    def _live(self) -> Core:
        if self._started is None:
            self._started = self._start()
        return self._started

    @abstractmethod
    def _start(self) -> Core:
        """Build a filter that has taken no sample."""


class KalmanFilter(LiveFilter[Core]):
    """A Kalman filter, or with ``_smooth`` a smoother, of any model."""

    _smooth = False

    def __init__(
        self,
        robot: Robot,
        wanted: Mapping[str, bool | None],
        biases: Sequence[str],
        gate: float | None,
        iterations: int,
        start: Start = "auto",
    ) -> None:
        super().__init__()
        if isinstance(start, str) and start not in ("auto", "rest"):
            raise EstimatorError(f"start is {start!r}, expected 'auto', 'rest', or a mean and a covariance")
        self._at, self._early = start, list[dict[str, Any]]()
        unknown = sorted(set(biases) - set(BIASED))
        if unknown:
            raise EstimatorError(f"biases: {unknown[0]!r} is not one of {', '.join(map(repr, BIASED))}")
        if not isinstance(iterations, int) or iterations < 1:
            raise EstimatorError(f"iterations is {iterations!r}, expected a whole number of at least 1")
        self.robot = robot
        self._wanted, self._biases = dict(wanted), tuple(biases)
        self._gate, self._iterations = gate, iterations

    @overload
    def run(self, log: Log, *, covariance: bool = False, innovations: bool = False) -> KalmanEstimate: ...
    @overload
    def run(
        self, log: Sequence[Log], *, covariance: bool = False, innovations: bool = False
    ) -> list[KalmanEstimate]: ...
    def run(
        self, log: Log | Sequence[Log], *, covariance: bool = False, innovations: bool = False
    ) -> KalmanEstimate | list[KalmanEstimate]:
        """Estimate a recording, or several on all cores; each starts as ``start`` says.

        Parameters
        ----------
        log
            The recording, with motor positions of all joints, and on the elastic-joint model motor torques.
        covariance
            Keep the whole state and its covariance.
        innovations
            Keep the innovations and their standard deviations.

        Raises
        ------
        LogError
            A column is missing, or at the first sample a value that the model needs.
        NumericalError
            The estimate is no longer finite; names the sample.
        """
        if isinstance(log, Log):
            return self._run(log, covariance, innovations)
        with ThreadPoolExecutor() as pool:
            return list(pool.map(lambda one: self._run(one, covariance, innovations), log))

    def reset(self) -> None:
        """Forget the state: the next `step` starts anew."""
        super().reset()
        self._early = []

    def _begin(self, core: Startable, first: Readings, kinds: tuple[str, ...], noise: Any, jerk: FloatArray) -> None:
        """Tell a filter of the core where it starts, by its first samples, or by what the user says."""
        if self._at == "rest":
            return
        arrays = noise.arrays(self.robot, kinds)
        biased = self._channels(kinds)["biased"]
        bias = np.array(arrays["initial_bias"])[biased]
        if not isinstance(self._at, str):
            core.set_start(
                *given(self._at, np.concatenate([np.zeros(core.states - len(bias)), bias]), core.states - len(bias))
            )
            return
        n = self.robot.n
        sensors = np.array(arrays["reading"])[n:][: self._width("acceleration") if "acceleration" in kinds else 0]
        spread = Spread(np.array(arrays["reading"])[:n], max(noise.motor_velocity, 1e-9), sensors, jerk)
        if "acceleration" not in kinds:
            first = Readings(first.t, first.theta, first.dtheta, None)
        moving = find_start(self.robot, first, spread)
        if moving is not None:
            mean, std = self._state(moving, arrays)
            std = np.concatenate([std, bias])
            core.set_start(np.concatenate([mean, np.zeros(len(bias))]), np.diag(std**2))

    @abstractmethod
    def _state(self, moving: Moving, arrays: Mapping[str, Any]) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviations of the state without biases, of a robot that is moving."""

    def _decide(
        self, sample: dict[str, Any], step: Callable[..., FloatArray], begin: Callable[[Readings], None]
    ) -> Any:
        """Take one of the first samples, which decide where the filter starts: all of them, from where they say."""
        self._early.append({name: np.array(x, float) if np.ndim(x) else x for name, x in sample.items()})
        try:
            self._start_anew()
            begin(self._early_readings())
            for early in self._early:
                state = step(**early)
        except EstimatorError:
            self._early.pop()
            raise
        return state

    def _start_anew(self) -> None:
        """Let the live filter forget its samples, but not that it lives."""
        self._started = self._start()

    def _deciding(self) -> bool:
        return self._at == "auto" and len(self._early) < WINDOW

    def _early_readings(self) -> Readings:
        """The first samples that `step` took."""
        n = self.robot.n
        columns = {"theta": n, "dtheta": n, "acceleration": self._width("acceleration")}
        signals = {name: np.array([sized(name, s.get(name), k) for s in self._early]) for name, k in columns.items()}
        t = np.cumsum([s["dt"] for s in self._early])
        there = {name: None if np.isnan(values).all() else values for name, values in signals.items()}
        return Readings(t, signals["theta"], there["dtheta"], there["acceleration"])

    @abstractmethod
    def _run(self, log: Log, covariance: bool, innovations: bool) -> KalmanEstimate:
        """Estimate one recording."""

    def _with_wanted(self, kinds: tuple[str, ...], log: Log, purpose: str) -> tuple[str, ...]:
        """``kinds`` and those that were asked for, or are there unless asked about."""
        chosen = list(kinds)
        for kind, wanted in self._wanted.items():
            if wanted:
                log.require(kind, purpose=purpose)
            if wanted or (wanted is None and getattr(log, kind) is not None):
                chosen.append(kind)
        return tuple(chosen)

    def _width(self, kind: str) -> int:
        """Channels of a kind."""
        widths = {"acceleration": len(self.robot.acceleration_channels), "rate": len(self.robot.gyroscope_channels)}
        return widths.get(kind, self.robot.n)

    def _channels(self, kinds: tuple[str, ...]) -> dict[str, Any]:
        """Which further channels the core is to have for these kinds, and which of all have a bias."""
        return {
            "motor_velocities": "dtheta" in kinds,
            "rates": "rate" in kinds,
            "links": "q" in kinds,
            "torques": "torque" in kinds,
            "biased": [kind in self._biases for kind in kinds for _ in range(self._width(kind))],
        }

    def _columns(self, log: Log, kinds: tuple[str, ...]) -> tuple[str, ...]:
        """Columns of a log that channels of these kinds read."""
        return tuple(name for kind in kinds for name in log.columns("theta" if kind == "motor" else kind))

    def _estimate(self, log: Log, kinds: tuple[str, ...], result: dict[str, Any]) -> KalmanEstimate:
        return KalmanEstimate(t=log.t, names=self.robot.names, channels=self._columns(log, kinds), **result)


def first_readings(log: Log) -> Readings:
    """The samples of a recording that decide where it starts."""
    dtheta, acceleration = (None if s is None else s[:WINDOW] for s in (log.dtheta, log.acceleration))
    return Readings(log.t[:WINDOW], log.theta[:WINDOW], dtheta, acceleration)


def with_first(pieces: Iterable[Log]) -> tuple[Readings | None, Iterator[Log]]:
    """The samples that decide where a recording starts, and all of its pieces."""
    taken: list[Log] = []
    rest = iter(pieces)
    while sum(map(len, taken)) < WINDOW and (piece := next(rest, None)) is not None:
        taken.append(piece)
    if not taken:
        return None, iter(())
    firsts = [first_readings(piece) for piece in taken]
    joined = (np.concatenate([np.atleast_1d(getattr(f, name)) for f in firsts])[:WINDOW] for name in ("t", "theta"))
    optional = []
    for name in ("dtheta", "acceleration"):
        parts = [getattr(f, name) for f in firsts]
        optional.append(None if any(part is None for part in parts) else np.concatenate(parts)[:WINDOW])
    return Readings(*joined, *optional), chain(taken, rest)


def sized(name: str, signal: npt.ArrayLike | None, size: int) -> FloatArray:
    """Give a copy of a signal's ``size`` values at one sample; NaN where there is no signal."""
    if signal is None:
        return np.full(size, np.nan)
    array = np.array(signal, np.float64)
    if array.shape != (size,):
        raise EstimatorError(f"{name} has shape {array.shape}, expected ({size},)")
    return array
