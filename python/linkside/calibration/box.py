"""The maximum of a concave quadratic within bounds."""

from __future__ import annotations

import numpy as np

from linkside.arrays import FloatArray

LEAST = 1e-9
"""A bound is left only if that gains more than this."""

PER_SIZE = 20
"""Changes of the set of bounds that hold, for each unknown: more are rounding."""


def within(gradient: FloatArray, curvature: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Maximise gᵀx − ½ xᵀH x, low ≤ x ≤ high, by the primal active-set method.

    Along a direction that hardly counts beside others it goes as far as along these (J. Nocedal, S. J. Wright,
    "Numerical optimization", 2006, algorithm 16.3); `scipy.optimize.lsq_linear` stops as soon as a step of its own is
    small.

    Parameters
    ----------
    gradient, curvature
        g (p,) and H (p, p), positive definite.
    low, high
        Bounds (p,), at most and at least 0.
    """
    x, held = np.zeros_like(gradient), np.zeros(len(gradient), dtype=bool)
    for _ in range(PER_SIZE * len(gradient)):
        free = ~held
        step = np.zeros_like(x)
        step[free] = np.linalg.solve(curvature[np.ix_(free, free)], (gradient - curvature @ x)[free])
        bound = np.where(step < 0, low, high)
        room = np.divide(bound - x, step, out=np.full_like(x, np.inf), where=step != 0)
        first = int(np.argmin(room))
        if room[first] < 1:
            x = x + room[first] * step
            x[first], held[first] = bound[first], True
            continue
        x = x + step
        slope = gradient - curvature @ x
        inward = held & np.where(x <= low, slope > 0, slope < 0)
        gain = np.where(inward, 0.5 * slope**2 / np.diag(curvature), 0.0)
        if gain.max(initial=0.0) < LEAST:
            break
        held[int(np.argmax(gain))] = False
    return x
