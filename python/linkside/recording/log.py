"""Recordings: reading them from files and tables, and refusing those that cannot be trusted.

A `Log` holds what a controller recorded, as arrays of time × channel. Every check happens while reading, so
that no estimator meets a wrong unit of time, an infinity or a text in place of a number halfway through its
work. A NaN is a sample that is missing, and is legal everywhere but in ``t``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv

from linkside.arrays import FloatArray
from linkside.channels import CHANNELS, joint_columns
from linkside.errors import EstimatorError, LogError
from linkside.files.tables import column_names, failure, numbers, open_table, reading, to_arrow
from linkside.recording.checks.finding import Finding
from linkside.recording.checks.inspector import Inspector, able

UNMEASURED = ("tau", "ddq", "qref", "dqref", "ddqref")
"""Signals with one column a joint, ``<signal>_<joint>``, beside the channels that filters correct with."""

LARGEST_STEP = 1.5
"""A step of time longer than this many periods is a gap: at least one sample is not there."""

# The period comes from the head of a log only, so that a streamed log and a whole one agree on it exactly.
_HEAD = 10_001


class ColumnNames(Protocol):
    """How a log's columns differ from ours: on the motor shaft, or by name."""

    @property
    def motor_side(self) -> bool:
        """Whether theta, dtheta and tau are those of the motor shaft, before the gear."""

    @property
    def names(self) -> Mapping[str, str]:
        """Our name of a column to the log's."""


