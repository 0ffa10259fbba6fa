"""First samples without their outliers, for a filter to start from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkside.arrays import FloatArray

from .start import LEAST, Readings, Spread

FAR = 6.0
"""An outlier is this many standard deviations from a curve through the others."""

DEGREE = 3
"""Of that curve."""

ROUNDS = 20
"""Of the reweighting that finds it."""


def cleaned(readings: Readings, spread: Spread, *, motors: bool, acceleration: bool) -> Readings:
    """Put outliers of the signals that may have some on a curve through the rest.

    Fewer than `LEAST` samples stay as they are.
    """
    if len(readings.t) < LEAST:
        return readings
    t, new = readings.t, readings
    with np.errstate(over="ignore", invalid="ignore"):
        if motors:
            new = replace(new, theta=_on_curve(t, new.theta, spread.theta))
            if new.dtheta is not None:
                new = replace(new, dtheta=_on_curve(t, new.dtheta, np.full(new.dtheta.shape[1], spread.dtheta)))
        if acceleration and new.acceleration is not None:
            new = replace(new, acceleration=_on_curve(t, new.acceleration, spread.acceleration))
    return new


def _on_curve(t: FloatArray, values: FloatArray, std: FloatArray) -> FloatArray:
    """Values (k, m) with those far from each column's curve replaced by it."""
    s = 2.0 * (t - t[0]) / (t[-1] - t[0]) - 1.0
    powers = np.polynomial.legendre.legvander(s, DEGREE)
    out: FloatArray = values.copy()
    for column, noise in zip(out.T, std, strict=True):
        there = ~np.isnan(column)
        if there.sum() < LEAST:
            continue
        curve = powers @ _least_absolute(powers[there], column[there], noise)
        away = np.abs(column - curve)
        # Where the motion is no such curve, the scatter about it is the measure.
        scale = max(noise, 1.4826 * float(np.median(away[there])))
        struck = there & (away > FAR * scale)
        column[struck] = curve[struck]
    return out


def _least_absolute(rows: FloatArray, values: FloatArray, noise: float) -> FloatArray:
    """Coefficients of the least sum of absolute residuals, by reweighting."""
    weight: FloatArray = np.ones(len(values))
    fit: FloatArray = np.zeros(rows.shape[1])
    least = max(noise, 1e-12 * float(np.abs(values).max()), np.finfo(float).tiny)
    for _ in range(ROUNDS):
        root = np.sqrt(weight)
        fit = np.asarray(np.linalg.lstsq(rows * root[:, None], values * root, rcond=None)[0], float)
        weight = 1.0 / np.maximum(np.abs(values - rows @ fit), least)
        if not np.isfinite(weight).all():  # of absurd readings, which are refused where a start is found
            break
    return np.asarray(fit)
