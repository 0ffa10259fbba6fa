"""What filters share, whatever their model: readings by kind, one recording or many, the live state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, overload

import numpy as np
import numpy.typing as npt

from linkside.errors import EstimatorError
from linkside.recording.batch import Copies, Job, run_each
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot

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


Core = TypeVar("Core", bound=CoreFilter)


class LiveFilter(Copies, ABC, Generic[Core]):
    """The state between calls of ``step``."""

    _cores = ("_started",)

    def __init__(self) -> None:
        self.status = 0
        self._started: Core | None = None

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the state after the last `step`, (states, states)."""
        return self._live.covariance

    def reset(self) -> None:
        """Forget the state: the next `step` starts anew."""
        self._started, self.status = None, 0

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
    ) -> None:
        super().__init__()
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
        """Estimate a recording, or several on all cores; each starts from rest at its first sample.

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
        return run_each(log, self._job, lambda jobs: self._run_all(jobs, self._smooth, covariance, innovations))

    @abstractmethod
    def _job(self, log: Log) -> Job[KalmanEstimate]:
        """Prepare one recording."""

    _run_all: Callable[..., list[Any]]
    """Of the core's filter."""

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


def sized(name: str, signal: npt.ArrayLike | None, size: int) -> FloatArray:
    """Give a copy of a signal's ``size`` values at one sample; NaN where there is no signal."""
    if signal is None:
        return np.full(size, np.nan)
    try:
        array = np.array(signal, np.float64)
    except (TypeError, ValueError):
        raise EstimatorError(f"{name} is {signal!r}, expected {size} numbers") from None
    if array.shape != (size,):
        raise EstimatorError(f"{name} has shape {array.shape}, expected ({size},)")
    return array
