"""Recordings: reading them from files and tables, and refusing those that cannot be trusted.

A `Log` holds what a controller recorded, as arrays of time × channel. Every check happens while reading, so
that no estimator meets a wrong unit of time, an infinity or a text in place of a number halfway through its
work. A NaN is a sample that is missing, and is legal everywhere but in ``t``.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Protocol, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from linkside.errors import EstimatorError, LogError

FloatArray: TypeAlias = npt.NDArray[np.float64]

JOINT_SIGNALS = ("theta", "dtheta", "tau", "q", "ddq", "torque", "qref", "dqref", "ddqref")
"""Signals with one column a joint, ``<signal>_<joint>``."""

LARGEST_STEP = 1.5
"""A step of time longer than this many periods is a gap: at least one sample is not there."""

# The period comes from the head of a log only, so that a streamed log and a whole one agree on it exactly.
_HEAD = 10_001
_NUMBER = r"^\s*[-+]?((\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|(?i:inf|infinity|nan))\s*$"


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
        Motor torque, likewise [N m].
    acceleration : (T, m)
        Accelerometers: specific force in the sensor's axes [m/s²].
    rate : (T, g)
        Gyroscopes: angular velocity in the sensor's axes [rad/s].
    q, ddq : (T, n)
        Link positions [rad] and accelerations [rad/s²], where sensors measure them.
    torque : (T, n)
        Joint torque sensors: what the transmission gives the link [N m].
    qref, dqref, ddqref : (T, n)
        Commanded motion [rad, rad/s, rad/s²].
    source : str
        Where it came from, for messages.
    period : float
        Median step of ``t`` at the beginning of the recording [s].
    """

    t: FloatArray
    theta: FloatArray
    dtheta: FloatArray | None
    tau: FloatArray | None
    acceleration: FloatArray | None
    rate: FloatArray | None
    q: FloatArray | None
    ddq: FloatArray | None
    torque: FloatArray | None
    qref: FloatArray | None
    dqref: FloatArray | None
    ddqref: FloatArray | None
    source: str
    period: float
    _layout: _Layout

    @classmethod
    def read(cls, path: str | Path, robot: RobotColumns, *, allow_gaps: bool = False) -> Log:
        """Read a Parquet or CSV file (``.parquet``, ``.csv``, ``.csv.gz``); only the columns needed.

        Parameters
        ----------
        path
            The file.
        robot
            Whose columns to look for.
        allow_gaps
            Keep steps of time longer than 1.5 periods instead of refusing them.

        Raises
        ------
        LogError
            When it cannot be used: one line with the file, the column and the row.
        """
        file = open_table(path)
        layout = _Layout.of(robot, file.names, file.source)
        return _whole(file.read(layout.present), layout, file.source, allow_gaps)

    @classmethod
    def from_table(cls, table: Any, robot: RobotColumns, source: str = "table", *, allow_gaps: bool = False) -> Log:
        """Take a recording from a pandas or Polars data frame, an Arrow table, or a dict of arrays.

        Memory is borrowed where its order allows, so leave the table alone while the log is in use. Raises
        `LogError` as `read` does.
        """
        with _reading(source):
            layout = _Layout.of(robot, _column_names(table, source), source)
            selected = _to_arrow(table, layout.present, source)
        return _whole(selected, layout, source, allow_gaps)

    @staticmethod
    def stream(path: str | Path, robot: RobotColumns, rows: int = 65_536, *, allow_gaps: bool = False) -> LogStream:
        """Read a file piece by piece, in bounded memory: an iterable of logs of ``rows`` rows each.

        The file, its columns and its period are checked at once, each piece as it is read, and time across
        the borders of pieces. Together the pieces equal ``Log.read`` bit for bit.
        """
        return LogStream(path, robot, rows, allow_gaps=allow_gaps)

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

    def column(self, signal: str, channel: int) -> str:
        """Name of one of a signal's columns, as the recording has it."""
        return self._layout.wanted[signal][channel]

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

    def __init__(self, path: str | Path, robot: RobotColumns, rows: int, *, allow_gaps: bool) -> None:
        """Open a file and check its columns; `Log.stream` is the way in."""
        if rows < 1:
            raise EstimatorError(f"a stream's pieces have at least one row, not {rows}")
        self._file = open_table(path)
        self._rows, self._allow_gaps = rows, allow_gaps
        self.source, self.count = self._file.source, self._file.count
        self._layout = _Layout.of(robot, self._file.names, self.source)
        (time,) = self._layout.wanted["t"]
        head = next(self._file.batches([time], _HEAD), pa.table({time: pa.array([], pa.float64())}))
        self.period = _period(numbers(head, time, self.source), self.source)

    def __iter__(self) -> Iterator[Log]:
        """Read from the beginning, each piece checked before it is handed out."""
        check = _Check(self.source, self._layout, self.period, self._allow_gaps)
        for piece in self._file.batches(self._layout.present, self._rows):
            log = _assemble(piece, self._layout, self.source, self.period)
            check(log)
            yield log
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

    @classmethod
    def of(cls, robot: RobotColumns, found: list[str], source: str) -> _Layout:
        """Find a robot's signals among a log's columns; time and motor positions must be there."""
        ours = {"t": ("t",)} | {s: tuple(f"{s}_{joint}" for joint in robot.names) for s in JOINT_SIGNALS}
        ours |= {"acceleration": tuple(robot.acceleration_channels), "rate": tuple(robot.gyroscope_channels)}
        renamed = robot.columns.names
        wanted = {signal: tuple(renamed.get(c, c) for c in columns) for signal, columns in ours.items()}
        ratio = np.asarray(robot.gear_ratio, float) if robot.columns.motor_side else None
        layout = cls(wanted, tuple(found), tuple(map(bool, robot.elastic)), ratio)
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
            raise _fail(source, f"the robot has no {sensor} to read a column of (needed for {purpose})")
        if signal in ("tau", "ddq"):
            return [column for column, elastic in zip(columns, self.elastic, strict=True) if elastic]
        return list(columns)

    def missing(self, column: str, source: str, why: str = "") -> LogError:
        """Say that a column is missing, and what it might be called instead."""
        close = difflib.get_close_matches(column, set(self.found) - set(self.present), n=1, cutoff=0.75)
        hint = f"; did you mean {close[0]!r}?" if close else ""
        return _fail(source, f"column {column!r} is missing{why}{hint}")

    def _check(self, source: str) -> None:
        for column in self.wanted["t"] + self.wanted["theta"]:
            if column not in self.found:
                raise self.missing(column, source)
        for column in self.present:
            if self.found.count(column) > 1:
                raise _fail(source, f"column {column!r} is there {self.found.count(column)} times")


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
                    raise _fail(self._source, f"column {column!r} is NaN throughout: not a single sample")

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
        return _fail(self._source, f"column {column!r} {what} at row {self._rows + row}{when}")


