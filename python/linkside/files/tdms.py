"""TDMS files of LabVIEW, by npTDMS."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.errors import RecordingWarning

from .clocked import ClockedTable, Place
from .tables import failure

FRACTIONS = 2.0**64
"""Of a second, as stamps have them."""


class Stamp(NamedTuple):
    """A time: seconds since 1904, and fractions of 2⁻⁶⁴ s."""

    seconds: int
    fractions: int


def tdms_table(path: str | Path) -> ClockedTable:
    """Open a TDMS file.

    A channel's time is that of its waveform (``wf_increment``, ``wf_start_offset`` and ``wf_start_time``), from the
    earliest start in the file on, or a channel of its group. A file that was cut off is read as far as it goes.
    """
    return ClockedTable(str(path), _opened)


@contextmanager
def _opened(source: str) -> Iterator[_TdmsReader]:
    try:
        from nptdms import TdmsFile
    except ImportError:
        raise failure(source, "npTDMS is needed to read this: pip install 'linkside[tdms]'") from None
    with _without_its_log(), open(source, "rb") as opened, TdmsFile.open(opened, raw_timestamps=True) as file:
        if file.file_status.incomplete_final_segment:
            text = f"{source}: this file was cut off: it is read as far as it goes"
            warnings.warn(text, RecordingWarning, stacklevel=2)
        yield _TdmsReader(file)


@contextmanager
def _without_its_log() -> Iterator[None]:
    """What npTDMS writes to standard error is said in one line of ours."""
    log = logging.getLogger("nptdms")
    level = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(level)


class _TdmsReader:
    def __init__(self, file: Any) -> None:
        self._groups = {group.name: {c.name: c for c in group.channels()} for group in file.groups()}
        stamps = (s for channels in self._groups.values() for c in channels.values() if len(c) for s in _stamps(c))
        self._first = min(stamps, default=Stamp(0, 0))

    def places(self, time: str) -> Iterator[Place]:
        for group, channels in self._groups.items():
            for name, channel in channels.items():
                if not len(channel) or name == time:
                    continue
                if time in channels:
                    yield Place(group, name, (group, len(channel)))
                elif channel.properties.get("wf_increment", 0) > 0:
                    waveform = (channel.properties.get(f"wf_{key}") for key in ("increment", "start_offset"))
                    yield Place(group, name, (len(channel), *waveform, _start(channel)))

    def times(self, place: Place, time: str, unit: float) -> FloatArray:
        channels = self._groups[place.group]
        if time in channels:
            recorded = channels[time][:]
            if not hasattr(recorded, "second_fractions"):
                return unit * np.asarray(recorded, np.float64)
            return self._since(recorded.seconds, recorded.second_fractions)
        channel = channels[place.name]
        begin, start = channel.properties.get("wf_start_offset", 0.0), _start(channel)
        if start is not None:
            begin += float(self._since(*map(np.asarray, start)))
        return np.asarray(begin + channel.properties["wf_increment"] * np.arange(len(channel)), np.float64)

    def values(self, place: Place) -> npt.NDArray[Any]:
        return np.asarray(self._groups[place.group][place.name][:])

    def _since(self, seconds: npt.NDArray[Any], fractions: npt.NDArray[Any]) -> FloatArray:
        """Times from the earliest stamp in the file on [s]."""
        apart = fractions / FRACTIONS - self._first.fractions / FRACTIONS
        return np.asarray(seconds.astype(np.int64) - self._first.seconds + apart)


def _start(channel: Any) -> Stamp | None:
    start = channel.properties.get("wf_start_time")
    return None if start is None else Stamp(int(start.seconds), int(start.second_fractions))


def _stamps(channel: Any) -> Iterator[Stamp]:
    """When a channel begins: its waveform, or the first of its dates."""
    if (start := _start(channel)) is not None:
        yield start
    if channel.data_type is not None and channel.data_type.__name__ == "TimeStamp":
        yield Stamp(int(channel[0].seconds), int(channel[0].second_fractions))
