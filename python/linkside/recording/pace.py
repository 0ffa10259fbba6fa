"""How often each channel of a recording is read, which distinguishes slow sensors from missing readings."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray

LONGEST = 1.5
"""Readings further apart than this many of their usual spacings have one missing in between."""

LONGEST_DROPOUT = 0.05
"""Readings that are missing for up to this long are bridged by an observer, or by a line between them [s]."""

ROUNDING = 0.01
"""By how much of its usual spacing a reading may be early."""

MISSING = (np.inf, np.inf)
"""Median and longest spacing of a channel that is never read."""


@dataclass(frozen=True)
class Pace:
    """How often channels are read, and when each was last read before the present rows.

    Attributes
    ----------
    usual : dict of str to (k,)
        By signal: the longest usual time between readings of each channel [s]; infinite where there is no column.
    last : dict of str to (k,)
        When each channel was last read, where the first row at hand lacks it [s].
    fastest : float
        The least median time between readings of a channel [s]; infinite where there is none.
    """

    usual: Mapping[str, FloatArray] = field(default_factory=dict)
    last: Mapping[str, FloatArray] = field(default_factory=dict)
    fastest: float = np.inf

    @classmethod
    def of(cls, t: FloatArray, signals: Mapping[str, FloatArray | None], there: Mapping[str, list[bool]]) -> Pace:
        """Find it by the first rows of a recording: ``t`` (T,), signals (T, k), and which channels have a column."""
        rows = _spacing(t)
        found = {
            signal: np.array(
                [_of(t, values, rows) if c else MISSING for values, c in zip(array.T, there[signal], strict=True)]
            )
            for signal, array in signals.items()
            if array is not None and array.size
        }
        usual = {signal: times[:, 1] for signal, times in found.items()}
        # A channel of every row is due in the first one too; a slower one when its turn comes.
        every = {signal: times[:, 0] <= (1 + ROUNDING) * rows[0] for signal, times in found.items()}
        last = {signal: t[0] - np.where(every[signal], times, 0.0) for signal, times in usual.items()}
        return cls(usual, last, min((float(times[:, 0].min()) for times in found.values()), default=np.inf))

    def longest_step(self, period: float) -> float:
        """A longer step of time is a gap, in a recording with this median step [s].

        Rows of several clocks are uneven, and no further apart than the readings of the fastest channel.
        """
        return LONGEST * (max(period, self.fastest) if np.isfinite(self.fastest) else period)

    def until(self, log: Any, row: int) -> Pace:
        """The same for rows from ``row`` of a recording on."""
        last = dict(self.last)
        for signal, earlier in self.last.items():
            array = getattr(log, signal)
            if array is not None and row > 0 and (row == len(array) or np.isnan(array[row]).any()):
                there = ~np.isnan(array[:row])
                latest = log.t[row - 1 - np.argmax(there[::-1], axis=0)]
                last[signal] = np.where(there.any(axis=0), latest, earlier)
        return replace(self, last=last)

    def thinned(self, period: float) -> Pace:
        """The same where only rows ``period`` [s] apart are kept."""
        usual = {signal: np.maximum(times, period) for signal, times in self.usual.items()}
        return Pace(usual, self.last, max(self.fastest, period))

    def waiting(self, log: Any) -> npt.NDArray[np.bool_]:
        """Rows (T,) of a recording that lack readings of slow sensors, but none that is due."""
        lacking, overdue = np.zeros(len(log.t), bool), np.zeros(len(log.t), bool)
        for signal, usual in self.usual.items():
            array = getattr(log, signal)
            if array is None or not (missing := np.isnan(array)).any():
                continue
            read = np.where(missing, -np.inf, log.t[:, None])
            read[0] = np.maximum(read[0], self.last[signal])
            elapsed = log.t[:, None] - np.maximum.accumulate(read, axis=0)
            lacking |= missing.any(axis=1)
            overdue |= (missing & (elapsed >= (1 - ROUNDING) * usual)).any(axis=1)
        return lacking & ~overdue


def _spacing(t: FloatArray) -> tuple[float, float]:
    """Median and longest usual step between times (T,), infinite for fewer than two; dropouts do not count."""
    steps = np.diff(t)
    median = float(np.median(steps)) if len(steps) else np.inf
    usual = steps[steps <= LONGEST * median]
    return median, float(usual.max()) if len(usual) else np.inf


def _of(t: FloatArray, values: FloatArray, rows: tuple[float, float]) -> tuple[float, float]:
    there = ~np.isnan(values)
    # One that is not read twice at the beginning is missing there, not slow.
    return _spacing(t[there]) if 1 < there.sum() < len(t) else rows


def column_rates(t: FloatArray, columns: Iterable[tuple[str, FloatArray]]) -> list[tuple[str, float, float]]:
    """Each column with two readings or more, how often a second it is read, and in which part of the rows."""
    found = []
    for column, values in columns:
        read = t[~np.isnan(values)]
        if len(read) > 1:
            found.append((column, 1 / float(np.median(np.diff(read))), len(read) / len(t)))
    return found
