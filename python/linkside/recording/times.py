"""Rows of two recordings that belong together, by their times."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError


def counterparts(t: FloatArray, truth: FloatArray, source: str) -> npt.NDArray[np.intp]:
    """Rows of the truth at the times of an estimate."""
    if len(t) == 0 or len(truth) == 0:
        raise EstimatorError(f"there is nothing to compare: {len(t)} rows against {len(truth)} in {source}")
    tolerance = 0.01 * float(np.median(np.diff(truth))) if len(truth) > 1 else 1e-9
    rows = np.clip(np.searchsorted(truth, t - tolerance), 0, len(truth) - 1)
    apart = ~(np.abs(truth[rows] - t) <= tolerance)
    if apart.any():
        row = int(np.argmax(apart))
        raise EstimatorError(f"times differ: row {row} (t = {t[row]:.9g}) has no counterpart in {source}")
    return rows
