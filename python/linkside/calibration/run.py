"""What a calibration run has whatever its objective: where it is, and what it leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Generic, TypeVar

import numpy as np

from linkside.arrays import FloatArray

from .problem import Problem
from .response import ResponseProblem
from .result import Fit
from .search import Progress
from .uncertainty import Uncertainty, uncertainty, unidentifiable

Objective = TypeVar("Objective", Problem, ResponseProblem)


class CalibrationRun(Generic[Objective]):
    """A problem that is solved step by step.

    Parameters
    ----------
    problem
        What is to be solved.
    still
        Joints that do not move.
    at
        Where to begin, z by name; others at zero, robot.yaml's value.
    progress
        Called with every better point.
    """

    before: Fit
    """How well robot.yaml explains the recordings."""

    def __init__(
        self, problem: Objective, still: Sequence[str], at: Mapping[str, float], progress: Progress | None
    ) -> None:
        self.problem: Objective = problem
        self.still, self.at, self.progress = still, dict(at), progress
        self.refused: dict[str, str] = {}
        self.evaluations = 0
        self.notes: tuple[str, ...] = ()

    @property
    def z(self) -> FloatArray:
        """The best point so far."""
        return np.array([self.at.get(p.name, 0.0) for p in self.problem.free])

    def after(self) -> tuple[Fit, Uncertainty]:
        """How well the outcome explains the recordings, and how uncertain it is."""
        evidence = self.problem.evidence(self.z, detail=True)
        return Fit.of(evidence), uncertainty(evidence, min(log.period for log in self.problem.logs))

    def _leave_out(self) -> bool:
        """Whether anything had to be left out."""
        reasons = unidentifiable(self.problem, self.problem.evidence(self.z, detail=True), self.still)
        if reasons:
            self.refused |= reasons
            self.problem = self.problem.restricted([p for p in self.problem.free if p.name not in reasons])
        return bool(reasons)


def filters(problem: Problem | ResponseProblem) -> dict[str, float]:
    """Half a sample for a filter that robot.yaml does not have: at zero it could not be told from a delay."""
    half = 0.5 * min(log.period for log in problem.logs)
    return {p.name: p.z(half) for p in problem.free if p.kind == "time_constant" and p.start < half}
