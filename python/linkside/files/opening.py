"""Opening of files of columns, by their suffix."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .arrays_in_files import ArrayTable
from .mdf import mdf_table
from .regular import instead
from .tables import CsvTable, ParquetTable, Table, failure, reading
from .tdms import tdms_table

FORMATS: dict[str, Callable[[str | Path], Table]] = {
    ".parquet": ParquetTable,
    ".csv": CsvTable,
    ".csv.gz": CsvTable,
    ".mat": ArrayTable,
    ".h5": ArrayTable,
    ".hdf5": ArrayTable,
    ".tdms": tdms_table,
    ".mf4": mdf_table,
    ".mdf": mdf_table,
}
"""What reads a file, by its suffix."""


def open_table(path: str | Path) -> Table:
    """Open a file by its suffix, for reading some of its columns; `LogError` when that cannot be."""
    name = str(path).lower()
    suffix = next((suffix for suffix in FORMATS if name.endswith(suffix)), None)
    if suffix is None:
        *others, last = FORMATS
        raise failure(str(path), f"a file that ends in {', '.join(others)} or {last} is expected")
    with reading(str(path)):  # a name may also be too long, or out of reach
        try:
            other = instead(path)
        except FileNotFoundError:
            raise failure(str(path), "no such file") from None
        if other:
            raise failure(str(path), f"this is {other}, a file is expected")
    return FORMATS[suffix](path)
