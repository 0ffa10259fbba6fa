"""The most probable parameters: scoring within bounds and a trust region, on exact gradient and information."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import NumericalError

from .box import within
from .posterior import Posterior
from .problem import Evidence

Progress = Callable[["Step"], None]

EVALUATIONS = 60
GAIN = 0.02
"""A step that gains less log-likelihood than this is the last: what is left to gain is a fifth of a standard error."""

ROUGH = 2.0
"""Likewise, where it is only to be found out what the recordings tell."""

LEAST_CURVATURE = 0.1
"""Smallest curvature that is used, as a share of Fisher's information."""

BOX = 1.0
"""Longest first step of any parameter, in tolerances."""


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


@dataclass(frozen=True, eq=False)
class _Point:
    """Where the posterior was evaluated: its logarithm, that one's gradient, and the curvature."""

    z: FloatArray
    value: float
    gradient: FloatArray
    curvature: FloatArray


@dataclass
class Search:
    """A search for the maximum of the posterior.

    Scoring: each step maximises the quadratic that has the posterior's gradient and Fisher's information (with that of
    the prior), within bounds and a box. The box grows and shrinks with how well the quadratic predicts the gain:
    Newton's method without second derivatives, in twenty or so evaluations.
    """

    problem: Posterior
    progress: Progress | None = None
    gain: float = GAIN
    evaluations: int = 0
    best: float = -np.inf
    best_at: FloatArray = field(default_factory=lambda: np.zeros(0))

    def maximise(self, start: FloatArray) -> FloatArray:
        """Search from ``start``; raises NumericalError when the filter breaks down there."""
        if not len(start):
            return start
        z = np.clip(start, *self.bounds())
        here, box = self._evaluate(z), BOX
        curvature = here.curvature
        while self.evaluations < EVALUATIONS:
            step = self._step(here, curvature, box)
            foretold = float(here.gradient @ step - 0.5 * step @ curvature @ step)
            if foretold < self.gain:
                break
            there = self._try(np.clip(here.z + step, *self.bounds()))
            gained = -np.inf if there is None else there.value - here.value
            box = _resized(box, step, gained / foretold)
            if there is None:
                continue
            curvature = _updated(there.curvature if gained > 0 else here.curvature, here, there)
            if gained > 0:
                here = there
                if gained < self.gain:
                    break
        return here.z

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of z."""
        free = self.problem.free
        return np.array([p.z(p.low) for p in free]), np.array([p.z(p.high) for p in free])

    def _step(self, here: _Point, curvature: FloatArray, box: float) -> FloatArray:
        """The best step within bounds and box."""
        low, high = self.bounds()
        return within(here.gradient, curvature, np.maximum(low - here.z, -box), np.minimum(high - here.z, box))

    def _try(self, z: FloatArray) -> _Point | None:
        """Evaluate; none so far out that the filter breaks down."""
        try:
            return self._evaluate(z)
        except NumericalError:
            return None

    def _evaluate(self, z: FloatArray) -> _Point:
        evidence = self.problem.evidence(z)
        self._report(z, evidence)
        value = evidence.log_likelihood - 0.5 * float(z @ z)
        return _Point(z, value, evidence.gradient - z, evidence.information + np.eye(len(z)))

    def _report(self, z: FloatArray, evidence: Evidence) -> None:
        self.evaluations += 1
        posterior = evidence.log_likelihood - 0.5 * float(z @ z)
        if posterior <= self.best:
            return
        before = self.best_at if len(self.best_at) else z
        self.best, self.best_at = posterior, np.array(z)
        if self.progress is not None:
            largest = int(np.argmax(np.abs(z - before)))
            names = [p.name for p in self.problem.free]
            change = float((z - before)[largest])
            where = {p.name: x for p, x in self.problem.held} | dict(zip(names, z.tolist(), strict=True))
            self.progress(Step(self.evaluations, evidence.log_likelihood, change, names[largest], where))


def _resized(box: float, step: FloatArray, ratio: float) -> float:
    """Grow or shrink the box by the ratio of actual to predicted gain."""
    length = float(np.max(np.abs(step)))
    if ratio < 0.25:
        return 0.25 * length
    return 2 * box if ratio > 0.75 and length > 0.9 * box else box


def _updated(curvature: FloatArray, here: _Point, there: _Point) -> FloatArray:
    """Let the gradient's change between two points say what the curvature is along the way.

    That is one update of Broyden, Fletcher, Goldfarb and Shanno: where the model is wrong, information may be half of
    the curvature, and steps would go back and forth.
    """
    way, change = there.z - here.z, here.gradient - there.gradient
    along, expected = way @ change, curvature @ way
    if along <= LEAST_CURVATURE * (way @ expected):
        return curvature
    update = np.outer(change, change) / along - np.outer(expected, expected) / (way @ expected)
    return np.asarray(curvature + update)
