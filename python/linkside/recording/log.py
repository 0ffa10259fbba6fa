"""Recordings: reading them from files and tables, with all checks.

A `Log` holds what a controller recorded, as arrays of time × channel. Every check happens while reading, so that no
estimator fails halfway through on a wrong unit of time, an infinity or text in place of a number. NaN marks a missing
sample and is allowed everywhere except in ``t``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv

from linkside.arguments import positive
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, LogError
from linkside.files.tables import column_names, numbers, reading, to_arrow
from linkside.recording.checks.finding import Finding
from linkside.recording.checks.inspector import Inspector, able

from .gathering import frozen, gather, period_of
from .layout import COMMANDS, Layout, RobotColumns
from .merging import merge
from .opening import open_recording
from .pace import Pace, column_rates
from .resampling import at, even_times
from .samples import SampleCheck
from .writer import EstimateWriter

# The period comes from the head of a log only, so that a streamed log and a whole one agree on it exactly.
_HEAD = 10_001


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """A recording: read-only float64 arrays in C order, time × channel; NaN where a sample is missing.

    A signal of which the recording has no column is None; a joint without a column has NaN in its place.

    Attributes
    ----------
    t : (T,)
        Time, strictly increasing [s].
    theta, dtheta : (T, n)
        Motor position [rad] and velocity [rad/s], reflected through the gear to the link side.
    tau : (T, n)
        Motor torque, likewise [N m]: measured at the row's time, or commanded and held until the next row;
        ``motor_torque`` of `ElasticJointFilter` states which.
    acceleration : (T, m)
        Accelerometers: specific force in the sensor's axes [m/s²].
    rate : (T, g)
        Gyroscopes: angular velocity in the sensor's axes [rad/s].
    q, dq, ddq : (T, n)
        Link positions [rad], velocities [rad/s] and accelerations [rad/s²], where sensors measure them.
    torque : (T, n)
        Joint torque sensors: torque of the transmission on the link [N m].
    wrench : (T, 6k)
        Force sensors: force and moment on a link from outside, of each measured wrench [N, N m].
    position : (T, p)
        Trackers: where points of links are, in the tracker's axes [m].
    qref, dqref, ddqref : (T, n)
        Commanded motion [rad, rad/s, rad/s²].
    source : str
        Its origin, for messages.
    period : float
        Median step of ``t`` at the beginning of the recording [s].
    pace : Pace
        How often each channel is read, from the beginning of the recording.
    findings : tuple of Finding
        What the checks found suspicious, or corrected, while it was read.
    """

    t: FloatArray
    theta: FloatArray
    dtheta: FloatArray | None
    tau: FloatArray | None
    acceleration: FloatArray | None
    rate: FloatArray | None
    q: FloatArray | None
    dq: FloatArray | None
    ddq: FloatArray | None
    torque: FloatArray | None
    wrench: FloatArray | None
    position: FloatArray | None
    qref: FloatArray | None
    dqref: FloatArray | None
    ddqref: FloatArray | None
    source: str
    period: float
    pace: Pace
    _layout: Layout
    findings: tuple[Finding, ...] = ()

    def __post_init__(self) -> None:
        """Lay arrays out row by row, as the core reads them; one that is has no copy."""
        for field in fields(self):
            array = getattr(self, field.name)
            if isinstance(array, np.ndarray) and not array.flags.c_contiguous:
                object.__setattr__(self, field.name, frozen(np.ascontiguousarray(array)))

    @classmethod
    def read(cls, path: str | Path, robot: RobotColumns, *, allow_gaps: bool = False, check: bool = True) -> Log:
        """Read a file (Parquet, CSV, MATLAB, HDF5) or a bag; only the columns needed.

        Parameters
        ----------
        path
            The file, or the directory of a rosbag2; of bags, `sources` of robot.yaml says what to take.
        robot
            Whose columns to look for.
        allow_gaps
            Keep steps of time longer than 1.5 times the spacing of the fastest channel's readings, or of rows if that
            is more, instead of refusing them.
        check
            Check the readings first: units, signs, jumps, stuck channels and more, as
            `linkside.recording.checks.CHECKS` lists them. Impossible readings are refused, certain mistakes are
            corrected, and suspicious ones raise a `RecordingWarning`.

        Raises
        ------
        LogError
            When it cannot be used: one line with the file, the column and the row.
        """
        file = open_recording(path, robot)
        layout = Layout.of(robot, file.names, file.source)
        return _whole(file.read(layout.present), layout, file.source, allow_gaps, _inspector(robot, file.source, check))

    @classmethod
    def from_table(
        cls, table: Any, robot: RobotColumns, source: str = "table", *, allow_gaps: bool = False, check: bool = True
    ) -> Log:
        """Take a recording from a pandas or Polars data frame, an Arrow table, or a dict of arrays.

        Memory is shared with the table where its order allows, so do not change the table while the log is in use.
        Raises `LogError` as `read` does.
        """
        with reading(source):
            layout = Layout.of(robot, column_names(table, source), source)
            selected = to_arrow(table, layout.present, source)
        return _whole(selected, layout, source, allow_gaps, _inspector(robot, source, check))

    @classmethod
    def merge(
        cls,
        sources: Sequence[Any],
        robot: RobotColumns,
        *,
        shifts: Sequence[float] | None = None,
        rate: float | None = None,
        check: bool = True,
    ) -> Log:
        """Merge sensors that were recorded separately, with different rates and clocks, by time.

        A row for each time; NaN where a sensor has no reading, which Kalman filters accept; commands are interpolated
        linearly. Readings whose stamps differ by less than 1 % of the shortest period share a row. The recording begins
        when all motor positions have readings.

        Parameters
        ----------
        sources
            Files and tables, each with a column of time and any of the robot's other columns.
        robot
            Whose columns to look for.
        shifts
            By how much each one's clock is ahead [s]; 0 by default.
        rate
            Resample to an even rate [Hz], as observers need it; see `resample`.
        check
            As of `read`; a time in milliseconds, microseconds or nanoseconds is recognised in each of them.

        Raises
        ------
        LogError
            When it cannot be used: one line with the file, the column and the row.
        """
        table, source = merge(sources, robot, [0.0] * len(sources) if shifts is None else shifts, check=check)
        layout = Layout.of(robot, table.column_names, source)
        log = _whole(table, layout, source, True, _inspector(robot, source, check))
        return log if rate is None else log.resample(rate)

    @staticmethod
    def stream(
        path: str | Path, robot: RobotColumns, rows: int = 65_536, *, allow_gaps: bool = False, check: bool = True
    ) -> LogStream:
        """Read a file piece by piece, in bounded memory: an iterable of logs of ``rows`` rows each.

        The needed columns of a bag are in memory as a whole.

        The file, its columns and its period are checked at once, each piece as it is read, and time across
        the borders of pieces. Together the pieces equal ``Log.read`` bit for bit.
        """
        return LogStream(path, robot, rows, allow_gaps=allow_gaps, check=check)

    def resample(self, rate: float) -> Log:
        """Resample to an even rate [Hz]: each channel is interpolated linearly between its readings.

        Readings further apart than 0.05 s have NaN in between. Nothing is filtered, so a rate below that of the fastest
        sensor aliases faster vibrations.

        Raises
        ------
        EstimatorError
            The rate is not positive, or leaves fewer than two rows.
        """
        rate = positive("rate", rate)
        arrays = {s: getattr(self, s) for s in self._layout.wanted if s != "t"}
        signals = {signal: array for signal, array in arrays.items() if array is not None}
        t = even_times(self.t, signals.values(), rate)
        if len(t) < 2:
            raise EstimatorError(f"{self.source}: a rate of {rate:g} Hz leaves {len(t)} rows, at least two are needed")
        even = {signal: frozen(at(t, self.t, array)) for signal, array in signals.items()}
        log = replace(self, t=frozen(t), period=1 / rate, **even)  # type: ignore[arg-type]
        return replace(log, pace=_pace(log[:_HEAD], self._layout))

    def to_arrow(self) -> pa.Table:
        """Convert to an Arrow table, with those columns of the recording that belong to the robot."""
        arrays = self._layout.as_recorded({signal: getattr(self, signal) for signal in self._layout.wanted})
        columns = {
            column: values
            for signal, names in self._layout.wanted.items()
            if arrays[signal] is not None
            for column, values in zip(names, np.atleast_2d(arrays[signal].T), strict=True)
            if column in self._layout.found
        }
        return pa.table({name: pa.array(np.ascontiguousarray(values)) for name, values in columns.items()})

    def write(self, path: str | Path) -> None:
        """Write a Parquet or CSV file (by suffix), whole or not at all, which `read` takes for the same robot.

        Raises
        ------
        OutputError
            When that cannot be.
        """
        with EstimateWriter(path) as writer:
            writer.write(self)

    def require(self, *signals: str, purpose: str = "this estimator") -> tuple[FloatArray, ...]:
        """Require the columns of some signals, and return the signals: ``theta, tau = log.require("theta", "tau")``.

        Torques and link accelerations are needed of elastic joints only, every other signal of all joints. A signal
        that is neither needed nor recorded is NaN.

        Raises
        ------
        LogError
            Naming the first column that is missing.
        """
        for signal in signals:
            for column in self._layout.needed(signal, self.source, purpose):
                if column not in self._layout.found:
                    raise self._layout.missing(column, self.source, f" (needed for {purpose})")
        return tuple(self._signal(signal) for signal in signals)

    def _signal(self, signal: str) -> FloatArray:
        array: FloatArray | None = getattr(self, signal)
        return np.full((len(self), len(self._layout.wanted[signal])), np.nan) if array is None else array

    def require_start(self, purpose: str, signals: Sequence[str] = ("theta",)) -> None:
        """Require every value of ``signals`` in the first row, without which an estimate cannot start from rest.

        Raises
        ------
        LogError
            Naming the first that is missing.
        """
        for signal in signals:
            missing = np.flatnonzero(np.isnan(getattr(self, signal)[0]))
            if len(missing):
                column = self.columns(signal)[int(missing[0])]
                raise LogError(f"{self.source}: row 0: {column} is missing; {purpose} cannot start without it")

    def columns(self, signal: str) -> tuple[str, ...]:
        """Names of a signal's columns, as the recording has them."""
        return self._layout.wanted[signal]

    @property
    def conversions(self) -> tuple[str, ...]:
        """What was converted to SI units, and which currents stand for torques, in words."""
        return self._layout.conversions

    def recorded_size(self, signal: str) -> FloatArray:
        """Factor from each of the recording's columns to the signal, (k,): of its unit, and of the gear."""
        return self._layout.recorded_size(signal)

    def rates(self) -> list[tuple[str, float, float]]:
        """Return, for each column that was read, its rate and the share of rows with a reading."""
        signals = ((names, getattr(self, signal)) for signal, names in self._layout.wanted.items() if signal != "t")
        there = ((names, array) for names, array in signals if array is not None)
        columns = (column for names, array in there for column in zip(names, array.T, strict=True))
        return column_rates(self.t, columns)

    def __len__(self) -> int:
        """Rows."""
        return len(self.t)

    def __getitem__(self, rows: slice) -> Log:
        """Some rows, without a copy: ``log[a:b]`` keeps the period, so that a split run is the whole run."""
        if not isinstance(rows, slice) or (rows.step or 1) < 1:
            raise EstimatorError(f"a log is cut by rows, forwards, as in log[100:200], not by {rows!r}")
        cut = {f.name: getattr(self, f.name) for f in fields(self)}
        cut = {name: a[rows] for name, a in cut.items() if isinstance(a, np.ndarray)}
        first, period = rows.indices(len(self))[0], self.period * (rows.step or 1)
        pace = self.pace.until(self, first) if 0 < first < len(self) else self.pace
        return replace(self, period=period, pace=pace if period == self.period else pace.thinned(period), **cut)

    def __repr__(self) -> str:
        """Source, size and the signals that are there, in one line."""
        signals = " ".join(s for s in self._layout.wanted if getattr(self, s) is not None)
        size = f"{len(self)} rows every {self.period:.6g} s, {self.theta.shape[1]} joints"
        return f"Log({self.source}: {size}, {signals})"


