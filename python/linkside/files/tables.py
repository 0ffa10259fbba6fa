"""Tables of samples: Parquet and CSV files and the tables of other libraries, as Arrow."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq

from linkside.arrays import FloatArray
from linkside.errors import LogError

from .csv_dialect import Dialect

_NUMBER = r"^\s*[-+]?((\d+{0}?\d*|{0}\d+)([eE][-+]?\d+)?|(?i:inf|infinity|nan))\s*$"

MOST_COLUMNS = 10_000
"""Columns of a recording."""


def numbers(table: pa.Table, name: str, source: str) -> FloatArray:
    """Read a column as float64, without a copy where it is that already; nulls become NaN."""
    column = table.column(name)
    if pa.types.is_dictionary(column.type):
        column = column.cast(column.type.value_type)
    kind, is_a = column.type, pa.types
    if is_a.is_temporal(kind):
        raise failure(source, f"column {name!r} is {kind}: seconds as a float are expected")
    if is_a.is_nested(kind):
        raise failure(source, f"column {name!r} is {kind}: one number a row is expected")
    if not (is_a.is_floating(kind) or is_a.is_integer(kind) or is_a.is_decimal(kind) or is_a.is_null(kind)):
        raise failure(source, f"column {name!r} is {kind}: numbers are expected")
    with reading(source):
        array: FloatArray = column.cast(pa.float64(), safe=False).to_numpy()
    return array


class Table(Protocol):
    """A table of named columns, which are read when they are asked for.

    Attributes
    ----------
    source : str
        Where it comes from, for messages.
    names : list of str
        Its columns.
    count : int or None
        Its rows, None where only reading it would tell.
    """

    source: str
    names: list[str]
    count: int | None

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter."""


class ArrowTable:
    """A table in memory, with what is to be known of it (``metadata``)."""

    def __init__(self, table: pa.Table, source: str, metadata: Mapping[str, str] | None = None) -> None:
        """Take a table."""
        self.source = source
        self.metadata = dict(metadata or {})
        self.names: list[str] = list(table.column_names)
        self.count: int | None = table.num_rows
        self._table = table

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""
        return self._table.select(columns)

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter."""
        table = self.read(columns)
        yield from (table.slice(first, rows) for first in range(0, table.num_rows, rows))

    def timed(self, name: str, unit: float) -> ArrowTable:
        """The same with another name of its column ``t``, which is in seconds, and in another unit [s]."""
        index = self.names.index("t")
        time = self._table.column(index)
        time = time if unit == 1 else pc.divide(time, unit)
        return ArrowTable(self._table.set_column(index, name, time), self.source, self.metadata)

    def to_arrow(self) -> pa.Table:
        """The table itself."""
        return self._table


class ParquetTable:
    """A Parquet file: its columns and rows known at once, its samples read on demand."""

    def __init__(self, path: str | Path) -> None:
        """Read the names of the columns."""
        self.source = str(path)
        with reading(self.source), pq.ParquetFile(self.source) as file:
            self.names: list[str] = list(file.schema_arrow.names)
            self.count: int | None = file.metadata.num_rows
        _refuse_many(self.names, self.source)

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""
        with reading(self.source), pq.ParquetFile(self.source) as file:
            return file.read(columns=columns)

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter."""
        # Buffered page by page: by default Arrow holds whole row groups, which can be as large as the file.
        with reading(self.source), pq.ParquetFile(self.source, buffer_size=65_536, pre_buffer=False) as file:
            yield from _regroup(file.iter_batches(batch_size=rows, columns=columns), rows)


