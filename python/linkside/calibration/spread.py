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
    sizes = [_size(column[np.isfinite(column)]) for column in joined.T]
    return np.maximum(sizes, least)


def _size(values: FloatArray) -> float:
    """Standard deviation to which outliers contribute as if they were `HUBER` of it (Huber 1964, proposal 2).

    A median would be that of a robot at rest where it rests most of the time.
    """
    if not len(values):
        return 0.0
    square, size = values**2, float(np.sqrt(np.mean(values**2)))
    for _ in range(ROUNDS):
        size = float(np.sqrt(np.mean(np.minimum(square, (HUBER * size) ** 2))))
    return size
