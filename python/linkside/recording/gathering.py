"""Columns of a table as arrays of time × channel."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from linkside.arrays import FloatArray
from linkside.files.tables import failure, numbers


def gather(table: pa.Table, columns: tuple[str, ...], source: str) -> FloatArray | None:
    """Some columns (T, k), NaN for one that the table lacks; None where it lacks all."""
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


def frozen(array: FloatArray) -> FloatArray:
    """The same memory, read-only."""
    view: FloatArray = array.view()
    view.flags.writeable = False
    return view


def period_of(head: FloatArray, source: str) -> float:
    """Median step of time of the first rows; `LogError` where they are too few."""
    if len(head) < 2:
        rows = "has no rows" if len(head) == 0 else "has a single row"
        raise failure(source, f"the log {rows}: at least two are needed")
    with np.errstate(invalid="ignore"):  # an infinite time is refused later, with its row
        return float(np.median(np.diff(head)))
