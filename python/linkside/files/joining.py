"""Tables of sensors with clocks and rates of their own, as one: a row for each time, NaN where nothing was read."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from linkside.arrays import FloatArray

from .tables import failure

SAME = 0.01
"""Stamps closer than this part of the shortest period are of one time."""


@dataclass(frozen=True)
class Part:
    """What one table has: its name, its times (T,) [s] and its channels (T,) by column."""

    source: str
    t: FloatArray
    channels: dict[str, FloatArray]

    @property
    def span(self) -> str:
        """From when to when, in words."""
        return f"from {self.t[0]:.9g} to {self.t[-1]:.9g} s"


def join(parts: Sequence[Part], time: str, commands: Collection[str]) -> dict[str, FloatArray]:
    """Join tables by time: all times, in the column ``time``, and each channel at its own; commands on straight lines.

    Raises
    ------
    LogError
        A column that two tables have, times that have nothing in common.
    """
    _refuse_clashes(parts)
    if len(parts) == 1:
        return {time: parts[0].t, **parts[0].channels}
    t, rows = _union([part.t for part in parts])
    table = {time: t}
    for part, own in zip(parts, rows, strict=True):
        for column, values in part.channels.items():
            table[column] = _spread(t, own, values, line=column in commands)
    return table


def _refuse_clashes(parts: Sequence[Part]) -> None:
    owner: dict[str, Part] = {}
    for part in parts:
        for column in part.channels:
            if column in owner:
                raise failure(part.source, f"column {column!r} is in {owner[column].source} too")
            owner[column] = part
        first = parts[0]
        if part.t[0] > first.t[-1] or part.t[-1] < first.t[0]:
            away = f"its time, {part.span}, has nothing in common with that of {first.source}, {first.span}"
            raise failure(part.source, f"{away}: say by how much its clock is ahead (--shift, shifts=…)")


def _spread(t: FloatArray, rows: Any, values: FloatArray, *, line: bool) -> FloatArray:
    """A channel at all times, NaN where it is not read, or there on the straight line between neighbours."""
    if line and not np.isnan(values).any():
        return np.interp(t, t[rows], values, left=np.nan, right=np.nan)
    out = np.full(len(t), np.nan)
    out[rows] = values
    return out


def _union(times: Sequence[FloatArray]) -> tuple[FloatArray, list[Any]]:
    """All times, each once, and the rows of each table among them."""
    same = min(min(SAME * float(np.median(np.diff(t))), 0.5 * float(np.diff(t).min())) for t in times)
    joined = np.concatenate(times)
    order = np.argsort(joined, kind="stable")
    ordered = joined[order]
    # Stamps of one table are never as close, so that of a group each table has one at most.
    new = np.append(True, np.diff(ordered) > same / len(times))
    row = np.empty(len(joined), np.intp)
    row[order] = np.cumsum(new) - 1
    ends = np.cumsum([len(t) for t in times])
    return ordered[new], np.split(row, ends[:-1])
