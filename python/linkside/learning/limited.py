"""A step of learning that keeps limits."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from linkside.arrays import FloatArray

from .blocks import BlockProgram
from .signals import Bounds, Signals

TRIES = 4
"""Most programs that are solved: signals between the ends of blocks may pass a limit, which is then moved."""


def limited(
    change: FloatArray, blocks: BlockProgram, signals: Signals, limits: Bounds, far: Callable[[FloatArray], bool]
) -> FloatArray:
    """The step (T, n) of least cost within limits, beside ``change``, which is that without.

    The last repeat may have been beyond a limit. If there is no way back, or only one at the price of ``far`` larger
    errors, at least none goes further; that of no size does not, so that a part of a step is always possible.
    """
    reachable = limits.reachable()
    for bounds in (limits, reachable):
        found = _within(change, blocks, signals, bounds)
        if found is not None and not far(found):
            return reachable.share(signals.deviation(found)) * found
    return reachable.share(signals.deviation(change)) * change


def _within(change: FloatArray, blocks: BlockProgram, signals: Signals, bounds: Bounds) -> FloatArray | None:
    """The step of least cost within bounds; None if there is none."""
    free = signals.deviation(change)
    low, high = bounds.low - free, bounds.high - free
    scale = float(np.abs(free[:, 0]).max())
    for _ in range(TRIES):
        w = blocks.solve(_at_ends(low, blocks, np.maximum), _at_ends(high, blocks, np.minimum), scale)
        if w is None:
            return None
        found = change + blocks.constant(w, len(change))
        deviation = signals.deviation(found)
        if not bounds.passed(deviation).any():
            break
        low = low + np.maximum(bounds.low - deviation, 0.0)
        high = high - np.maximum(deviation - bounds.high, 0.0)
    return found


def _at_ends(bound: FloatArray, blocks: BlockProgram, nearer: np.ufunc) -> FloatArray:
    """The narrowest bound of each block (N, 4, n), and at its start also of the block before; none at the first start.

    The acceleration is constant over a block, and has a bound there only.
    """
    inside = nearer.reduceat(bound, blocks.first, axis=0)
    around = inside.copy()
    around[1:] = nearer(inside[1:], inside[:-1])
    around[0] = np.inf if nearer is np.minimum else -np.inf
    around[:, 2] = inside[:, 2]
    return np.asarray(around, np.float64)
