"""Two motions on one clock: interpolation, which does not bridge gaps, and the shift between their clocks."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import minimize_scalar

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording import Estimate

ALIGNMENTS = ("time", "start")
"""Rows belong together by their time, or by the time since their motion's first row."""

SAME = 1e-4
"""Rows that differ by less than this share of a period are taken as simultaneous."""

GAP = 1.5
"""Rows that are apart by more periods than this have a gap between them."""

ROWS, STEPS = 20_000, 400
"""Rows that a shift is judged by, and shifts that are tried before the best is refined."""


def sampled(
    t: FloatArray, values: FloatArray, rates: FloatArray | None, at: FloatArray, same: float = SAME
) -> FloatArray:
    """Interpolate columns, (T, k), at other times, (S,): (S, k), NaN outside and in gaps.

    Cubic Hermite where the rates of change, (T, k), are known, linear elsewhere. Rows at the same time, to a
    share ``same`` of a period, are taken as they are.
    """
    if len(t) < 2:
        return np.where(np.isclose(at, t[:1])[:, None], values[:1], np.nan) if len(t) else np.full((len(at), 1), np.nan)
    period = float(np.median(np.diff(t)))
    left = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    step = t[left + 1] - t[left]
    part = ((at - t[left]) / step)[:, None]
    out = (1 - part) * values[left] + part * values[left + 1]
    if rates is not None and np.isfinite(rates).all() and np.isfinite(values).all():
        out = CubicHermiteSpline(t, values, rates)(at)
    out[(step > GAP * period) | (at < t[0]) | (at > t[-1])] = np.nan
    nearest = np.clip(left + (part[:, 0] > 0.5), 0, len(t) - 1)
    alike = np.abs(t[nearest] - at) <= same * period
    out[alike] = values[nearest[alike]]
    return np.asarray(out)


def find_shift(reference: Estimate, estimate: Estimate, largest: float = 0.25) -> float:
    """Find by how much an estimate's clock is late against the reference's [s].

    The shift after which their positions, each without its mean, differ least.

    Parameters
    ----------
    largest
        The largest shift that is looked at, either way [s].

    Raises
    ------
    EstimatorError
        They have no joint in common, do not overlap, or the best is at the largest shift.
    """
    joints = [name for name in estimate.names if name in reference.names]
    if not joints:
        raise EstimatorError("no shift can be found: there is no joint in common")
    rows = slice(None, None, max(1, len(estimate) // ROWS))
    ours, theirs = ([m.names.index(name) for name in joints] for m in (estimate, reference))
    t, q = estimate.t[rows], estimate.q[rows][:, ours]
    known, rates = reference.q[:, theirs], reference.dq[:, theirs]

    def apart(shift: float) -> float:
        difference = q - sampled(reference.t, known, rates, t - shift, same=0.0)
        difference = difference[np.isfinite(difference).all(axis=1)]
        if 2 * len(difference) < len(t):
            return np.inf
        return float(((difference - difference.mean(axis=0)) ** 2).sum() / len(difference))

    grid = np.linspace(-largest, largest, STEPS + 1)
    costs = np.array([apart(shift) for shift in grid])
    best = int(np.argmin(costs))
    if not np.isfinite(costs[best]):
        raise EstimatorError("no shift can be found: the two overlap in less than half of the rows")
    if best in (0, STEPS):
        raise EstimatorError(f"no shift can be found within {largest:g} s; give it, or compare from each one's start")
    width = grid[1] - grid[0]
    bounds = (grid[best] - width, grid[best] + width)
    return float(minimize_scalar(apart, bounds=bounds, method="bounded", options={"xatol": 1e-7}).x)
