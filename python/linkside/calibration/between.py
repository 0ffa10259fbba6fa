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
    gradients: FloatArray, informations: FloatArray, shares: FloatArray, prior: FloatArray, at: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variances between logs, (c,), by restricted maximum likelihood, and their degrees of freedom.

    A log's estimate of c parameters is what all logs share, and an effect of that log, N(0, B) with a diagonal B, and
    the noise that its information foretells: errors of a model differ with the motion. Effects and shared values
    follow from Henderson's equations, and each variance from the squares of effects over the degrees of freedom that
    are left to them (D. A. Harville, J. American Statistical Association 72, 1977).

    Parameters
    ----------
    gradients, informations
        Of each log's likelihood at the shared values, (N, c) and (N, c, c).
    shares
        Derivatives of each log's parameters in what is shared, (N, c, d).
    prior, at
        Information of the prior of what is shared, (d, d), and where that is now, (d,), the prior's mean at zero.
    """
    found = 1 / np.maximum(np.mean(np.diagonal(informations, axis1=1, axis2=2), axis=0), LEAST)
    freedom = np.ones_like(found)
    for _ in range(ROUNDS):
        root = np.sqrt(found)
        left = np.linalg.inv(np.eye(len(root)) + root[:, None] * informations * root)
        spread = root[:, None] * left * root
        taken = informations @ spread
        seen = (informations - taken @ informations) @ shares
        curvature = prior + np.einsum("nca,ncb->ab", shares, seen)
        slope = np.einsum("nca,nc->a", shares, gradients - np.einsum("ncd,nd->nc", taken, gradients)) - prior @ at
        step = np.linalg.solve(curvature, slope)
        effects = np.einsum("ncd,nd->nc", spread, gradients - informations @ shares @ step)
        by = np.swapaxes(taken, 1, 2) @ shares
        unknown = np.diagonal(spread, axis1=1, axis2=2) + np.einsum("nca,ab,ncb->nc", by, np.linalg.inv(curvature), by)
        freedom = np.maximum(np.sum(1 - unknown / found, axis=0), 1.0)
        found = np.maximum(np.sum(effects**2, axis=0) / freedom, LEAST)
    return np.asarray(found), np.asarray(freedom)


def widened(found: FloatArray, freedom: FloatArray) -> FloatArray:
    """Variances with which 1.96 standard errors hold as much as a Student distribution's 95 %."""
    return np.asarray(found * (stats.t.ppf(0.975, np.maximum(freedom, LEAST_FREEDOM)) / stats.norm.ppf(0.975)) ** 2)
