"""Checks that an observer can follow a recording: an even rate, and no reading missing for long."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from linkside.errors import LogError

from .log import Log
from .pace import LONGEST_DROPOUT

UNEVEN = 0.2
"""A step of time may differ from the period by this share of it."""


def longest_dropout(log: Log) -> int:
    """Rows for which an observer bridges a missing reading."""
    return max(1, round(LONGEST_DROPOUT / log.period))


def refuse_uneven(
    log: Log,
    before: Log | None = None,
    first: int = 0,
    *,
    purpose: str = "this estimator",
    instead: str = ", or take a Kalman filter",
    share: float = UNEVEN,
) -> None:
    """Raise `LogError` at the first step of time that is off the period by a ``share`` of it."""
    steps = np.diff(log.t, prepend=log.t[0] - log.period if before is None else before.t[-1])
    off = np.abs(steps - log.period) > share * log.period
    if off.any():
        row, rate = int(np.argmax(off)), float(f"{1 / min(log.pace.fastest, log.period * 1e3):.4g}")
        raise LogError(
            f"{log.source}: row {first + row} (t = {log.t[row]:.6g}): {steps[row]:.6g} s after the row before, where "
            f"the period is {log.period:.6g} s; {purpose} needs an even rate: resample the log, with "
            f"--rate {rate:g} (of `linkside merge` or `estimate`) or Log.resample({rate:g}){instead}"
        )


def refuse_dropouts(
    log: Log, signal: str, channels: npt.NDArray[np.bool_], before: Log | None = None, first: int = 0
) -> None:
    """Raise `LogError` where one of a signal's ``channels`` is missing for longer than an observer can bridge."""
    values = getattr(log, signal)
    if values is None:
        return
    missing = np.isnan(values) & channels
    earlier = np.zeros((0, missing.shape[1]), bool) if before is None else np.isnan(getattr(before, signal)) & channels
    if not missing.any():
        return
    # A run of more than `longest` rows: the count of missing rows over a window equals its length.
    longest = longest_dropout(log)
    counts = np.cumsum(np.vstack([np.zeros((1, missing.shape[1]), int), earlier, missing]), axis=0)
    runs = counts[longest + 1 :] - counts[: -longest - 1] > longest
    if runs.any():
        start, channel = np.argwhere(runs)[0]
        row = int(start) - len(earlier)
        time = log.t[0] + row * log.period
        raise LogError(
            f"{log.source}: row {first + row} (t = {time:.6g}): '{log.columns(signal)[int(channel)]}' is missing for "
            f"more than {LONGEST_DROPOUT} s, longer than an observer can bridge"
        )
