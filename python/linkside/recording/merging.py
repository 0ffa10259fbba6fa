"""Recordings of sensors with clocks and rates of their own, as one."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from linkside.errors import EstimatorError, RecordingWarning
from linkside.files.joining import Part, join
from linkside.files.tables import column_names, failure, numbers, reading, to_arrow

from .checks import clock
from .checks.inspector import able
from .layout import COMMANDS, RobotColumns, currents, signal_columns, time_unit
from .opening import open_recording


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
        _part(source, f"table {number}", robot, columns, shift, rate, check)
        for number, (source, shift) in enumerate(zip(sources, shifts, strict=True))
    ]
    name = " + ".join(part.source for part in parts)
    unit = time_unit(robot)
    table = join(parts, columns["t"][0], {column for signal in COMMANDS for column in columns[signal]})
    positions = [column for column in columns["theta"] if column in table]
    complete = ~np.isnan([table[column] for column in positions]).any(axis=0)
    if not complete.any():
        raise failure(name, f"{' and '.join(map(repr, positions))} are never read together: resample them (rate=…)")
    table[columns["t"][0]] = table[columns["t"][0]] / unit  # as in each file
    return pa.table({column: values[int(np.argmax(complete)) :] for column, values in table.items()}), name


def _part(
    source: Any,
    name: str,
    robot: RobotColumns,
    columns: Mapping[str, tuple[str, ...]],
    shift: float,
    rate: float | None,
    check: bool,
) -> Part:
    """Read what the robot has columns for."""
    is_file = isinstance(source, str | Path)
    file = open_recording(source, robot) if is_file else None
    name = file.source if file is not None else name
    names = file.names if file is not None else column_names(source, name)
    (time,) = columns["t"]
    wanted = {column for signal, own in columns.items() if signal != "t" for column in own}
    wanted |= {current for current, _ in currents(robot).values()}
    found = [column for column in dict.fromkeys(names) if column in wanted]
    for column in (time, *found):
        if names.count(column) != 1:
            there = f"is there {names.count(column)} times" if column in names else "is missing"
            raise failure(name, f"column {column!r} {there}")
    if not found:
        raise failure(name, f"no column is one of the robot's ({', '.join(sorted(wanted)[:3])}, …)")
    with reading(name):
        table = file.read([time, *found]) if file is not None else to_arrow(source, [time, *found], name)
    t = time_unit(robot) * numbers(table, time, name)
    steps = np.diff(t)
    if len(t) < 2 or not (np.isfinite(t).all() and (steps > 0).all()):
        row = int(np.argmin(np.isfinite(t) & (np.append(1.0, steps) > 0))) if len(t) > 1 else 0
        raise failure(name, f"column {time!r} does not increase at row {row}, or has fewer than two rows")
    seconds = _seconds(float(np.median(steps)), rate, time, name) if check else 1.0
    return Part(name, seconds * t - shift, {column: numbers(table, column, name) for column in found})


def _seconds(period: float, rate: float | None, column: str, source: str) -> float:
    """How many seconds a unit of time is; tables other than the motors' have rates that robot.yaml does not state."""
    found = clock.unit(period, rate, column) or clock.unit(period, None, column)
    if found is None or found.size is None:
        return 1.0
    warnings.warn(f"{source}: {found}", RecordingWarning, stacklevel=5)
    return found.size
