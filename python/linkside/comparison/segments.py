"""Parts of a motion that are judged apart: from a file, or what lies between rests."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv

from linkside.arrays import FloatArray
from linkside.errors import LogError
from linkside.files.tables import reading
from linkside.recording import Estimate

SLOW = 0.01
"""A joint slower than this share of its largest speed is at rest."""

LEAST_REST = 0.05
"""A rest is at least so long [s]."""


@dataclass(frozen=True)
class Segment:
    """A part of a motion.

    Attributes
    ----------
    name : str
        How it is called in tables.
    start, end : float
        From when to when, both included [s], by the reference's clock.
    """

    name: str
    start: float
    end: float


def read_segments(path: str | Path) -> tuple[Segment, ...]:
    """Read a CSV file with columns ``start``, ``end`` [s] and, if they have names, ``name``.

    Raises
    ------
    LogError
        A column is missing, or a segment ends before it starts: names the row.
    """
    source = str(path)
    with reading(source):
        kinds = {"start": pa.float64(), "end": pa.float64(), "name": pa.string()}
        table = pa.csv.read_csv(source, convert_options=pa.csv.ConvertOptions(column_types=kinds))
    for column in ("start", "end"):
        if column not in table.column_names:
            raise LogError(
                f"{source}: column {column!r} is missing; start and end [s], and name if wanted, are expected"
            )
    starts, ends = table["start"].to_pylist(), table["end"].to_pylist()
    names = table["name"].to_pylist() if "name" in table.column_names else [None] * len(starts)
    for row, (start, end) in enumerate(zip(starts, ends, strict=True)):
        if start is None or end is None or not start < end:
            raise LogError(f"{source}: row {row} goes from {start} to {end}, expected start before end")
    found = zip(names, starts, ends, strict=True)
    return tuple(Segment(name or f"part {i + 1}", start, end) for i, (name, start, end) in enumerate(found))


def between_rests(motion: Estimate) -> tuple[Segment, ...]:
    """Find the parts of a motion in which some joint moves, between rests of 0.05 s and longer."""
    moving = (_speeds(motion) > SLOW).any(axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], moving, [False]])))
    parts = [[motion.t[a], motion.t[b - 1]] for a, b in edges.reshape(-1, 2)]
    joined: list[list[float]] = []
    for start, end in parts:
        if joined and start - joined[-1][1] < LEAST_REST:
            joined[-1][1] = end
        elif end > start:
            joined.append([start, end])
    return tuple(Segment(f"part {i + 1}", float(a), float(b)) for i, (a, b) in enumerate(joined))


def _speeds(motion: Estimate) -> FloatArray:
    """Speed of each joint, as a share of its largest; a joint that never moves has 0."""
    dq = motion.dq if np.isfinite(motion.dq).all() else np.gradient(motion.q, motion.t, axis=0)
    largest = np.abs(dq).max(axis=0)
    return np.asarray(np.abs(dq) / np.where(largest > 0, largest, np.inf))
