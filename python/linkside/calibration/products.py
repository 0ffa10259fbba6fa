"""Sums of products of columns, on one thread."""

from __future__ import annotations

import numpy as np

from linkside.arrays import FloatArray

BLOCK = 200_000
"""Multiplications of a block: libraries of linear algebra share larger ones among threads, which wait for each other
longer than these few columns take."""

AT_ONCE = 64


def products(columns: FloatArray) -> FloatArray:
    """Give XᵀX of (N, w), (w, w)."""
    count, width = columns.shape
    rows = max(8, BLOCK // (width * width))
    whole = count // rows * rows
    blocks = columns[:whole].reshape(-1, rows, width)
    total = np.asarray(columns[whole:].T @ columns[whole:])
    for first in range(0, len(blocks), AT_ONCE):
        some = blocks[first : first + AT_ONCE]
        total = total + (some.transpose(0, 2, 1) @ some).sum(axis=0)
    return total
