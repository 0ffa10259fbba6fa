"""Checks of time: its unit, its resolution, and the rate that robot.yaml states."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .finding import Finding, Verdict
from .view import View

UNITS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
"""Seconds in each unit."""

RATES = (50.0, 20_000.0)
"""Rates at which robots are recorded [1/s]."""

SLOW = 0.2
"""A period above this, of a recording that states no rate, is suspicious [s]."""

RATE_TOLERANCE = 0.02
"""By how much a recording's rate may differ from the one stated."""

REACH = 8
"""Rows to each side from which a motor's velocity is taken where times are compared with positions."""

SURE = 6.0
"""Standard deviations of a share from which it is not chance."""


def unit(period: float, rate: float | None, column: str) -> Finding | None:
    """Recognise a time that is not in seconds: certain by the rate stated, or because nothing else fits."""
    for name, seconds in UNITS.items():
        stated = rate is not None and abs(period * seconds * rate - 1) < RATE_TOLERANCE
        only = rate is None and period > 50 and RATES[0] < 1 / (period * seconds) < RATES[1]
        if stated or only:
            what = f"is in {name} (steps of {period:.6g})"
            return Finding(name, "mended", column, what, "read as such; record seconds to be sure", size=seconds)
    return None


def rate(view: View) -> Iterator[Finding]:
    """Compare the recording's rate with ``rate_hz``."""
    period, stated = view.log.period, view.robot.config.rate_hz
    (column,) = view.log.columns("t")
    if stated is not None and not _agrees(view, stated):
        what = f"has steps of {period:.6g} s, {1 / period:.6g} Hz, where robot.yaml says {stated:g} Hz"
        remedy = "correct rate_hz, or the unit of time if it is not seconds"
        yield view.finding("rate", "suspicious", column, what, remedy, size=period)
    elif stated is None and period > SLOW:
        what, remedy = f"has steps of {period:.6g} s", "if that is not seconds, convert it; else state rate_hz"
        yield view.finding("rate", "suspicious", column, what, remedy, size=period)


def _agrees(view: View, stated: float) -> bool:
    """Whether rows come at the rate stated, or where sensors have rates of their own, readings of a motor do."""
    periods = np.append(view.log.pace.usual.get("theta", []), view.log.period)
    return bool((np.abs(periods * stated - 1) <= RATE_TOLERANCE).any())


def resolution(view: View) -> Iterator[Finding]:
    """Find a time that was float32, once its steps are no longer those of the recording."""
    t, period = view.log.t, view.log.period
    (unit,) = view.log.recorded_size("t")
    recorded = t if unit == 1 else t / unit
    grain = float(unit * np.spacing(np.float32(np.abs(recorded[-1]))))
    rounded = np.abs(recorded.astype(np.float32) - recorded) <= 1e-14 * np.abs(recorded)
    if grain < period / 50 or len(t) < 3 or not rounded.all():
        return
    off = np.abs(np.diff(t) - period) > period / 50
    if off.mean() > 0.005:
        what = f"has the resolution of 32 bits, {grain:.2g} s where the period is {period:.6g} s"
        (column,) = view.log.columns("t")
        remedy = "record it in 64 bits, or subtract its beginning before it is converted"
        verdict: Verdict = "refused" if grain > period / 5 else "suspicious"
        yield view.finding("float32", verdict, column, what, remedy, at=int(np.argmax(off)) + 1, size=grain)


def evenness(view: View) -> Iterator[Finding]:
    """Find times that fluctuate where positions do not: those of evenly spaced samples, read off another clock.

    With v the velocity about a row and d its step of time less the period, evenly spaced samples move by v d less than
    v times the step, samples whose times are right by no less. By least squares over all rows and motors, the share of
    v d that is missing is 1 or 0.
    """
    t, period = view.log.t, view.log.period
    late = np.diff(t) - period
    usual = np.abs(late) < period / 2
    if len(t) < 20 * REACH or late[usual].std() < period / 100:
        return
    rows = np.flatnonzero(usual)
    rows = rows[(rows >= REACH) & (rows < len(late) - REACH)]
    around = view.log.theta[rows + 1 + REACH] - view.log.theta[rows - REACH]
    speed = around / (t[rows + 1 + REACH] - t[rows - REACH])[:, None]
    step = view.log.theta[rows + 1] - view.log.theta[rows]
    expected, missing = speed * late[rows, None], speed * np.diff(t)[rows, None] - step
    there = np.isfinite(missing)
    x, y = expected[there], missing[there]
    power = np.sum(x * x)
    if power == 0:
        return
    share = np.sum(x * y) / power
    std = np.sqrt(np.sum((x * (y - share * x)) ** 2)) / power
    if share > 0.5 and share - 0.5 > SURE * std:
        spread = float(late[usual].std() / np.sqrt(2))
        what = f"fluctuates by {spread:.2g} s, where motors move as they do in samples {period:.6g} s apart"
        remedy = "record when samples were taken, or write times at that period"
        yield view.finding("uneven", "suspicious", view.log.columns("t")[0], what, remedy, size=spread)
