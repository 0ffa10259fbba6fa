"""The most probable parameters: SciPy's trust-region method within bounds, on exact gradient and information."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.optimize

from ..errors import NumericalError
from .problem import Evidence, Problem

FloatArray = npt.NDArray[np.float64]
Progress = Callable[["Step"], None]

EVALUATIONS = 60
GAIN = 0.02
"""A step that gains less log-likelihood than this is the last: what is left to gain is a fifth of a standard error."""

ROUGH = 2.0
"""Likewise, where it is only to be found out what the recordings tell."""

LEAST_CURVATURE = 0.1
"""A share of Fisher's information; less is not believed."""

FLOOR = 20.0
"""No reading's log-density exceeds this: its standard deviation would be below 1e-9 of its unit."""


@dataclass(frozen=True)
class Step:
    """Where a search is.

    Attributes
    ----------
    evaluation : int
        Counted from 1.
    log_likelihood : float
        Of the recordings, at the best point so far.
    change : float
        Largest change of a parameter since the best point before, in tolerances.
    changed : str
        Whose.
    z : dict of str to float
        The best point so far.
    """

    evaluation: int
    log_likelihood: float
    change: float
    changed: str
    z: dict[str, float]


@dataclass
class Search:
    """A search for the maximum of the posterior.

    The posterior's maximum is found as a problem of least squares that has its value, its gradient g and Fisher's
    information H + 1 (with that of the prior): residuals L⁻¹g and one more that makes up the value, Jacobian Lᵀ and
    zero, with L Lᵀ = H + 1. `scipy.optimize.least_squares` then takes Gauss-Newton steps (scoring) in a trust
    region within bounds (Branch, Coleman and Li 1999): Newton's method without second derivatives, in thirty or so
    evaluations.
    """

    problem: Problem
    progress: Progress | None = None
    gain: float = GAIN
    evaluations: int = 0
    best: float = -np.inf
    best_at: FloatArray = field(default_factory=lambda: np.zeros(0))
    _gradient: FloatArray = field(default_factory=lambda: np.zeros(0))
    _point: FloatArray = field(default_factory=lambda: np.zeros(0))
    _residuals: FloatArray = field(default_factory=lambda: np.zeros(0))
    _jacobian: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    _offset: float = 0.0

    def maximise(self, start: FloatArray) -> FloatArray:
        """Search from ``start``; raises NumericalError when the filter breaks down there."""
        if not len(start):
            return start
        low, high = self.bounds()
        used = self.problem.evidence(np.clip(start, low, high)).used
        self._offset = FLOOR * used
        # Shifted by one: the first step may then be a tolerance long, where SciPy takes the start's size for a scale.
        scipy.optimize.least_squares(
            lambda x: self._residual(x - 1),
            np.clip(start, low, high) + 1,
            jac=lambda x: self._slope(x - 1),
            bounds=(low + 1, high + 1),
            method="trf",
            ftol=self.gain / self._offset,
            xtol=1e-5,
            gtol=1e-3,
            max_nfev=EVALUATIONS,
        )
        return self.best_at

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of z."""
        free = self.problem.free
        return np.array([p.z(p.low) for p in free]), np.array([p.z(p.high) for p in free])

    def _residual(self, z: FloatArray) -> FloatArray:
        self._point = np.array(z)
        try:
            evidence = self.problem.evidence(z)
        except NumericalError:  # this far out the filter breaks down: the trust region shrinks
            return np.full(len(z) + 1, np.inf)
        self._pose(z, evidence)
        self._report(z, evidence)
        return self._residuals

    def _slope(self, z: FloatArray) -> FloatArray:
        if not np.array_equal(z, self._point):
            self._residual(z)
        return self._jacobian

    def _pose(self, z: FloatArray, evidence: Evidence) -> None:
        value = self._offset - evidence.log_likelihood + 0.5 * z @ z
        factor = np.linalg.cholesky(self._curvature(z, evidence))
        step = scipy.linalg.solve_triangular(factor, z - evidence.gradient, lower=True)
        rest = np.sqrt(max(0.0, 2 * value - step @ step))
        self._residuals = np.append(step, rest)
        self._jacobian = np.vstack([factor.T, np.zeros(len(z))])

    def _curvature(self, z: FloatArray, evidence: Evidence) -> FloatArray:
        """Fisher's information, and what the gradient's change since the best point says along the way from there.

        That is one update of Broyden, Fletcher, Goldfarb and Shanno: where the model is wrong, information may be half
        of the curvature, and steps would go back and forth.
        """
        curvature = evidence.information + np.eye(len(z))
        if not len(self.best_at):
            return curvature
        way = z - self.best_at
        change = (z - evidence.gradient) - self._gradient
        along, expected = way @ change, curvature @ way
        if along <= LEAST_CURVATURE * (way @ expected):
            return curvature
        updated = curvature + np.outer(change, change) / along - np.outer(expected, expected) / (way @ expected)
        return np.asarray(updated)

    def _report(self, z: FloatArray, evidence: Evidence) -> None:
        self.evaluations += 1
        posterior = evidence.log_likelihood - 0.5 * float(z @ z)
        if posterior <= self.best:
            return
        before = self.best_at if len(self.best_at) else z
        self.best, self.best_at, self._gradient = posterior, np.array(z), z - evidence.gradient
        if self.progress is not None:
            largest = int(np.argmax(np.abs(z - before)))
            names = [p.name for p in self.problem.free]
            change = float((z - before)[largest])
            where = {p.name: x for p, x in self.problem.held} | dict(zip(names, z.tolist(), strict=True))
            self.progress(Step(self.evaluations, evidence.log_likelihood, change, names[largest], where))