def _whole(table: pa.Table, layout: _Layout, source: str, allow_gaps: bool) -> Log:
    (time,) = layout.wanted["t"]
    period = _period(numbers(table, time, source)[:_HEAD], source)
    log = _assemble(table, layout, source, period)
    check = _Check(source, layout, period, allow_gaps)
    check(log)
    check.finish()
    return log


def _period(head: FloatArray, source: str) -> float:
    if len(head) < 2:
        rows = "has no rows" if len(head) == 0 else "has a single row"
        raise _fail(source, f"the log {rows}: at least two are needed")
    with np.errstate(invalid="ignore"):  # an infinite time is refused later, with its row
        return float(np.median(np.diff(head)))


def _assemble(table: pa.Table, layout: _Layout, source: str, period: float) -> Log:
    """Arrange columns as arrays of time × channel, on the link side."""
    arrays: dict[str, Any] = {s: _gather(table, columns, source) for s, columns in layout.wanted.items()}
    arrays["t"] = arrays["t"].reshape(-1)
    if layout.shaft_ratio is not None:
        for signal, reflect in (("theta", np.divide), ("dtheta", np.divide), ("tau", np.multiply)):
            if arrays[signal] is not None:
                arrays[signal] = reflect(arrays[signal], layout.shaft_ratio)
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


