"""The part of a recording that checks examine: some rows, and means over short blocks of them."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.recording.pace import Pace
from linkside.robot import Robot

from .finding import Finding, Verdict

Kind = TypeVar("Kind", bound="Recording")

BLOCK = 0.02
"""Length of a block [s]: short for a motion, long for noise."""

BLOCKS = 200
"""At most this many blocks are examined."""


class Recording(Protocol):
    """The attributes of a log that the checks need."""

    @property
    def t(self) -> FloatArray:
        """Time [s]."""

    @property
    def theta(self) -> FloatArray:
        """Motor positions."""

    @property
    def dtheta(self) -> FloatArray | None:
        """Motor velocities."""

    @property
    def tau(self) -> FloatArray | None:
        """Motor torques."""

    @property
    def acceleration(self) -> FloatArray | None:
        """Accelerometers."""

    @property
    def source(self) -> str:
        """Where it came from."""

    @property
    def period(self) -> float:
        """Median step of time [s]."""

    @property
    def pace(self) -> Pace:
        """How often each channel is read."""

    @property
    def conversions(self) -> tuple[str, ...]:
        """What was converted while it was read, in words."""

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What was found before."""

    def columns(self, signal: str) -> tuple[str, ...]:
        """Names of a signal's columns."""

    def recorded_size(self, signal: str) -> FloatArray:
        """How much of a signal one of the recording's column is, (k,)."""

    def __len__(self) -> int:
        """Rows."""

    def __getitem__(self: Kind, rows: slice) -> Kind:
        """Some rows."""


@dataclass(frozen=True)
class View:
    """Rows of a recording from ``first`` on, with the robot, and up to three rows before them."""

    log: Recording
    robot: Robot
    first: int = 0
    before: Recording | None = None

    def channels(self, *signals: str) -> Iterator[tuple[str, int, str, FloatArray]]:
        """Signal, index, column and values of each channel that the recording has."""
        for signal in signals:
            array = getattr(self.log, signal)
            if array is not None:
                for index, column in enumerate(self.log.columns(signal)):
                    yield signal, index, column, array[:, index]

    def finding(
        self,
        kind: str,
        verdict: Verdict,
        column: str,
        what: str,
        remedy: str,
        *,
        at: int | None = None,
        size: float | None = None,
        count: int = 1,
    ) -> Finding:
        """Make a finding at a row of this view."""
        row = None if at is None else self.first + at
        time = None if at is None else float(self.log.t[at])
        return Finding(kind, verdict, column, what, remedy, row, time, size, count)

    @cached_property
    def blocks(self) -> Blocks | None:
        """Means over blocks; None where the rows are too few."""
        return Blocks.of(self)


@dataclass(frozen=True)
class Blocks:
    """Means over blocks of rows, with speeds and accelerations between them.

    Attributes
    ----------
    row : (k,)
        First row of each block.
    theta, dtheta, ddtheta : (k, n)
        Motor positions, and their derivatives over the blocks.
    acceleration, tau, speed : (k, m), (k, n), (k, n), optional
        Accelerometers, motor torques and motor velocities of the recording.
    """

    row: npt.NDArray[np.intp]
    theta: FloatArray
    dtheta: FloatArray
    ddtheta: FloatArray
    acceleration: FloatArray | None
    tau: FloatArray | None
    speed: FloatArray | None

    @classmethod
    def of(cls, view: View) -> Blocks | None:
        """Average a view's rows."""
        log = view.log
        size = max(1, round(BLOCK / log.period))
        count = len(log) // size
        if count < 5:
            return None
        time, theta = _means(log.t[:, None], size, count)[:, 0], _means(log.theta, size, count)
        dtheta = np.gradient(theta, time, axis=0)
        ddtheta = np.gradient(dtheta, time, axis=0)
        usable = np.flatnonzero(np.isfinite(theta).all(axis=1) & np.isfinite(ddtheta).all(axis=1))
        chosen = usable[:: max(1, len(usable) // BLOCKS)]
        signals = (log.acceleration, log.tau, log.dtheta)
        parts = (None if a is None else _means(a, size, count)[chosen] for a in signals)
        return cls(chosen * size, theta[chosen], dtheta[chosen], ddtheta[chosen], *parts)


def _means(array: FloatArray, size: int, count: int) -> FloatArray:
    """Means over blocks of ``size`` rows; NaN where all of a block is missing."""
    blocks = array[: size * count].reshape(count, size, array.shape[1])
    mean = blocks.mean(axis=1)
    if np.isnan(mean).any():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            mean = np.nanmean(blocks, axis=1)
    return np.asarray(mean)