class LogStream:
    """A recording read piece by piece, see `Log.stream`; each ``for`` starts at the beginning.

    Attributes
    ----------
    source : str
        The file.
    count : int or None
        Rows in all, where the file says so (Parquet), for a progress bar.
    period : float
        Median step of ``t`` at the beginning [s].
    conversions : tuple of str
        As of `Log`.
    """

    def __init__(
        self, path: str | Path, robot: RobotColumns, rows: int, *, allow_gaps: bool, check: bool = True
    ) -> None:
        """Open a file and check its columns; `Log.stream` is the way in."""
        if rows < 1:
            raise EstimatorError(f"a stream's pieces have at least one row, not {rows}")
        self._file = open_recording(path, robot)
        self._rows, self._allow_gaps, self._robot, self._checked = rows, allow_gaps, robot, check
        self.source, self.count = self._file.source, self._file.count
        self._layout = Layout.of(robot, self._file.names, self.source)
        self.conversions = self._layout.conversions
        (time,) = self._layout.wanted["t"]
        head = next(self._file.batches(self._layout.present, _HEAD), pa.table({time: pa.array([], pa.float64())}))
        self._seconds, self.period = _clock(
            numbers(head, time, self.source), self._layout, self.source, _inspector(robot, self.source, check)
        )

    def __iter__(self) -> Iterator[Log]:
        """Read from the beginning, each piece checked before it is handed out."""
        inspector = _inspector(self._robot, self.source, self._checked)
        check: SampleCheck | None = None
        pace = self.pace
        for piece in self._file.batches(self._layout.present, self._rows):
            log = _assemble(piece, self._layout, self.source, self.period, self._seconds, pace)
            check = check or SampleCheck(
                self.source, self._layout, np.inf if self._allow_gaps else self.longest_step, self.period
            )
            check(log)
            yield log if inspector is None else inspector(log)
            pace = pace.until(log, len(log))
        if check is not None:
            check.finish()

    @cached_property
    def pace(self) -> Pace:
        """How often each channel is read, by the first rows."""
        head = next(self._file.batches(self._layout.present, _HEAD))
        return _assemble(head, self._layout, self.source, self.period, self._seconds).pace

    @property
    def longest_step(self) -> float:
        """A longer step of time is a gap [s]."""
        return self.pace.longest_step(self.period)


