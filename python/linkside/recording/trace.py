"""Signals over time in bounded memory: least, largest and mean value of stretches of rows, however many there are."""

from __future__ import annotations

import numpy as np

from linkside.arrays import FloatArray

STRETCHES = 400
"""Between this many and twice as many points are kept of a long recording."""


class Trace:
    """Channels over time, as least, largest and mean value of each stretch of rows.

    While there are few rows a stretch is a row; when stretches become too many, neighbours are joined.
    """

    def __init__(self) -> None:
        self._size = 1
        self._parts: list[FloatArray] = []  # (5, k, stretches): time, least, largest, sum, count
        self._held: list[tuple[FloatArray, FloatArray]] = []
        self._rows = 0

    def add(self, t: FloatArray, values: FloatArray) -> None:
        """Add rows: times (T,) and channels (T, k); NaN is left out."""
        self._held.append((t, values))
        self._rows += len(t)
        if self._rows >= 2 * STRETCHES * self._size:
            self._gather()

    @property
    def t(self) -> FloatArray:
        """Middle of each stretch (S,) [s]."""
        return np.asarray(self._whole()[0, 0] if self else np.empty(0))

    @property
    def low(self) -> FloatArray:
        """Least value of each stretch (S, k); NaN where there is none."""
        return np.asarray(self._whole()[1].T)

    @property
    def high(self) -> FloatArray:
        """Largest, likewise."""
        return np.asarray(self._whole()[2].T)

    @property
    def mean(self) -> FloatArray:
        """Mean, likewise."""
        _, _, _, total, count = self._whole()
        with np.errstate(invalid="ignore"):
            return np.asarray((total / count).T)

    @property
    def largest(self) -> FloatArray:
        """Largest size of each channel (k,); 0 of one without a value."""
        sizes = np.fmax(np.abs(self.low), np.abs(self.high))
        return np.asarray(np.fmax.reduce(sizes, axis=0, initial=0.0))

    def __bool__(self) -> bool:
        """Whether there are rows."""
        return bool(self._parts or self._rows)

    def _whole(self) -> FloatArray:
        self._gather(all_rows=True)
        return np.asarray(np.concatenate(self._parts, axis=2))

    def _gather(self, *, all_rows: bool = False) -> None:
        """Turn rows into stretches; those that fill none are held back unless ``all_rows``."""
        if self._rows:
            t = np.concatenate([times for times, _ in self._held])
            values = np.concatenate([rows for _, rows in self._held])
            whole = len(t) if all_rows else len(t) - len(t) % self._size
            if whole:
                self._parts.append(_stretches(t[:whole], values[:whole], self._size))
            self._held, self._rows = [(t[whole:], values[whole:])], len(t) - whole
        while sum(part.shape[2] for part in self._parts) > 2 * STRETCHES:
            self._parts = [_joined(np.concatenate(self._parts, axis=2))]
            self._size *= 2


def _stretches(t: FloatArray, values: FloatArray, size: int) -> FloatArray:
    begins = np.arange(0, len(t), size)
    counts = np.diff(begins, append=len(t))
    middle = np.add.reduceat(t, begins) / counts
    total = np.add.reduceat(np.nan_to_num(values), begins)
    there = np.add.reduceat((~np.isnan(values)).astype(float), begins)
    low, high = np.fmin.reduceat(values, begins), np.fmax.reduceat(values, begins)
    stacked = np.stack([np.broadcast_to(middle[:, None], low.shape), low, high, total, there])
    return np.asarray(stacked.transpose(0, 2, 1))


def _joined(parts: FloatArray) -> FloatArray:
    """Stretches in pairs; a last one alone stays as it is."""
    if parts.shape[2] % 2:
        return np.asarray(np.concatenate([_joined(parts[:, :, :-1]), parts[:, :, -1:]], axis=2))
    first, second = parts[:, :, ::2], parts[:, :, 1::2]
    low, high = np.fmin(first[1], second[1]), np.fmax(first[2], second[2])
    return np.asarray(np.stack([0.5 * (first[0] + second[0]), low, high, first[3] + second[3], first[4] + second[4]]))
