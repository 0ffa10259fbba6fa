"""Eigenvalues that are kept together, by cutting planes."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from linkside.arrays import FloatArray, Progress

GAP = 1e-3
"""How near the optimum the search has to come, relative to it."""

_ROUNDS = 100
_REACH = 1e4
_LEAST = 64


def widest(
    left: FloatArray, right: FloatArray, gap: float = GAP, progress: Progress | None = None
) -> tuple[FloatArray, float]:
    """Maximise t over X with ``t I <= S_i X R_i + (S_i X R_i)ᵀ <= I`` for all i.

    Kelley's method: that a matrix is above ``t I`` is a linear inequality ``uᵀ Q u >= t`` for each unit vector u, and
    eigenvectors are the inequalities that a trial violates most. Trials are the linear program's solution and the point
    halfway from it to the best so far, which keeps them from jumping about (Ben-Ameur and Neto 2007).

    Parameters
    ----------
    left : (T, n, n)
        S; X = (I, 0) has to be a trial of the right size.
    right : (T, m, n)
        R.
    gap
        See `GAP`.
    progress
        Called as ``progress(round, most rounds)`` after each.

    Returns
    -------
    X : (n, m)
        Coefficients.
    t : float
        An upper bound of the maximum, the linear program's; the matrices of X tell how near it is.
    """
    n, width = left.shape[1], right.shape[1]
    size = n * width
    best = np.eye(n, width)
    best /= _eigen(left, right, best)[0].max()
    reached, limit = -np.inf, np.inf
    rows = np.empty((0, size + 2))
    trials = [best]
    for done in range(_ROUNDS):
        for trial in trials:
            values, vectors = _eigen(left, right, trial)
            ratio = float(values[:, 0].min() / values[:, -1].max())
            if values[:, -1].max() > 0 and ratio > reached:
                best, reached = trial / values[:, -1].max(), ratio
            rows = np.vstack([rows, _cuts(left, right, values, vectors, most=max(size, _LEAST))])
        solution = _program(rows, size)
        limit = min(limit, float(solution[-1]))
        if progress is not None:
            progress(done + 1, _ROUNDS)
        if limit - reached <= gap * abs(limit):
            break
        slack = rows[:, -1] - rows[:, :-1] @ solution
        rows = rows[np.argsort(slack, kind="stable")[: 4 * max(size, _LEAST)]]
        trial = solution[:-1].reshape(n, width)
        trials = [trial, 0.5 * (trial + best)]
    return best, limit


def _eigen(left: FloatArray, right: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    product = left @ x @ right
    values, vectors = np.linalg.eigh(product + product.transpose(0, 2, 1))
    return np.asarray(values), np.asarray(vectors)


def _cuts(left: FloatArray, right: FloatArray, values: FloatArray, vectors: FloatArray, most: int) -> FloatArray:
    """Rows ``(a, b, c)`` of ``a·X + b t <= c`` at the least and the greatest eigenvectors that are worst."""
    rows = []
    for index, sign in ((0, 1.0), (-1, -1.0)):
        worst = np.argsort(sign * values[:, index], kind="stable")[:most]
        u = vectors[worst, :, index]
        before = np.einsum("tji,tj->ti", left[worst], u)
        after = np.einsum("tmj,tj->tm", right[worst], u)
        form = 2 * np.einsum("ti,tm->tim", before, after).reshape(len(worst), -1)
        ends = np.tile([1.0, 0.0] if index == 0 else [0.0, 1.0], (len(worst), 1))
        rows.append(np.hstack([-sign * form, ends]))
    return np.vstack(rows)


def _program(rows: FloatArray, size: int) -> FloatArray:
    """Maximise t under the rows."""
    bounds = [(-_REACH, _REACH)] * size + [(None, 1.0)]
    found = linprog(-np.eye(size + 1)[-1], A_ub=rows[:, :-1], b_ub=rows[:, -1], bounds=bounds, method="highs")
    return np.asarray(found.x, np.float64)
