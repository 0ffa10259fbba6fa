"""Files of channels that have clocks of their own, as one table: a row for each time, NaN where nothing was read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Hashable, Iterator
from contextlib import AbstractContextManager
from typing import Any, NamedTuple, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow as pa

from linkside.arrays import FloatArray

from .joining import Part, join
from .tables import MOST_COLUMNS, ArrowTable, failure, numbers, parsing, to_arrow


class Place(NamedTuple):
    """Where a channel is: its group, its name there, and what tells its clock from others."""

    group: str
    name: str
    clock: Hashable


class Reader(Protocol):
    """An open file of channels."""

    def places(self, time: str) -> Iterator[Place]:
        """Channels that have a clock; where a group has a channel called ``time``, that is the clock of the others."""

    def times(self, place: Place, time: str, unit: float) -> FloatArray:
        """When a channel was read (T,) [s]; a channel called ``time`` is in ``unit`` [s]."""

    def values(self, place: Place) -> npt.NDArray[Any]:
        """What was read (T,)."""


class ClockedTable:
    """A file of channels with clocks of their own, merged by time when they are read.

    A column is called as its channel, with its group in front (``group/channel``) where two channels have one name.

    Parameters
    ----------
    source
        The file.
    opener
        What opens it.
    time
        What its column of time is to be called. A group with a channel of that name goes by it.
    unit
        Of the column of time [s].
    lines
        Columns of commanded signals, which are interpolated linearly.

    Raises
    ------
    LogError
        A file that cannot be read.
    """

    count: int | None = None

    def __init__(
        self,
        source: str,
        opener: Callable[[str], AbstractContextManager[Reader]],
        *,
        time: str = "t",
        unit: float = 1.0,
        lines: Collection[str] = (),
    ) -> None:
        """Find its channels."""
        self.source, self._opener = source, opener
        self._time, self._unit, self._lines = time, unit, lines
        with parsing(source), opener(source) as reader:
            places = list(reader.places(time))
        if len(places) > MOST_COLUMNS:
            raise failure(source, f"at most {MOST_COLUMNS} columns are expected, not {len(places)}")
        names = Counter(place.name for place in places)
        self._places = {p.name if names[p.name] == 1 else f"{p.group}/{p.name}": p for p in places}
        self.names: list[str] = [time, *self._places]
        self._latest: pa.Table | None = None

    def for_log(self, time: str, unit: float, lines: Collection[str]) -> ClockedTable:
        """The same file as a robot's log: what it calls its time, in which unit [s], and which are its commands.

        Raises
        ------
        LogError
            No channel has a time.
        """
        table = ClockedTable(self.source, self._opener, time=time, unit=unit, lines=lines)
        table._refuse_timeless()
        return table

    def read(self, columns: list[str]) -> pa.Table:
        """All rows of some columns, which are kept; all times where only time is asked for."""
        if self._latest is not None and self._latest.column_names == columns:
            return self._latest
        self._refuse_timeless()
        wanted = [column for column in columns if column != self._time] or list(self._places)
        clocks: dict[Hashable, list[str]] = {}
        for column in wanted:
            clocks.setdefault(self._places[column].clock, []).append(column)
        with parsing(self.source), self._opener(self.source) as reader:
            parts = [self._part(reader, names) for names in clocks.values()]
        table = join(parts, self._time, self._lines)
        table[self._time] = table[self._time] / self._unit
        self._latest = pa.table({column: table[column] for column in columns})
        return self._latest

    def batches(self, columns: list[str], rows: int) -> Iterator[pa.Table]:
        """Some columns in tables of ``rows`` rows, the last one shorter; they are whole in memory."""
        return ArrowTable(self.read(columns), self.source).batches(columns, rows)

    def _refuse_timeless(self) -> None:
        if not self._places:
            nor = f"nor a channel {self._time!r} in its group"
            raise failure(self.source, f"no channel has a time: neither its own, {nor}")

    def _part(self, reader: Reader, names: list[str]) -> Part:
        """Channels of one clock."""
        first = self._places[names[0]]
        source = f"{self.source}: {first.group}"
        t = reader.times(first, self._time, self._unit)
        channels = {name: reader.values(self._places[name]) for name in names}
        table = to_arrow({"": t, **channels}, ["", *names], source)
        steps = np.diff(t)
        if len(t) < 2 or not (np.isfinite(t).all() and (steps > 0).all()):
            row = int(np.argmin(np.append(True, steps > 0) & np.isfinite(t))) if len(t) > 1 else 0
            raise failure(source, f"time does not increase at row {row}, or has fewer than two rows")
        return Part(source, t, {name: numbers(table, name, source) for name in names})