def _whole(table: pa.Table, layout: Layout, source: str, allow_gaps: bool, inspector: Inspector | None) -> Log:
    (time,) = layout.wanted["t"]
    seconds, period = _clock(numbers(table, time, source)[:_HEAD], layout, source, inspector)
    log = _assemble(table, layout, source, period, seconds)
    check = SampleCheck(source, layout, np.inf if allow_gaps else log.pace.longest_step(log.period), log.period)
    check(log)
    check.finish()
    return log if inspector is None else inspector(log)


def _clock(head: FloatArray, layout: Layout, source: str, inspector: Inspector | None) -> tuple[float, float]:
    """How many seconds a unit of time is beyond what robot.yaml says of it, and the period [s]."""
    period = layout.seconds * period_of(head, source)
    seconds = 1.0 if inspector is None else inspector.seconds(period, layout.wanted["t"][0])
    return seconds, seconds * period


def _inspector(robot: RobotColumns, source: str, check: bool) -> Inspector | None:
    """The inspector of a recording; None if no check is wanted, or if only the names of the robot are known."""
    return Inspector(robot, source) if check and able(robot) else None


def _pace(head: Log, layout: Layout) -> Pace:
    """How often channels are read, by the first rows."""
    with np.errstate(invalid="ignore"):  # an infinite time is refused later, with its row
        there = {signal: [c in layout.found for c in columns] for signal, columns in layout.wanted.items()}
        signals = {signal: getattr(head, signal) for signal in layout.wanted if signal not in ("t", *COMMANDS)}
        return Pace.of(head.t, signals, there)


def _assemble(
    table: pa.Table, layout: Layout, source: str, period: float, seconds: float = 1.0, pace: Pace | None = None
) -> Log:
    """Arrange columns as arrays of time × channel, on the link side; ``pace`` is found if these are the first rows."""
    arrays: dict[str, Any] = {s: gather(table, columns, source) for s, columns in layout.wanted.items()}
    arrays["t"] = arrays["t"].reshape(-1)
    arrays = layout.on_link_side(layout.without_motor(arrays))
    if seconds != 1:
        arrays["t"] = seconds * arrays["t"]
    read_only = {signal: None if array is None else frozen(array) for signal, array in arrays.items()}
    log = Log(**read_only, source=source, period=period, pace=pace or Pace(), _layout=layout)  # type: ignore[arg-type]
    return log if pace is not None else replace(log, pace=_pace(log[:_HEAD], layout))