class CsvTable:
    """A CSV file with a header, plain or compressed with gzip; every column that is read holds numbers.

    Separator, decimal mark and encoding are recognised: `csv_dialect`.
    """

    count: int | None = None

    def __init__(self, path: str | Path) -> None:
        """Read the names of the columns."""
        self.source = str(path)
        with reading(self.source):
            self._dialect = Dialect.of(path)
        self.names: list[str] = list(self._dialect.names)
        _refuse_many(self.names, self.source)

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""
        with reading(self.source), self._naming_cells(columns):
            options = self._read_options(), self._parse_options(), self._conversion(columns, pa.float64())
            return pa.csv.read_csv(self.source, *options)

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter."""
        options = self._conversion(columns, pa.float64())
        with reading(self.source), self._naming_cells(columns), self._opened(options) as file:
            yield from _regroup(file, rows)

    def _read_options(self, **settings: Any) -> pa.csv.ReadOptions:
        dialect = self._dialect
        encoding = dialect.encoding.removesuffix("-sig")  # Arrow knows that mark itself
        return pa.csv.ReadOptions(
            column_names=list(dialect.names), skip_rows=dialect.skipped, encoding=encoding, **settings
        )

    def _parse_options(self, **settings: Any) -> pa.csv.ParseOptions:
        return pa.csv.ParseOptions(delimiter=self._dialect.separator, **settings)

    def _conversion(self, columns: list[str], kind: pa.DataType) -> pa.csv.ConvertOptions:
        return pa.csv.ConvertOptions(
            include_columns=columns,
            column_types=dict.fromkeys(columns, kind),
            strings_can_be_null=True,
            decimal_point=self._dialect.decimal,
        )

    @contextmanager
    def _opened(self, options: pa.csv.ConvertOptions | None = None) -> Iterator[pa.csv.CSVStreamingReader]:
        ragged: list[pa.csv.InvalidRow] = []

        def refuse(row: pa.csv.InvalidRow) -> str:
            ragged.append(row)
            return "error"

        one_thread = self._read_options(use_threads=False)  # rows have numbers only then
        parse = self._parse_options(invalid_row_handler=refuse)
        try:
            with pa.csv.open_csv(self.source, one_thread, parse, options) as file:
                yield file
        except pa.ArrowInvalid as error:
            for row in ragged:
                sizes = f"{row.actual_columns} columns where the header has {row.expected_columns}"
                raise failure(self.source, f"row {row.number - 1 - self._dialect.skipped} has {sizes}") from error
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
        first_row, pattern = 0, _NUMBER.format(re.escape(self._dialect.decimal))
        with self._opened(self._conversion(columns, pa.string())) as file:
            for batch in file:
                for name in columns:
                    number = pc.match_substring_regex(batch.column(name), pattern)
                    row = pc.index(pc.fill_null(number, True), False).as_py()
                    if row >= 0:
                        cell = f"{batch.column(name)[row].as_py()!r} at row {first_row + row}"
                        what = "seconds as a float are" if name == columns[0] else "a number is"
                        return failure(self.source, f"column {name!r} is {cell}: {what} expected")
                first_row += batch.num_rows
        return None


def _refuse_many(names: list[str], source: str) -> None:
    if len(names) > MOST_COLUMNS:
        raise failure(source, f"at most {MOST_COLUMNS} columns are expected, not {len(names)}")


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


def column_names(table: Any, source: str) -> list[str]:
    """Give the columns of any library's table."""
    if isinstance(table, Mapping):
        return [str(name) for name in table]
    if isinstance(table, pa.Table | pa.RecordBatch):
        return list(table.schema.names)
    table = _with_index(table)
    if hasattr(table, "columns") and (hasattr(table, "iloc") or hasattr(table, "__arrow_c_stream__")):
        return [str(name) for name in table.columns]
    kinds = "a pandas or Polars data frame, an Arrow table or a dict of arrays"
    raise failure(source, f"{kinds} is expected, not {type(table).__name__}")


def to_arrow(table: Any, columns: list[str], source: str) -> pa.Table:
    """Take some columns of any library's table."""
    if isinstance(table, Mapping):
        return _from_arrays({name: table[name] for name in columns}, source)
    if isinstance(table, pa.RecordBatch):
        table = pa.Table.from_batches([table])
    if isinstance(table, pa.Table):
        return table.select(columns)
    if hasattr(table, "iloc"):  # pandas before 2.2 has no stream of Arrow data
        return pa.Table.from_pandas(_dense(_with_index(table)[columns]), preserve_index=False)
    return pa.table(table[columns])


def _with_index(table: Any) -> Any:
    """A pandas data frame whose index has a name of its own, with that as a column."""
    names = getattr(getattr(table, "index", None), "names", None) if hasattr(table, "iloc") else None
    return table.reset_index() if names and all(n is not None and n not in table.columns for n in names) else table


def _dense(table: Any) -> Any:
    """A pandas data frame without sparse columns, which Arrow does not know."""
    sparse = [name for name in table.columns if type(table.dtypes[name]).__name__ == "SparseDtype"]
    return table.assign(**{name: table[name].sparse.to_dense() for name in sparse}) if sparse else table


def _from_arrays(arrays: dict[str, Any], source: str) -> pa.Table:
    table: dict[str, pa.Array] = {}
    rows: int | None = None
    for name, values in arrays.items():
        array = _one_dimensional(name, values, source)
        rows = len(array) if rows is None else rows
        if len(array) != rows:
            raise failure(source, f"column {name!r} has {len(array)} rows where the others have {rows}")
        table[name] = pa.array(array)
    return pa.table(table)


def _one_dimensional(name: str, values: Any, source: str) -> npt.NDArray[Any]:
    try:
        array = np.asanyarray(values)
    except ValueError as error:
        raise failure(source, f"column {name!r} is ragged: one number a row is expected") from error
    if array.ndim != 1:
        raise failure(source, f"column {name!r} has shape {array.shape}: one number a row is expected")
    # Arrow refuses foreign byte orders and long doubles, which NumPy converts; a mask it understands itself.
    plain = array.dtype.kind in "fiu" and not isinstance(array, np.ma.MaskedArray)
    return np.asarray(array, np.float64) if plain else array


@contextmanager
def reading(source: str) -> Iterator[None]:
    """Turn whatever reading broken data raises into one line."""
    try:
        yield
    except LogError:
        raise
    except (pa.ArrowException, OSError, ValueError, TypeError, EOFError, MemoryError, OverflowError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise failure(source, f"cannot be read: {reason}") from error


@contextmanager
def parsing(source: str) -> Iterator[None]:
    """Turn whatever a library raises on broken data, of any type, into one line."""
    try:
        with reading(source):
            yield
    except LogError:
        raise
    except Exception as error:
        raise failure(source, f"cannot be read: {error}") from error


def failure(source: str, text: str) -> LogError:
    """Make a one-line error that begins with where the samples come from."""
    return LogError(" ".join(f"{source}: {text}".splitlines()))
