"""Checks of single channels: sentinel values, and readings that do not change although they should."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray

from .finding import Finding
from .gravity import DIFFERENT, expected
from .view import View

SIGNALS = ("theta", "dtheta", "tau", "acceleration", "rate", "q", "ddq", "torque", "position")
SENSORS = ("acceleration", "rate", "torque")

ABSURD = 1e9
"""No reading in SI units is as large."""

SENTINELS = (-999.0, -9999.0, -99999.0, 999.0, 9999.0, 99999.0, -32768.0, 32767.0, -1e6, 1e6)
"""Values that other programs write in place of a missing reading."""

STUCK = 0.025
"""Longest time for which a working sensor may repeat exactly the same reading [s]; at least 20 rows."""

SATURATED = 10
"""A channel that stays at its extreme value for this many rows is saturated."""


def sentinels(view: View) -> Iterator[Finding]:
    """Find values that stand for a missing reading."""
    for signal, index, column, converted in view.channels(*SIGNALS):
        size = view.log.recorded_size(signal)[index]
        values = converted if size == 1 else np.round(converted / size, 6)  # as the recording has them
        with np.errstate(invalid="ignore"):
            low, high = np.fmin.reduce(values), np.fmax.reduce(values)
            extreme = float(max(-low, high))
            if not (extreme * abs(size) > ABSURD or low in SENTINELS or high in SENTINELS):
                continue
            there = np.abs(converted) > ABSURD
            for mark in (low, high):
                rest = np.abs(values[(values != mark) & ~np.isnan(values)])
                if mark in SENTINELS and (not len(rest) or abs(mark) > 5 * rest.max()):
                    there |= values == mark
        if there.any():
            at = int(np.argmax(there))
            what, remedy = f"is {values[at]:.6g}, which is no reading,", "write NaN where a reading is missing"
            count = int(there.sum())
            yield view.finding("sentinel", "refused", column, what, remedy, at=at, size=float(values[at]), count=count)


@dataclass(frozen=True)
class Runs:
    """Stretches of the very same value in a channel: first rows and lengths, (k,) each."""

    start: npt.NDArray[np.intp]
    length: npt.NDArray[np.intp]

    @classmethod
    def of(cls, values: FloatArray) -> Runs:
        """Find them; a NaN is like no other value."""
        start = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1))
        return cls(start, np.diff(start, append=len(values)))

    def live(self, values: FloatArray) -> bool:
        """Whether nearly every row brings a new value, the longest run and flat tops aside."""
        here = values[self.start]
        inside = (here != np.fmin.reduce(here)) & (here != np.fmax.reduce(here))
        inside[np.argmax(self.length)] = False
        return bool(inside.sum() > 20 and inside.sum() > 0.9 * self.length[inside].sum())


def stays(view: View) -> Iterator[Finding]:
    """Find sensors that are stuck, saturated, dead, or slower than the recording and held in between."""
    if len(view.log) < 100:
        return
    for signal in SENSORS:
        if (array := getattr(view.log, signal)) is None:
            continue
        runs = [Runs.of(np.ascontiguousarray(values)) for values in array.T]
        lively = np.array([r.live(values) for r, values in zip(runs, array.T, strict=True)])
        for _, index, column, values in view.channels(signal):
            if len(runs[index].start) > 1:
                yield from _stays(view, column, values, runs[index], bool(lively[index]))
            elif np.delete(lively, index).any() and _should_differ(view, signal, index, values[0]):
                what, remedy = f"is {values[0]:.6g} throughout", "a dead channel: leave its axis out of `axes`"
                yield view.finding("dead", "suspicious", column, what, remedy, at=0, size=float(values[0]))
    for _, _, column, values in view.channels("theta", "dtheta", "tau", "q"):
        yield from _held(view, column, values, Runs.of(np.ascontiguousarray(values)))


def _stays(view: View, column: str, values: FloatArray, runs: Runs, live: bool) -> Iterator[Finding]:
    longest = int(np.argmax(runs.length))
    length, at = int(runs.length[longest]), int(runs.start[longest])
    if not live:
        yield from _held(view, column, values, runs)
    elif (saturated := _saturated(values, runs)) is not None:
        at, count = saturated
        what = f"stays at its extreme value {values[at]:.6g}"
        remedy = "a sensor at the end of its range: set those rows to NaN, or record with a wider one"
        yield view.finding("saturated", "suspicious", column, what, remedy, at=at, size=float(values[at]), count=count)
    elif length >= max(20, STUCK / view.log.period):
        what, remedy = f"is stuck at {values[at]:.6g} for {length} rows", "set them to NaN, and look at the sensor"
        yield view.finding("stuck", "suspicious", column, what, remedy, at=at, size=float(values[at]))


def _saturated(values: FloatArray, runs: Runs) -> tuple[int, int] | None:
    """First row and number of flat tops, where a live channel comes back to its extreme again and again."""
    for extreme in (np.fmin.reduce(values), np.fmax.reduce(values)):
        flat = (values[runs.start] == extreme) & (runs.length > 1)
        if flat.sum() >= 2 and int(runs.length[flat].sum()) >= SATURATED:
            return int(runs.start[flat][0]), int(flat.sum())
    return None


def _held(view: View, column: str, values: FloatArray, runs: Runs) -> Iterator[Finding]:
    """A channel whose value changes only every few rows, at regular intervals, and by more than its resolution."""
    inner = runs.length[1:-1]
    if len(inner) < 20 or np.isnan(values).any():
        return
    typical = float(np.median(inner))
    steps = np.abs(np.diff(values[runs.start]))
    same = np.mean(np.abs(inner - typical) <= 1)
    if typical >= 3 and same > 0.95 and np.median(steps) > 5 * np.min(steps):
        what = f"has a new value every {typical:g} rows only: a sensor slower than the recording, its value held"
        remedy = "set the rows without a new value to NaN"
        yield view.finding("held", "suspicious", column, what, remedy, at=int(runs.start[1]), size=typical)


def _should_differ(view: View, signal: str, index: int, value: float) -> bool:
    """Whether gravity or the motion must show in a channel, and something other than a constant."""
    if signal != "acceleration" or (found := expected(view, np.ones(view.robot.n))) is None:
        return False
    model = found[0][:, index]
    return bool(np.nanmax(model) - np.nanmin(model) > 0.5 or abs(np.nanmean(model) - value) > DIFFERENT)