def numbers(table: pa.Table, name: str, source: str) -> FloatArray:
    """Read a column as float64, without a copy where it is that already; nulls become NaN."""
    column = table.column(name)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    kind, is_a = column.type, pa.types
    if is_a.is_temporal(kind):
        raise _fail(source, f"column {name!r} is {kind}: seconds as a float are expected")
    if is_a.is_nested(kind):
        raise _fail(source, f"column {name!r} is {kind}: one number a row is expected")
    if not (is_a.is_floating(kind) or is_a.is_integer(kind) or is_a.is_decimal(kind) or is_a.is_null(kind)):
        raise _fail(source, f"column {name!r} is {kind}: numbers are expected")
    with _reading(source):
        array: FloatArray = column.cast(pa.float64(), safe=False).to_numpy()
    return array


class ParquetTable:
    """A Parquet file: its columns and rows known at once, its samples read on demand."""

    def __init__(self, path: str | Path) -> None:
        """Read the names of the columns."""
        self.source = str(path)
        with _reading(self.source), pq.ParquetFile(self.source) as file:
            self.names: list[str] = list(file.schema_arrow.names)
            self.count: int | None = file.metadata.num_rows

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""
        with _reading(self.source), pq.ParquetFile(self.source) as file:
            return file.read(columns=columns)

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter."""
        # Buffered page by page: by default Arrow holds whole row groups, which can be as large as the file.
        with _reading(self.source), pq.ParquetFile(self.source, buffer_size=65_536, pre_buffer=False) as file:
            yield from _regroup(file.iter_batches(batch_size=rows, columns=columns), rows)


class CsvTable:
    """A CSV file with a header, plain or compressed with gzip; every column that is read holds numbers."""

    count: int | None = None

    def __init__(self, path: str | Path) -> None:
        """Read the names of the columns."""
        self.source = str(path)
        with _reading(self.source), self._opened() as file:
            self.names: list[str] = list(file.schema.names)

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""
        with _reading(self.source), self._naming_cells(columns):
            return pa.csv.read_csv(self.source, convert_options=_conversion(columns, pa.float64()))

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter."""
        options = _conversion(columns, pa.float64())
        with _reading(self.source), self._naming_cells(columns), self._opened(options) as file:
            yield from _regroup(file, rows)

    @contextmanager
    def _opened(self, options: pa.csv.ConvertOptions | None = None) -> Iterator[pa.csv.CSVStreamingReader]:
        ragged: list[pa.csv.InvalidRow] = []

        def refuse(row: pa.csv.InvalidRow) -> str:
            ragged.append(row)
            return "error"

        one_thread = pa.csv.ReadOptions(use_threads=False)  # rows have numbers only then
        parse = pa.csv.ParseOptions(invalid_row_handler=refuse)
        try:
            with pa.csv.open_csv(self.source, one_thread, parse, options) as file:
                yield file
        except pa.ArrowInvalid as error:
            for row in ragged:
                sizes = f"{row.actual_columns} columns where the header has {row.expected_columns}"
                raise _fail(self.source, f"row {row.number - 2} has {sizes}") from error
            raise

    @contextmanager
    def _naming_cells(self, columns: list[str]) -> Iterator[None]:
        try:
            yield
        except pa.ArrowInvalid as error:
            # Arrow does not say in which row: read once more, as text, and look for it.
            raise self._first_text(columns) or error from error

    def _first_text(self, columns: list[str]) -> LogError | None:
        """Say where the first cell is that holds no number; columns begin with that of time."""
        first_row = 0
        with self._opened(_conversion(columns, pa.string())) as file:
            for batch in file:
                for name in columns:
                    number = pc.match_substring_regex(batch.column(name), _NUMBER)
                    row = pc.index(pc.fill_null(number, True), False).as_py()
                    if row >= 0:
                        cell = f"{batch.column(name)[row].as_py()!r} at row {first_row + row}"
                        what = "seconds as a float are" if name == columns[0] else "a number is"
                        return _fail(self.source, f"column {name!r} is {cell}: {what} expected")
                first_row += batch.num_rows
        return None


