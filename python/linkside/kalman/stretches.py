"""Smoothing of recordings larger than memory, from file to file.

The backward pass takes stretches of a recording from the last to the first; each is filtered again from the filter's
state at its beginning. Readings that wait for the backward pass, and estimates that wait to be written, are on disk.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import gettempdir
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa
from pyarrow import feather

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, NumericalError, OutputError
from linkside.files.parts import spill_folder
from linkside.files.writing import check_writable
from linkside.findings import named
from linkside.recording.estimate import where_due
from linkside.recording.log import Log
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot

from .filtering import KalmanEstimate
from .jerk_driven import Arrays, RauchTungStriebelSmoother
from .starting import with_first

ROWS = 65_536
"""Rows of a recording that are in memory at a time."""

STRETCH = 8192
"""Rows whose history is in memory at a time, at most."""

READ = ("dt", "readings", "dtheta", "jerk")
"""What the filter reads."""

KEPT = (*READ, "t", "waiting")
"""Signals that are kept for the backward pass."""


def smooth_file(
    smoother: RauchTungStriebelSmoother,
    path: str | Path,
    robot: Robot,
    out: str | Path,
    rows: int = ROWS,
    *,
    check: bool = True,
) -> int:
    """Smooth a recording of any length from file to file, in bounded memory; returns the number of rows written.

    The estimate of `RauchTungStriebelSmoother.run` on the whole recording when ``noise.jerk`` is given; otherwise the
    scale of jerk is estimated from the first ``rows``. While this runs, a directory beside ``out`` holds about as much
    as the recording and the estimate together.

    Parameters
    ----------
    smoother
        The smoother.
    path
        The recording, Parquet or CSV.
    robot
        The robot whose columns the recording has.
    out
        The estimate, Parquet or CSV; it appears when it is complete.
    rows
        Rows in memory at a time.
    check
        Check the recording first, as `Log.read` does.

    Raises
    ------
    LogError
        A recording that cannot be used.
    OutputError
        ``out`` cannot be written.
    NumericalError
        The estimate is no longer finite; names the sample.
    """
    check_writable(out)
    count = 0
    with EstimateWriter(out) as writer:
        for piece in smooth_pieces(
            smoother, Log.stream(path, robot, rows, check=check), Path(os.path.realpath(out)).parent
        ):
            writer.write(piece)
            count += len(piece)
    return count


def smooth_pieces(
    smoother: RauchTungStriebelSmoother, pieces: Iterable[Log], folder: str | Path | None = None
) -> Iterator[KalmanEstimate]:
    """Smooth a recording piece by piece; estimates are returned in order, after the last piece was read.

    Parameters
    ----------
    smoother
        The smoother.
    pieces
        Of the recording, such as `Log.stream` gives them.
    folder
        Where a temporary directory is made, which is always removed at the end; by default the system's.
    """
    smoother.refuse_pieces()
    with _spill_folder(folder) as spill:
        starts, columns = _forward(smoother, pieces, spill)
        found = named(starts.pop().findings, columns) if starts else ()
        _backward(starts, spill)
        for index in range(len(starts)):
            arrays: dict[str, Any] = _load(spill / f"{index}.estimate")
            yield smoother.told(channels=columns, findings=found, **arrays)


@contextmanager
def _spill_folder(folder: str | Path | None) -> Iterator[Path]:
    try:
        with spill_folder(Path(gettempdir() if folder is None else folder)) as spill:
            yield spill
    except (OSError, pa.ArrowException) as error:
        if isinstance(error, OutputError):
            raise
        raise OutputError(f"{folder}: a temporary file could not be written or read: {error}") from error


def _forward(
    smoother: RauchTungStriebelSmoother, pieces: Iterable[Log], spill: Path
) -> tuple[list[_core.ExtendedKalmanFilter], tuple[str, ...]]:
    """Filter, spill what was read, and give the filter at the start of each piece and at the end; and its columns."""
    core: _core.ExtendedKalmanFilter | None = None
    kinds: tuple[str, ...] = ()
    before: Log | None = None
    starts: list[_core.ExtendedKalmanFilter] = []
    columns: tuple[str, ...] = ()
    rows = 0
    first, pieces = with_first(pieces)
    for index, piece in enumerate(pieces):
        if core is None:
            kinds = smoother.kinds(piece)
            columns = smoother.columns(piece, kinds)
        arrays = smoother.arrays(piece, kinds, before)
        if core is None:
            assert first is not None  # there is a piece
            law = smoother.law(piece)
            core = smoother.started_core(kinds, smoother.noise_for(piece, law), first, piece.period, law)
        starts.append(core.copy())
        waiting = piece.pace.waiting(piece)
        _save(spill / f"{index}.log", dict(zip(KEPT, (*arrays, piece.t, waiting), strict=True)))
        with _in_rows(rows, len(piece)):
            core.run(arrays, False, False)
        before, rows = piece[-1:], rows + len(piece)
    return ([*starts, core] if core is not None else []), columns


def _backward(starts: Sequence[_core.ExtendedKalmanFilter], spill: Path) -> None:
    """Smooth piece after piece from the last to the first; what was read makes room for what is estimated."""
    if not starts:
        return
    smoother = _core.StretchSmoother(starts[0])
    for index in reversed(range(len(starts))):
        read = _load(spill / f"{index}.log")
        (spill / f"{index}.log").unlink()
        arrays = tuple(read[name] for name in READ)
        found = _smooth(smoother, starts[index], arrays)
        found["status"] = where_due(found["status"], read["waiting"])
        _save(spill / f"{index}.estimate", {"t": read["t"], **found})


def _smooth(
    smoother: _core.StretchSmoother, start: _core.ExtendedKalmanFilter, arrays: tuple[FloatArray, ...]
) -> dict[str, Any]:
    """One piece, in stretches whose history fits into memory."""
    size = min(STRETCH, smoother.stretch)
    cuts = [_rows(arrays, first, first + size) for first in range(0, len(arrays[0]), size)]
    filters = [start]
    for cut in cuts[:-1]:
        core = filters[-1].copy()
        core.run(cut, False, False)
        filters.append(core)
    parts = [smoother.back(f, cut, False) for f, cut in zip(reversed(filters), reversed(cuts), strict=True)]
    names = [name for name in parts[0] if name != "findings"]
    return {name: np.concatenate([part[name] for part in reversed(parts)]) for name in names}


def _rows(arrays: tuple[FloatArray, ...], first: int, last: int) -> Arrays:
    dt, readings, dtheta, jerk = (array[first:last] for array in arrays)
    return dt, readings, dtheta, jerk


def _save(path: Path, arrays: dict[str, npt.NDArray[Any]]) -> None:
    columns = {name: _column(np.ascontiguousarray(array)) for name, array in arrays.items()}
    feather.write_feather(pa.table(columns), str(path), compression="zstd", compression_level=1)


def _column(array: npt.NDArray[Any]) -> pa.Array:
    flat = pa.array(array.reshape(-1))
    return flat if array.ndim == 1 else pa.FixedSizeListArray.from_arrays(flat, array.shape[1])


def _load(path: Path) -> dict[str, npt.NDArray[Any]]:
    table = feather.read_table(str(path), memory_map=False)
    return {name: _array(table.column(name).combine_chunks()) for name in table.column_names}


def _array(column: pa.Array) -> npt.NDArray[Any]:
    if not pa.types.is_fixed_size_list(column.type):
        return np.asarray(column.to_numpy(zero_copy_only=False))
    flat = column.flatten().to_numpy(zero_copy_only=False)
    return np.asarray(flat.reshape(len(column), column.type.list_size))


@contextmanager
def _in_rows(first: int, count: int) -> Iterator[None]:
    """Add the piece to row numbers in messages of the kernels, which count from the beginning of a piece."""
    try:
        yield
    except (EstimatorError, NumericalError) as error:
        raise type(error)(f"rows {first} to {first + count - 1}: {error}") from error
