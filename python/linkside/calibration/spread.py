"""How large residuals are: by themselves, since nothing else tells a model's errors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkside.arrays import FloatArray

from .problem import HUBER

ROUNDS = 20


def spread(residuals: Sequence[FloatArray], least: FloatArray) -> FloatArray:
    """Give each channel's standard deviation, at least ``least``, from (T, m) residuals, NaN where missing."""
    joined = np.concatenate(residuals)
    given = np.isfinite(joined)
    square, count = np.where(given, joined, 0.0) ** 2, np.maximum(1, given.sum(axis=0))
    # Outliers contribute as if they were `HUBER` of it (Huber 1964, proposal 2). A median would be that of a robot at
    # rest where it rests most of the time.
    variance = square.sum(axis=0) / count
    for _ in range(ROUNDS):
        variance = np.minimum(square, HUBER**2 * variance).sum(axis=0) / count
    return np.asarray(np.maximum(np.sqrt(variance), least))
