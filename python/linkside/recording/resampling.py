"""Readings at an even rate, by interpolation between those that are there."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from linkside.arrays import FloatArray

from .pace import LONGEST_DROPOUT


def even_times(t: FloatArray, signals: Iterable[FloatArray], rate: float) -> FloatArray:
    """Times at ``rate`` [Hz] over those of a recording (T,), from when all channels of ``signals`` (T, k) are read.

    Channels whose first reading comes later than the longest dropout are ignored.
    """
    first = t[0]
    for array in signals:
        there = ~np.isnan(array)
        for begin in t[np.argmax(there, axis=0)][there.any(axis=0)]:
            first = max(first, begin) if begin <= t[0] + LONGEST_DROPOUT else first
    count = int(np.floor((t[-1] - first) * rate * (1 + 1e-12))) + 1
    times: FloatArray = np.minimum(first + np.arange(count) / rate, t[-1])
    return times


def at(times: FloatArray, t: FloatArray, values: FloatArray) -> FloatArray:
    """Channels (T, k) at other times: on the straight line between readings, NaN where those are too far apart."""
    out = np.full((len(times), values.shape[1]), np.nan)
    for channel in range(values.shape[1]):
        there = ~np.isnan(values[:, channel])
        read = t[there]
        if not len(read):
            continue
        out[:, channel] = np.interp(times, read, values[there, channel], left=np.nan, right=np.nan)
        after = np.clip(np.searchsorted(read, times), 1, len(read) - 1) if len(read) > 1 else np.zeros(len(times), int)
        apart = read[after] - read[after - 1]
        lost = (apart > LONGEST_DROPOUT) & (times > read[after - 1]) & (times < read[after])
        out[lost, channel] = np.nan
    return out
