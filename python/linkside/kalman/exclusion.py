"""Going on without a channel that was found faulty, from the sample on at which its fault began."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from linkside.errors import NumericalError
from linkside.findings import Fault
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log

from .start import WINDOW

Found = TypeVar("Found", bound=Estimate)

LEAD = 16
"""Samples that a fault may take to be named, which the filter has then already used."""

REPEATS = ("stuck", "saturated", "dead")
"""Kinds of faults that a channel shows by itself, whatever the model says."""


def excluding(log: Log, estimate: Found, signals: Iterable[str], run: Callable[[Log], Found]) -> Found:
    """The estimate of a recording without its faulty channels, found one by one; ``estimate`` where that does not help.

    A fault disturbs the other channels too, so that of those which an estimate names only the first counts: its
    readings are missing from there on, and the recording is estimated once more, at most as often as there are
    channels. If another channel is then named from the same time on, the first was named in its place, and is read
    again. Channels that accuse each other stay, and so do the flags of their rows.
    """
    signals, plain, tried = tuple(signals), estimate, set[str | None]()
    excluded: list[Fault] = []
    while (fault := _first(estimate)) is not None:
        if fault.channel in tried or not _is_clear(fault, log, signals):
            return plain
        tried.add(fault.channel)
        excluded = [one for one in excluded if one.kind in REPEATS or one.since + WINDOW < fault.since]
        excluded.append(replace(fault, left_out=True))
        try:
            estimate = run(_without(log, signals, excluded))
        except NumericalError:  # nothing else tells where that joint is: flagged rows are better than none
            return plain
    return replace(estimate, findings=(*excluded, *estimate.findings))


def _first(estimate: Estimate) -> Fault | None:
    """The named fault that began first."""
    named = [fault for fault in estimate.findings if fault.channel is not None]
    return min(named, key=lambda fault: fault.since, default=None)


def _is_clear(fault: Fault, log: Log, signals: Iterable[str]) -> bool:
    """Whether it is not of a start that was fitted to readings of another channel, and a filter can start without."""
    if fault.kind not in REPEATS:
        return fault.since >= WINDOW
    return fault.since > 0 or _place(log, signals, fault)[0] != "theta"


def _place(log: Log, signals: Iterable[str], fault: Fault) -> tuple[str, int]:
    """The signal of a fault's channel, and its column."""
    signal = next(name for name in signals if fault.channel in log.columns(name))
    return signal, log.columns(signal).index(str(fault.channel))


def _without(log: Log, signals: Iterable[str], excluded: Iterable[Fault]) -> Log:
    """The recording without the readings of faulty channels, from where their faults began."""
    for fault in excluded:
        signal, channel = _place(log, signals, fault)
        readings = getattr(log, signal).copy()
        own, since = readings[:, channel], fault.since
        if fault.kind in REPEATS:
            # Found when it had come several times: to the first that is the same.
            while since > (signal == "theta") and own[since - 1] == own[fault.since]:
                since -= 1
        else:
            since -= LEAD
        own[since:] = np.nan
        log = replace(log, **{signal: readings})
    return log