class RobotColumns(Protocol):
    """What a log needs to know of a robot."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joints in log order."""

    @property
    def elastic(self) -> npt.NDArray[np.bool_]:
        """Joints with a spring between motor and link, (n,)."""

    @property
    def acceleration_channels(self) -> tuple[str, ...]:
        """Accelerometer columns, such as ``tool_acc_x``."""

    @property
    def acceleration_errors(self) -> tuple[FloatArray, FloatArray]:
        """Bias [m/s²] and scale of each accelerometer column."""

    @property
    def gyroscope_channels(self) -> tuple[str, ...]:
        """Gyroscope columns, such as ``gyro_wx``."""

    @property
    def gear_ratio(self) -> FloatArray:
        """Turns of the motor for one of the link, (n,)."""

    @property
    def columns(self) -> ColumnNames:
        """How the log's columns differ from ours."""


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
        Motor torque, likewise [N m]: at the row's time as sensors read it, or held from it until the next row as
        controllers command it; ``motor_torque`` of `ElasticJointFilter` says which.
    acceleration : (T, m)
        Accelerometers: specific force in the sensor's axes [m/s²].
    rate : (T, g)
        Gyroscopes: angular velocity in the sensor's axes [rad/s].
    q, dq, ddq : (T, n)
        Link positions [rad], velocities [rad/s] and accelerations [rad/s²], where sensors measure them.
    torque : (T, n)
        Joint torque sensors: what the transmission gives the link [N m].
    qref, dqref, ddqref : (T, n)
        Commanded motion [rad, rad/s, rad/s²].
    source : str
        Where it came from, for messages.
    period : float
        Median step of ``t`` at the beginning of the recording [s].
    findings : tuple of Finding
        What the checks found suspicious, or put right, while it was read.
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
    qref: FloatArray | None
    dqref: FloatArray | None
    ddqref: FloatArray | None
    source: str
    period: float
    _layout: _Layout
    findings: tuple[Finding, ...] = ()

    @classmethod
    def read(cls, path: str | Path, robot: RobotColumns, *, allow_gaps: bool = False, check: bool = True) -> Log:
        """Read a Parquet or CSV file (``.parquet``, ``.csv``, ``.csv.gz``); only the columns needed.

        Parameters
        ----------
        path
            The file.
        robot
            Whose columns to look for.
        allow_gaps
            Keep steps of time longer than 1.5 periods instead of refusing them.
        check
            Look at the readings before they are believed: units, signs, jumps, stuck channels and more, as
            `linkside.recording.checks.CHECKS` lists them. What is impossible is refused, what is certain put right, and
            what is suspicious warned of with a `RecordingWarning`.

        Raises
        ------
        LogError
            When it cannot be used: one line with the file, the column and the row.
        """
        file = open_table(path)
        layout = _Layout.of(robot, file.names, file.source)
        return _whole(file.read(layout.present), layout, file.source, allow_gaps, _inspector(robot, file.source, check))

    @classmethod
    def from_table(
        cls, table: Any, robot: RobotColumns, source: str = "table", *, allow_gaps: bool = False, check: bool = True
    ) -> Log:
        """Take a recording from a pandas or Polars data frame, an Arrow table, or a dict of arrays.

        Memory is borrowed where its order allows, so leave the table alone while the log is in use. Raises
        `LogError` as `read` does.
        """
        with reading(source):
            layout = _Layout.of(robot, column_names(table, source), source)
            selected = to_arrow(table, layout.present, source)
        return _whole(selected, layout, source, allow_gaps, _inspector(robot, source, check))

    @staticmethod
    def stream(
        path: str | Path, robot: RobotColumns, rows: int = 65_536, *, allow_gaps: bool = False, check: bool = True
    ) -> LogStream:
        """Read a file piece by piece, in bounded memory: an iterable of logs of ``rows`` rows each.

        The file, its columns and its period are checked at once, each piece as it is read, and time across
        the borders of pieces. Together the pieces equal ``Log.read`` bit for bit.
        """
        return LogStream(path, robot, rows, allow_gaps=allow_gaps, check=check)

    def require(self, *signals: str, purpose: str = "this estimator") -> None:
        """Insist on the columns of some signals: ``log.require("tau", "acceleration")``.

        Torques and link accelerations are needed of elastic joints only, every other signal of all joints.

        Raises
        ------
        LogError
            Naming the first column that is missing.
        """
        for signal in signals:
            for column in self._layout.needed(signal, self.source, purpose):
                if column not in self._layout.found:
                    raise self._layout.missing(column, self.source, f" (needed for {purpose})")

    def require_start(self, purpose: str, signals: Sequence[str] = ("theta",)) -> None:
        """Insist on every value of ``signals`` in the first row: an estimate cannot start from rest without.

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

    def __len__(self) -> int:
        """Rows."""
        return len(self.t)

    def __getitem__(self, rows: slice) -> Log:
        """Some rows, without a copy: ``log[a:b]`` keeps the period, so that a split run is the whole run."""
        if not isinstance(rows, slice) or (rows.step or 1) < 1:
            raise EstimatorError(f"a log is cut by rows, forwards, as in log[100:200], not by {rows!r}")
        cut = {f.name: getattr(self, f.name) for f in fields(self)}
        cut = {name: a[rows] for name, a in cut.items() if isinstance(a, np.ndarray)}
        if (rows.step or 1) > 1:
            cut = {name: _frozen(np.ascontiguousarray(a)) for name, a in cut.items()}
        return replace(self, period=self.period * (rows.step or 1), **cut)

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
    """

    def __init__(
        self, path: str | Path, robot: RobotColumns, rows: int, *, allow_gaps: bool, check: bool = True
    ) -> None:
        """Open a file and check its columns; `Log.stream` is the way in."""
        if rows < 1:
            raise EstimatorError(f"a stream's pieces have at least one row, not {rows}")
        self._file = open_table(path)
        self._rows, self._allow_gaps, self._robot, self._checked = rows, allow_gaps, robot, check
        self.source, self.count = self._file.source, self._file.count
        self._layout = _Layout.of(robot, self._file.names, self.source)
        (time,) = self._layout.wanted["t"]
        head = next(self._file.batches([time], _HEAD), pa.table({time: pa.array([], pa.float64())}))
        period = _period(numbers(head, time, self.source), self.source)
        self._seconds = 1.0 if (i := _inspector(robot, self.source, check)) is None else i.seconds(period, time)
        self.period = self._seconds * period

    def __iter__(self) -> Iterator[Log]:
        """Read from the beginning, each piece checked before it is handed out."""
        check = _Check(self.source, self._layout, self.period, self._allow_gaps)
        inspector = _inspector(self._robot, self.source, self._checked)
        for piece in self._file.batches(self._layout.present, self._rows):
            log = _assemble(piece, self._layout, self.source, self.period, self._seconds)
            check(log)
            yield log if inspector is None else inspector(log)
        check.finish()


def log_rows(path: str | Path) -> int | None:
    """Rows of a recording where the file says so (Parquet), None where only reading it would tell (CSV)."""
    return open_table(path).count


