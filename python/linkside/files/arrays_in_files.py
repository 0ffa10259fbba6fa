"""Files of named arrays as tables of columns: MATLAB's .mat and HDF5.

An array of one dimension is a column. Of one with two, the longer is time, and the others are columns, ``theta[0]``
and so on. What is inside a structure or a group has its name in front: ``log.theta``, ``log/theta``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from scipy.io import loadmat

from .tables import MOST_COLUMNS, ArrowTable, failure, parsing, to_arrow

Array = npt.NDArray[Any]
Load = Callable[[], Array]
"""Gives an array when it is needed."""

HDF5 = b"\x89HDF\r\n\x1a\n"
OFFSETS = (0, 512)
"""Where such a file begins; MATLAB writes a text ahead of it."""

WIDEST = 1000
"""Columns of one array."""

DEEPEST = 32
"""How deep structures nest."""


class ArrayTable:
    """A file of arrays: the columns are known at once, and read on demand.

    Columns that are read together have the same number of rows; others may differ.

    Raises
    ------
    LogError
        A file that cannot be read, or one of HDF5 where h5py is not installed.
    """

    count: int | None = None

    def __init__(self, path: str | Path) -> None:
        """Find its arrays."""
        self.source = str(path)
        with parsing(self.source):
            self._hdf5 = _is_hdf5(Path(path))
            self._matlab = {} if self._hdf5 else self._load_matlab()
            with self._columns() as columns:
                self.names: list[str] = list(columns)
        if len(self.names) > MOST_COLUMNS:
            raise failure(self.source, f"at most {MOST_COLUMNS} columns are expected, not {len(self.names)}")

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns."""
        with parsing(self.source), self._columns() as there:
            return to_arrow({name: there[name]() for name in columns}, columns, self.source)

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter; they are whole in memory."""
        return ArrowTable(self.read(columns), self.source).batches(columns, rows)

    def _load_matlab(self) -> dict[str, Any]:
        return {name: value for name, value in loadmat(self.source, simplify_cells=True).items() if name[:2] != "__"}

    @contextmanager
    def _columns(self) -> Iterator[dict[str, Load]]:
        if not self._hdf5:
            yield dict(_flat("", self._matlab, 0))
            return
        try:
            import h5py
        except ImportError:
            raise failure(self.source, "h5py is needed to read this: pip install 'linkside[hdf5]'") from None
        with h5py.File(self.source, "r") as file:
            found: dict[str, Load] = {}
            file.visititems(lambda name, item: found.update(_dataset(name, item)) if hasattr(item, "dtype") else None)
            yield found


def _is_hdf5(path: Path) -> bool:
    with path.open("rb") as file:
        begin = file.read(max(OFFSETS) + len(HDF5))
    return any(begin[at : at + len(HDF5)] == HDF5 for at in OFFSETS)


def _flat(name: str, value: Any, depth: int) -> Iterator[tuple[str, Load]]:
    """Columns of what MATLAB has: structures, lists of them, arrays."""
    if depth > DEEPEST:
        return
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}" if name else str(key), inner, depth + 1)
    elif isinstance(value, list) or (isinstance(value, np.ndarray) and value.dtype == object):
        for index, inner in enumerate(list(value)[:WIDEST]):
            yield from _flat(f"{name}[{index}]", inner, depth + 1)
    elif isinstance(value, np.ndarray):
        yield from _numeric(name, value.shape, value.dtype, lambda: value)


def _dataset(name: str, item: Any) -> Iterator[tuple[str, Load]]:
    """Columns of a dataset of HDF5: an array, or a table with fields."""
    if name.startswith("#"):  # what MATLAB's cells refer to
        return
    if item.dtype.fields is None:
        yield from _numeric(name, item.shape, item.dtype, lambda: item[()])
        return
    for field, (kind, *_) in item.dtype.fields.items():
        yield from _numeric(f"{name}.{field}", item.shape, kind, lambda field=field: item[field])  # type: ignore[misc]


def _numeric(name: str, shape: tuple[int, ...], kind: np.dtype[Any], load: Load) -> Iterator[tuple[str, Load]]:
    if kind.kind not in "fiub" or not shape:
        return
    long = [size for size in shape if size != 1]
    if len(long) <= 1:
        yield name, lambda: load().reshape(-1)
    elif len(long) == 2 and min(long) <= WIDEST:
        along = long.index(max(long))
        for index in range(min(long)):
            yield f"{name}[{index}]", lambda index=index: np.take(load().squeeze(), index, axis=1 - along)  # type: ignore[misc]
