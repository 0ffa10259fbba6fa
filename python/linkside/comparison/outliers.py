"""Repeats unlike the others: by their distance from the median path, on a logarithmic scale."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.stats import norm

from linkside.arrays import FloatArray

LEAST = 5
"""Repeats from which on one of them can be an outlier."""

FALSE_ALARMS = 0.01
"""Share of the sets of repeats without an outlier in which one is named."""

QUANTILES = (0.75, 0.9)
"""Of the logarithms of distances: what they are above the median shows the spread of normal ones."""

NEAREST = 1e-3
"""Smaller distances, as shares of the median, are taken as this: a repeat can be the median path itself."""

ROUNDS = 30


def apart(gram: FloatArray, order: FloatArray | None = None) -> FloatArray:
    """Deviations of repeats from the path whose distances to them have the least sum, as their products.

    The path is the spatial median (E. Weiszfeld, Tohoku Math. J. 43, 1937), which an outlier hardly moves; with
    ``order``, it changes linearly from repeat to repeat.

    Parameters
    ----------
    gram
        Mean over time of the products of the repeats' deviations from any common path, (R, R).
    order
        When each repeat was made, (R,).

    Returns
    -------
    (R, R)
        The same of deviations from that path; its diagonal has squares of distances.
    """
    count = len(gram)
    of = np.ones((count, 1)) if order is None else np.stack([np.ones(count), order - order.mean()], axis=1)
    weights, deviations = np.ones(count), gram
    for _ in range(ROUNDS):
        left = np.eye(count) - of @ np.linalg.solve(of.T @ (weights[:, None] * of), of.T * weights)
        deviations = left @ gram @ left.T
        sizes = distances(deviations)
        weights = 1 / np.maximum(sizes, NEAREST * np.median(sizes)) if np.median(sizes) else weights
    return np.asarray(deviations)


def distances(deviations: FloatArray) -> FloatArray:
    """Size of each deviation, (R,), from their products."""
    return np.sqrt(np.maximum(np.diag(deviations), 0.0))


def outlying(deviations: FloatArray) -> npt.NDArray[np.bool_]:
    """Which repeats are further from the path than one of this number is by chance, (R,).

    Logarithms of distances are compared with their median, in units of their spread above it. An outlier is also
    further from the next repeat than the tail of the others goes on: beyond a high quantile, logarithms of what has
    heavy tails are exponential (B. M. Hill, Annals of Statistics 3, 1975).

    Parameters
    ----------
    deviations
        As `apart` gives them, (R, R).
    """
    sizes = distances(deviations)
    usual = float(np.median(sizes))
    if len(sizes) < LEAST or not usual:
        return np.zeros(len(sizes), bool)
    sizes = np.maximum(sizes, NEAREST * usual)
    far = np.log(sizes / usual)
    odd = far > norm.isf(FALSE_ALARMS / len(far)) * max(_spread(far), _least_spread(deviations, sizes))
    while odd.any() and far[odd].min() - far[~odd].max() < _tail(far[~odd]) * -np.log(FALSE_ALARMS):
        odd &= far > far[odd].min()
    return np.asarray(odd)


def _spread(far: FloatArray) -> float:
    """Standard deviation by what quantiles are above the median."""
    ranked = np.sort(far)
    return max(float(ranked[int(share * (len(far) - 1))] / norm.ppf(share)) for share in QUANTILES)


def _least_spread(deviations: FloatArray, sizes: FloatArray) -> float:
    """Standard deviation of the logarithm of the size of normal deviations in as many dimensions as these have.

    That number is how many times less than parallel two of them are: the mean square of the cosine is its inverse.
    """
    cosines = np.clip(deviations / np.outer(sizes, sizes), -1.0, 1.0)
    return float(np.sqrt(0.5 * np.mean(cosines[np.triu_indices(len(sizes), 1)] ** 2)))


def _tail(far: FloatArray) -> float:
    """How fast the upper quarter of logarithms goes on: the mean excess over the highest of the rest."""
    ranked = np.sort(far)
    upper = max(1, len(far) // 4)
    return float(np.mean(ranked[-upper:] - ranked[-upper - 1]))