@dataclass(frozen=True)
class _Layout:
    """Which columns of a log hold which signal of a robot."""

    wanted: dict[str, tuple[str, ...]]
    found: tuple[str, ...]
    elastic: tuple[bool, ...]
    shaft_ratio: FloatArray | None
    acceleration_errors: tuple[FloatArray, FloatArray] | None

    @classmethod
    def of(cls, robot: RobotColumns, found: list[str], source: str) -> _Layout:
        """Find a robot's signals among a log's columns; time and motor positions must be there."""
        measured = {channel.signal: channel.columns(robot) for channel in CHANNELS.values()}
        others = {signal: joint_columns(signal, robot.names) for signal in UNMEASURED}
        inertial = {signal: measured.pop(signal) for signal in ("acceleration", "rate")}
        ours = {"t": ("t",)} | measured | others | inertial
        renamed = robot.columns.names
        wanted = {signal: tuple(renamed.get(c, c) for c in columns) for signal, columns in ours.items()}
        ratio = np.asarray(robot.gear_ratio, float) if robot.columns.motor_side else None
        bias, scale = robot.acceleration_errors
        errors = (bias, scale) if np.any(bias) or np.any(scale != 1) else None
        layout = cls(wanted, tuple(found), tuple(map(bool, robot.elastic)), ratio, errors)
        layout._check(source)
        return layout

    @property
    def present(self) -> list[str]:
        """The columns to read: wanted and found, each once."""
        wanted = (column for columns in self.wanted.values() for column in columns)
        return [column for column in dict.fromkeys(wanted) if column in self.found]

    def needed(self, signal: str, source: str, purpose: str) -> list[str]:
        """Columns without which a signal is of no use."""
        if signal not in self.wanted:
            raise EstimatorError(f"{signal!r} is no signal of a log; there are {', '.join(self.wanted)}")
        columns = self.wanted[signal]
        if signal in ("acceleration", "rate") and not columns:
            sensor = "accelerometer" if signal == "acceleration" else "gyroscope"
            raise failure(source, f"the robot has no {sensor} to read a column of (needed for {purpose})")
        if signal in ("tau", "ddq"):
            return [column for column, elastic in zip(columns, self.elastic, strict=True) if elastic]
        return list(columns)

    def missing(self, column: str, source: str, why: str = "") -> LogError:
        """Say that a column is missing, and what it might be called instead."""
        close = difflib.get_close_matches(column, set(self.found) - set(self.present), n=1, cutoff=0.75)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return failure(source, f"column {column!r} is missing{why}{hint}")

    def _check(self, source: str) -> None:
        for column in self.wanted["t"] + self.wanted["theta"]:
            if column not in self.found:
                raise self.missing(column, source)
        for column in self.present:
            if self.found.count(column) > 1:
                raise failure(source, f"column {column!r} is there {self.found.count(column)} times")


class _Check:
    """Checks of the samples, carried from one piece of a log to the next."""

    def __init__(self, source: str, layout: _Layout, period: float, allow_gaps: bool) -> None:
        self._source, self._layout, self._period = source, layout, period
        self._longest = np.inf if allow_gaps else LARGEST_STEP * period
        self._rows = 0
        self._last: FloatArray = np.empty(0)
        self._seen = {s: np.zeros(len(columns), bool) for s, columns in layout.wanted.items()}

    def __call__(self, log: Log) -> None:
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


def _whole(table: pa.Table, layout: _Layout, source: str, allow_gaps: bool, inspector: Inspector | None) -> Log:
    (time,) = layout.wanted["t"]
    period = _period(numbers(table, time, source)[:_HEAD], source)
    seconds = 1.0 if inspector is None else inspector.seconds(period, time)
    log = _assemble(table, layout, source, seconds * period, seconds)
    check = _Check(source, layout, seconds * period, allow_gaps)
    check(log)
    check.finish()
    return log if inspector is None else inspector(log)


def _inspector(robot: RobotColumns, source: str, check: bool) -> Inspector | None:
    """What looks at a recording before it is believed; None where that is not wanted, or the robot is but names."""
    return Inspector(robot, source) if check and able(robot) else None


def _period(head: FloatArray, source: str) -> float:
    if len(head) < 2:
        rows = "has no rows" if len(head) == 0 else "has a single row"
        raise failure(source, f"the log {rows}: at least two are needed")
    with np.errstate(invalid="ignore"):  # an infinite time is refused later, with its row
        return float(np.median(np.diff(head)))


def _assemble(table: pa.Table, layout: _Layout, source: str, period: float, seconds: float = 1.0) -> Log:
    """Arrange columns as arrays of time × channel, on the link side."""
    arrays: dict[str, Any] = {s: _gather(table, columns, source) for s, columns in layout.wanted.items()}
    arrays["t"] = arrays["t"].reshape(-1) if seconds == 1 else seconds * arrays["t"].reshape(-1)
    if layout.shaft_ratio is not None:
        for signal, reflect in (("theta", np.divide), ("dtheta", np.divide), ("tau", np.multiply)):
            if arrays[signal] is not None:
                arrays[signal] = reflect(arrays[signal], layout.shaft_ratio)
    if layout.acceleration_errors is not None and arrays["acceleration"] is not None:
        bias, scale = layout.acceleration_errors
        arrays["acceleration"] = (arrays["acceleration"] - bias) / scale
    frozen = {signal: None if array is None else _frozen(array) for signal, array in arrays.items()}
    return Log(**frozen, source=source, period=period, _layout=layout)  # type: ignore[arg-type]


def _gather(table: pa.Table, columns: tuple[str, ...], source: str) -> FloatArray | None:
    present = set(table.column_names)
    if not present.intersection(columns):
        return None
    if len(columns) == 1:  # already contiguous: no copy
        return numbers(table, columns[0], source).reshape(-1, 1)
    out = np.full((table.num_rows, len(columns)), np.nan)
    for channel, column in enumerate(columns):
        if column in present:
            out[:, channel] = numbers(table, column, source)
    return out


def _frozen(array: FloatArray) -> FloatArray:
    view: FloatArray = array.view()
    view.flags.writeable = False
    return view
