"""How much logs of one robot differ by more than their noise: what each has of its own in what all should share."""

from __future__ import annotations

import numpy as np
from scipy import stats

from linkside.arrays import FloatArray

ROUNDS = 100
LEAST = 1e-12
"""Smallest variance of what logs differ by, in squared tolerances."""

LEAST_FREEDOM = 2.0


def variances(
    gradients: FloatArray,
    informations: FloatArray,
    slopes: FloatArray,
    gradient: FloatArray,
    curvature: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Variances between logs, (c,), by restricted maximum likelihood, and their degrees of freedom.

    A log's estimate of c parameters is what all logs have in common, and an effect of that log, N(0, B) with a diagonal
    B, and the noise that its information predicts: errors of a model differ with the motion. Effects and common
    values follow from Henderson's equations, and each variance from the squares of effects over the degrees of freedom
    that are left to them (D. A. Harville, J. American Statistical Association 72, 1977).

    Parameters
    ----------
    gradients, informations
        Of each log's likelihood in its own parameters, (N, c) and (N, c, c).
    slopes
        Of the negative gradients in what logs have in common, (N, c, d).
    gradient, curvature
        Of the posterior in what logs have in common, (d,) and (d, d).
    """
    found = 1 / np.maximum(np.mean(np.diagonal(informations, axis1=1, axis2=2), axis=0), LEAST)
    freedom = np.ones_like(found)
    for _ in range(ROUNDS):
        root = np.sqrt(found)
        left = np.linalg.inv(np.eye(len(root)) + root[:, None] * informations * root)
        spread = root[:, None] * left * root
        follow = spread @ slopes
        covariance = np.linalg.inv(curvature - np.einsum("nca,ncb->ab", slopes, follow))
        step = covariance @ (gradient - np.einsum("nca,nc->a", follow, gradients))
        effects = np.einsum("ncd,nd->nc", spread, gradients - slopes @ step)
        unknown = np.diagonal(spread, axis1=1, axis2=2) + np.einsum("nca,ab,ncb->nc", follow, covariance, follow)
        freedom = np.maximum(np.sum(1 - unknown / found, axis=0), 1.0)
        found = np.maximum(np.sum(effects**2, axis=0) / freedom, LEAST)
    return np.asarray(found), np.asarray(freedom)


def widened(found: FloatArray, freedom: FloatArray) -> FloatArray:
    """Variances with which 1.96 standard errors hold as much as a Student distribution's 95 %."""
    return np.asarray(found * (stats.t.ppf(0.975, np.maximum(freedom, LEAST_FREEDOM)) / stats.norm.ppf(0.975)) ** 2)
