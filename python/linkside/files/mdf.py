"""MDF files (ASAM; `.mf4`, `.mdf`), by asammdf."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray

from .clocked import ClockedTable, Place
from .tables import failure

BY_TIME = (0, 1)
"""What a master channel of MDF 4 goes by: nothing said, or time; the others are angle, distance and index."""


def mdf_table(path: str | Path) -> ClockedTable:
    """Open an MDF file of version 2 to 4; time is that of each group's master channel.

    Conversions of the file are applied; samples that it marks as invalid are missing.
    """
    return ClockedTable(str(path), _opened)


@contextmanager
def _opened(source: str) -> Iterator[_MdfReader]:
    try:
        from asammdf import MDF
    except ImportError:
        raise failure(source, "asammdf is needed to read this: pip install 'linkside[mdf]'") from None
    with open(source, "rb") as opened, MDF(opened) as file:
        yield _MdfReader(file)


class _MdfReader:
    def __init__(self, file: Any) -> None:
        self._file = file

    def places(self, time: str) -> Iterator[Place]:
        for group in self._groups():
            master = self._file.masters_db[group]
            for index, channel in enumerate(self._file.groups[group].channels):
                if index != master and channel.name != time:
                    yield Place(str(group), channel.name, group)

    def times(self, place: Place, time: str, unit: float) -> FloatArray:
        return np.asarray(self._file.get_master(int(place.group)), np.float64)

    def values(self, place: Place) -> npt.NDArray[Any]:
        signal = self._file.get(place.name, group=int(place.group), ignore_invalidation_bits=True)
        if signal.invalidation_bits is None:
            return np.asarray(signal.samples)
        return np.where(np.asarray(signal.invalidation_bits), np.nan, signal.samples)

    def _groups(self) -> Iterator[int]:
        """Groups with rows that go by time."""
        for number, group in enumerate(self._file.groups):
            master = self._file.masters_db.get(number)
            if master is None or not group.channel_group.cycles_nr:
                continue
            if getattr(group.channels[master], "sync_type", BY_TIME[1]) in BY_TIME:
                yield number
