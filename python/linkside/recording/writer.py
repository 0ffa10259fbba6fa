"""Writing of estimates to files, piece by piece."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import IO, Protocol

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from linkside.errors import EstimatorError, OutputError
from linkside.files.parts import discard, open_part, publish
from linkside.files.writing import check_writable, writing

GROUP = 131_072
"""Rows a group of a Parquet file. A writer regroups what it is given, so that the file does not depend on it."""


class Rows(Protocol):
    """What is written: rows of an estimate."""

    def to_arrow(self) -> pa.Table:
        """Convert to an Arrow table."""


class EstimateWriter:
    """Writes estimates, piece by piece, into one Parquet or CSV file in bounded memory.

    The file is written completely or not at all: it appears under its name, replacing an older one, when the ``with``
    block ends without an exception. Its content does not depend on the sizes of the pieces.

    Parameters
    ----------
    path
        A file that ends in ``.parquet`` or ``.csv``. Whether it can be written is checked at once.
    metadata
        Stored in the schema of a Parquet file; a CSV file does not store it.

    Raises
    ------
    OutputError
        When it cannot be written: one line with the file.
    """

    def __init__(self, path: str | Path, metadata: Mapping[str, str] | None = None) -> None:
        """Check that the file can be written; writing starts with the ``with`` block."""
        check_writable(path)
        self._path = Path(path)
        self._metadata = dict(metadata) if metadata else None
        self._part: Path | None = None
        self._file: IO[bytes] | None = None
        self._sink: pq.ParquetWriter | pa.csv.CSVWriter | None = None
        self._schema: pa.Schema | None = None
        self._held: list[pa.Table] = []
        self._rows = 0

    def __enter__(self) -> EstimateWriter:
        """Open a temporary file next to the one to be."""
        with writing(self._path):
            self._part, self._file = open_part(self._path)
        return self

    def write(self, estimate: Rows) -> None:
        """Add rows; every estimate has the joints and columns of the first."""
        if self._file is None:
            raise OutputError(f"{self._path}: rows are written inside the `with` block of a writer")
        table = estimate.to_arrow()
        if self._sink is None:
            with writing(self._path):
                self._sink = _sink(self._path, self._file, table.schema.with_metadata(self._metadata))
            self._schema = table.schema
        if table.schema != self._schema:
            raise EstimatorError(f"{self._path}: {estimate!r} has other columns than the rows before")
        self._held.append(table)
        self._rows += len(table)
        if self._rows >= GROUP:
            self._flush(GROUP)

    def note(self, metadata: Mapping[str, str]) -> None:
        """Add metadata that is known only after the rows; a CSV file does not store it."""
        if isinstance(self._sink, pq.ParquetWriter):
            self._sink.add_key_value_metadata(dict(metadata))

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Publish the file, or remove it."""
        try:
            if kind is None:
                self._publish()
        finally:
            self._discard()

    def _flush(self, group: int) -> None:
        """Write whole groups, and hold the rest back."""
        rows = pa.concat_tables(self._held)
        whole = self._rows - self._rows % group
        assert self._sink is not None  # it exists from the first rows on
        with writing(self._path):
            for start in range(0, whole, group):
                self._sink.write_table(rows.slice(start, group).combine_chunks())
        self._held, self._rows = [rows.slice(whole)], self._rows - whole

    def _publish(self) -> None:
        if self._sink is None or self._file is None or self._part is None:
            raise OutputError(f"{self._path}: no estimate was written")
        if self._rows:
            self._flush(self._rows)
        with writing(self._path):
            self._sink.close()
            publish(self._part, self._file, self._path)

    def _discard(self) -> None:
        if self._sink is not None:  # before its file: it would complain when collected
            with suppress(OSError, pa.ArrowException):
                self._sink.close()
        if self._part is not None and self._file is not None:
            discard(self._part, self._file)
        self._file, self._sink, self._held = None, None, []


def _sink(path: Path, file: IO[bytes], schema: pa.Schema) -> pq.ParquetWriter | pa.csv.CSVWriter:
    if path.suffix.lower() == ".csv":
        return pa.csv.CSVWriter(file, schema)
    # A dictionary of floats that hardly repeat only costs time.
    return pq.ParquetWriter(file, schema, compression="zstd", use_dictionary=False)