def open_table(path: str | Path) -> ParquetTable | CsvTable:
    """Open a file by its suffix, for reading some of its columns; `LogError` when that cannot be."""
    name = str(path).lower()
    if not name.endswith((".parquet", ".csv", ".csv.gz")):
        raise _fail(str(path), "a file that ends in .parquet, .csv or .csv.gz is expected")
    with _reading(str(path)):  # a name may also be too long, or out of reach
        if not Path(path).exists():
            raise _fail(str(path), "no such file")
        if Path(path).is_dir():
            raise _fail(str(path), "this is a directory, a file is expected")
    return ParquetTable(path) if name.endswith(".parquet") else CsvTable(path)


def _conversion(columns: list[str], kind: pa.DataType) -> pa.csv.ConvertOptions:
    types = dict.fromkeys(columns, kind)
    return pa.csv.ConvertOptions(include_columns=columns, column_types=types, strings_can_be_null=True)


def _regroup(batches: Any, rows: int) -> Iterator[pa.Table]:
    """Cut record batches of any length into tables of exactly ``rows`` rows, the last one shorter."""
    held: list[pa.RecordBatch] = []
    count = 0
    for batch in batches:
        held.append(batch)
        count += batch.num_rows
        while count >= rows:
            table = pa.Table.from_batches(held)
            yield table.slice(0, rows)
            held, count = table.slice(rows).to_batches(), count - rows
    if count:
        yield pa.Table.from_batches(held)


def _column_names(table: Any, source: str) -> list[str]:
    if isinstance(table, Mapping):
        return [str(name) for name in table]
    if isinstance(table, pa.Table | pa.RecordBatch):
        return list(table.schema.names)
    if hasattr(table, "columns") and (hasattr(table, "iloc") or hasattr(table, "__arrow_c_stream__")):
        return [str(name) for name in table.columns]
    kinds = "a pandas or Polars data frame, an Arrow table or a dict of arrays"
    raise _fail(source, f"{kinds} is expected, not {type(table).__name__}")


def _to_arrow(table: Any, columns: list[str], source: str) -> pa.Table:
    if isinstance(table, Mapping):
        return _from_arrays({name: table[name] for name in columns}, source)
    if isinstance(table, pa.RecordBatch):
        table = pa.Table.from_batches([table])
    if isinstance(table, pa.Table):
        return table.select(columns)
    if hasattr(table, "iloc"):  # pandas before 2.2 has no stream of Arrow data
        return pa.Table.from_pandas(table[columns], preserve_index=False)
    return pa.table(table[columns])


def _from_arrays(arrays: dict[str, Any], source: str) -> pa.Table:
    table: dict[str, pa.Array] = {}
    rows: int | None = None
    for name, values in arrays.items():
        array = _one_dimensional(name, values, source)
        rows = len(array) if rows is None else rows
        if len(array) != rows:
            raise _fail(source, f"column {name!r} has {len(array)} rows where the others have {rows}")
        table[name] = pa.array(array)
    return pa.table(table)


def _one_dimensional(name: str, values: Any, source: str) -> npt.NDArray[Any]:
    try:
        array = np.asanyarray(values)
    except ValueError as error:
        raise _fail(source, f"column {name!r} is ragged: one number a row is expected") from error
    if array.ndim != 1:
        raise _fail(source, f"column {name!r} has shape {array.shape}: one number a row is expected")
    # Arrow refuses foreign byte orders and long doubles, which NumPy converts; a mask it understands itself.
    plain = array.dtype.kind in "fiu" and not isinstance(array, np.ma.MaskedArray)
    return np.asarray(array, np.float64) if plain else array


@contextmanager
def _reading(source: str) -> Iterator[None]:
    """Turn whatever reading broken data raises into one line."""
    try:
        yield
    except LogError:
        raise
    except (pa.ArrowException, OSError, ValueError, EOFError, MemoryError, OverflowError) as error:
        raise _fail(source, f"cannot be read: {error}") from error


def _fail(source: str, text: str) -> LogError:
    return LogError(" ".join(f"{source}: {text}".splitlines()))
