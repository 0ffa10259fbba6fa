"""Checks of a recording's samples: time that increases, numbers that are finite, channels that are not empty."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import LogError
from linkside.files.tables import failure

from .layout import Layout


class Piece(Protocol):
    """Rows of a recording: its signals are attributes."""

    @property
    def t(self) -> FloatArray:
        """Time [s]."""

    def __len__(self) -> int:
        """Rows."""


class SampleCheck:
    """Checks of the samples, carried from one piece of a log to the next."""

    def __init__(self, source: str, layout: Layout, longest: float, period: float) -> None:
        self._source, self._layout, self._longest, self._period = source, layout, longest, period
        self._rows = 0
        self._last: FloatArray = np.empty(0)
        self._seen = {s: np.zeros(len(columns), bool) for s, columns in layout.wanted.items()}

    def __call__(self, log: Piece) -> None:
        """Check one piece."""
        self._check_finite_time(log.t)
        self._check_steps(log.t)
        for signal, seen in self._seen.items():
            array = getattr(log, signal)
            if signal != "t" and array is not None:
                self._check_infinite(signal, array, log.t)
                seen |= ~np.isnan(array).all(axis=0)
        self._rows, self._last = self._rows + len(log), log.t[-1:]

    def finish(self) -> None:
        """At the end of a log: every channel had at least one sample."""
        for signal, seen in self._seen.items():
            for column, any_sample in zip(self._layout.wanted[signal], seen, strict=True):
                if column in self._layout.present and signal != "t" and not any_sample:
                    raise failure(self._source, f"column {column!r} is NaN throughout: not a single sample")

    def _check_finite_time(self, t: FloatArray) -> None:
        finite = np.isfinite(t)
        if not finite.all():
            row = int(np.argmin(finite))
            raise self._bad(self._layout.wanted["t"][0], f"is {t[row]}", row, None)

    def _check_steps(self, t: FloatArray) -> None:
        joined = np.concatenate((self._last, t))
        steps = np.diff(joined)
        # Order before gaps: times out of order spoil the period that gaps are measured by.
        for wrong in (~(steps > 0), steps > self._longest):
            if wrong.any():
                row = int(np.argmax(wrong)) + 1
                what, column = self._describe(steps[row - 1]), self._layout.wanted["t"][0]
                raise self._bad(column, what, row - len(self._last), joined[row])

    def _describe(self, step: float) -> str:
        if step < 0:
            return f"runs backwards by {-step:.6g} s"
        if step == 0:
            return "repeats"
        return f"has a gap of {step:.6g} s where the period is {self._period:.6g} s"

    def _check_infinite(self, signal: str, array: FloatArray, t: FloatArray) -> None:
        infinite = np.isinf(array)
        if infinite.any():
            row, channel = np.unravel_index(np.argmax(infinite), array.shape)
            raise self._bad(self._layout.wanted[signal][channel], "is infinite", int(row), t[row])

    def _bad(self, column: str, what: str, row: int, time: float | None) -> LogError:
        when = "" if time is None else f" (t = {time:.9g})"
        return failure(self._source, f"column {column!r} {what} at row {self._rows + row}{when}")
