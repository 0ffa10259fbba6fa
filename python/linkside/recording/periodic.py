"""The common part of observers that are designed for one sampling period, live and over recordings."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, NumericalError
from linkside.robot import Robot

from .batch import Copies, Job
from .continuity import longest_dropout
from .estimate import Estimate
from .log import Log

Result = dict[str, Any]


class CoreObserver(Protocol):
    """An observer of the core."""

    @property
    def run(self) -> Callable[..., Result]:
        """Go on with the rows of a recording."""

    def reset(self) -> None:
        """Forget the state."""


Core = TypeVar("Core", bound=CoreObserver)
Found = TypeVar("Found", bound=Estimate)


class PeriodicObserver(Copies, ABC, Generic[Core, Found]):
    """An observer that the core designs for a sampling period: for `step` beforehand, for `run` the log's."""

    _cores = ("_core",)

    robot: Robot

    def _set_period(self, period: float | None) -> None:
        """Design the observer for `step`, where its period is known: given, or by ``rate_hz`` of robot.yaml."""
        rate = self.robot.config.rate_hz
        self._period = period if period is not None or rate is None else 1 / rate
        self._core: Core | None = None if self._period is None else self._designed(self._period)

    @abstractmethod
    def _design(self, period: float) -> Core:
        """Build an observer of the core that has taken no sample."""

    @abstractmethod
    def _arrays(self, log: Log, before: Log | None, first: int) -> tuple[FloatArray, ...]:
        """Check a log, or a piece of one that begins at row ``first`` after the rows ``before``; give its arrays."""

    @abstractmethod
    def _estimate(self, log: Log, result: Result) -> Found:
        """Make an estimate of what the core gave."""

    def reset(self) -> None:
        """Reset: the next sample starts from the beginning."""
        self._live().reset()

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[Found]:
        """Estimate a recording that comes piece by piece, in bounded memory; the same bits as `run`."""
        core: Core | None = None
        seen, first = None, 0
        for piece in pieces:
            core = core or self._designed(piece.period)
            arrays = self._arrays(piece, seen, first)
            try:
                result = core.run(*arrays)
            except (NumericalError, EstimatorError) as error:
                raise type(error)(f"{piece.source}: {error}") from None
            seen, first = piece[-longest_dropout(piece) :], first + len(piece)
            yield self._estimate(piece, result)

    def _job(self, log: Log) -> Job[Found]:
        return Job(log, self._designed(log.period), self._arrays(log, None, 0), partial(self._estimate, log))

    def _live(self) -> Core:
        if self._core is None:
            if self._period is None:
                raise EstimatorError("step needs the sampling period: give period=…, or rate_hz in robot.yaml")
            self._core = self._designed(self._period)
        return self._core

    def _designed(self, period: float) -> Core:
        # A rate that was stated is exact; the log's time stamps only have it to their own rounding.
        if self._period is not None and np.isclose(period, self._period, rtol=1e-6):
            period = self._period
        return self._design(period)
