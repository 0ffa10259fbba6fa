"""Which joints move in a recording."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from .log import Log

LEAST_MOTION = 1e-3
"""A joint whose motor moves by less contains no information about its transmission [rad]."""


def moving(log: Log) -> npt.NDArray[np.bool_]:
    """Which joints' motors move at all, (n,)."""
    return np.asarray(np.fmax.reduce(log.theta) - np.fmin.reduce(log.theta) > LEAST_MOTION)
