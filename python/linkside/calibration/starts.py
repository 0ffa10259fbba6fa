"""Other places to start from: a posterior may have several maxima, and robot.yaml may be far off."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from linkside.errors import NumericalError

from .problem import Problem

FACTORS = (1 / 3, 1 / 1.7, 1.7, 3.0)
"""Springs that are tried, by what multiple of the value so far."""


def posterior(problem: Problem, at: Mapping[str, float]) -> float:
    """Logarithm of the posterior at ``at``, the parameters' z by name; minus infinity where the filter breaks down."""
    z = np.array([at.get(p.name, 0.0) for p in problem.free])
    try:
        return problem.log_likelihood(z) - 0.5 * float(z @ z)
    except NumericalError:
        return -np.inf


def other_springs(problem: Problem, at: Mapping[str, float]) -> dict[str, float]:
    """Try softer and stiffer springs, one joint after the other, and keep what makes the recordings more probable."""
    best, most = dict(at), posterior(problem, at)
    for p in (p for p in problem.free if p.kind == "stiffness"):
        here = p.value(best.get(p.name, 0.0))
        for value in (factor * here for factor in FACTORS if p.low < factor * here < p.high):
            tried = best | {p.name: p.z(value)}
            if (found := posterior(problem, tried)) > most:
                best, most = tried, found
    return best
