"""Tables of sensors with clocks and rates of their own, as one: a row for each time, NaN where nothing was read."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, RecordingWarning
from linkside.files.tables import column_names, failure, numbers, open_table, reading, to_arrow

from .checks import clock
from .checks.inspector import able
from .layout import COMMANDS, RobotColumns, signal_columns

SAME = 0.01
"""Stamps closer than this part of the shortest period are of one time."""


@dataclass(frozen=True)
class _Part:
    """What one table has: its name, its times (T,) [s] and its channels (T,) by column."""

    source: str
    t: FloatArray
    channels: dict[str, FloatArray]

    @property
    def span(self) -> str:
        return f"from {self.t[0]:.9g} to {self.t[-1]:.9g} s"


def merge(sources: Sequence[Any], robot: RobotColumns, shifts: Sequence[float], *, check: bool) -> tuple[pa.Table, str]:
    """Merge files or tables by time, and give the table with a name for messages.

    It begins at the first row with all motor positions: before that there is nothing to estimate from.

    Raises
    ------
    LogError
        A table that has none of the robot's columns, a column that two have, times that do not increase or have
        nothing in common, motor positions that are never read together.
    """
    if not sources or len(shifts) != len(sources):
        raise EstimatorError(f"{len(shifts)} shifts are there for {len(sources)} tables, one for each is expected")
    columns = signal_columns(robot)
    rate = robot.config.rate_hz if check and able(robot) else None
    parts = [
        _part(source, f"table {number}", columns, shift, rate, check)
        for number, (source, shift) in enumerate(zip(sources, shifts, strict=True))
    ]
    _refuse_clashes(parts)
    name = " + ".join(part.source for part in parts)
    t, rows = _union([part.t for part in parts])
    commands = {column for signal in COMMANDS for column in columns[signal]}
    table = {columns["t"][0]: t}
    for part, own in zip(parts, rows, strict=True):
        for column, values in part.channels.items():
            table[column] = _spread(t, own, values, line=column in commands)
    positions = [column for column in columns["theta"] if column in table]
    complete = ~np.isnan([table[column] for column in positions]).any(axis=0)
    if not complete.any():
        raise failure(name, f"{' and '.join(map(repr, positions))} are never read together: resample them (rate=…)")
    return pa.table({column: values[int(np.argmax(complete)) :] for column, values in table.items()}), name


def _part(
    source: Any, name: str, columns: Mapping[str, tuple[str, ...]], shift: float, rate: float | None, check: bool
) -> _Part:
    """Read what the robot has columns for."""
    is_file = isinstance(source, str | Path)
    file = open_table(source) if is_file else None
    name = file.source if file is not None else name
    names = file.names if file is not None else column_names(source, name)
    (time,) = columns["t"]
    wanted = {column for signal, own in columns.items() if signal != "t" for column in own}
    found = [column for column in dict.fromkeys(names) if column in wanted]
    for column in (time, *found):
        if names.count(column) != 1:
            there = f"is there {names.count(column)} times" if column in names else "is missing"
            raise failure(name, f"column {column!r} {there}")
    if not found:
        raise failure(name, f"no column is one of the robot's ({', '.join(sorted(wanted)[:3])}, …)")
    with reading(name):
        table = file.read([time, *found]) if file is not None else to_arrow(source, [time, *found], name)
    t = numbers(table, time, name)
    steps = np.diff(t)
    if len(t) < 2 or not (np.isfinite(t).all() and (steps > 0).all()):
        row = int(np.argmin(np.isfinite(t) & (np.append(1.0, steps) > 0))) if len(t) > 1 else 0
        raise failure(name, f"column {time!r} does not increase at row {row}, or has fewer than two rows")
    seconds = _seconds(float(np.median(steps)), rate, time, name) if check else 1.0
    return _Part(name, seconds * t - shift, {column: numbers(table, column, name) for column in found})


def _seconds(period: float, rate: float | None, column: str, source: str) -> float:
    """How many seconds a unit of time is; tables other than the motors' have rates that robot.yaml does not state."""
    found = clock.unit(period, rate, column) or clock.unit(period, None, column)
    if found is None or found.size is None:
        return 1.0
    warnings.warn(f"{source}: {found}", RecordingWarning, stacklevel=5)
    return found.size


def _refuse_clashes(parts: Sequence[_Part]) -> None:
    owner: dict[str, _Part] = {}
    for part in parts:
        for column in part.channels:
            if column in owner:
                raise failure(part.source, f"column {column!r} is in {owner[column].source} too")
            owner[column] = part
        first = parts[0]
        if part.t[0] > first.t[-1] or part.t[-1] < first.t[0]:
            away = f"its time, {part.span}, has nothing in common with that of {first.source}, {first.span}"
            raise failure(part.source, f"{away}: say by how much its clock is ahead (--shift, shifts=…)")


def _spread(t: FloatArray, rows: Any, values: FloatArray, *, line: bool) -> FloatArray:
    """A channel at all times, NaN where it is not read, or there on the straight line between neighbours."""
    if line and not np.isnan(values).any():
        return np.interp(t, t[rows], values, left=np.nan, right=np.nan)
    out = np.full(len(t), np.nan)
    out[rows] = values
    return out


def _union(times: Sequence[FloatArray]) -> tuple[FloatArray, list[Any]]:
    """All times, each once, and the rows of each table among them."""
    same = min(min(SAME * float(np.median(np.diff(t))), 0.5 * float(np.diff(t).min())) for t in times)
    joined = np.concatenate(times)
    order = np.argsort(joined, kind="stable")
    ordered = joined[order]
    # Stamps of one table are never as close, so that of a group each table has one at most.
    new = np.append(True, np.diff(ordered) > same / len(times))
    row = np.empty(len(joined), np.intp)
    row[order] = np.cumsum(new) - 1
    ends = np.cumsum([len(t) for t in times])
    return ordered[new], np.split(row, ends[:-1])
