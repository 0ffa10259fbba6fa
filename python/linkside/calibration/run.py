"""What a calibration run has whatever its objective: where it is, and what it leaves out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import NumericalError

from .parameters import Parameter
from .problem import Evidence
from .response import ResponseProblem
from .result import Fit
from .search import ROUGH, Progress, Search
from .uncertainty import EXCITATION, IDENTIFIABLE, Uncertainty, uncertainty, unidentifiable

DOUBTFUL = 0.15
"""A stiffness with a larger standard error, in tolerances, is tried at robot.yaml's value."""


class CalibrationRun:
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
        self, problem: ResponseProblem, still: Sequence[str], at: Mapping[str, float], progress: Progress | None
    ) -> None:
        self.problem: ResponseProblem = problem
        self.still, self.at, self.progress = still, dict(at), progress
        self.refused: dict[str, str] = {}
        self.considered: list[Parameter] = []
        self.flat: dict[str, float] = {}
        self._seen: tuple[tuple[ResponseProblem, list[float]], Evidence] | None = None
        self.evaluations = 0
        self.notes: tuple[str, ...] = ()

    @property
    def z(self) -> FloatArray:
        """The best point so far."""
        return self._at(self.problem.free)

    def after(self) -> tuple[Fit, Uncertainty]:
        """How well the outcome explains the recordings, and how uncertain it is."""
        found = self._spread(self._shifts()).of(len(self.problem.free))
        floor = np.array([self.flat.get(p.name, 0.0) for p in self.problem.free])
        return Fit.of(self.problem.evidence(self.z, detail=True)), found.at_least(floor)

    def _with_considered(self) -> Evidence:
        """What the recordings say where that of which they tell nothing is uncertain, too; it comes last."""
        free = (*self.problem.free, *self.considered)
        at = (self.problem, self._at(free).tolist())
        if self._seen is None or self._seen[0] != at:
            self._seen = (at, self.problem.restricted(free).evidence(self._at(free), detail=True))
        return self._seen[1]

    def _spread(self, shifts: FloatArray | None = None) -> Uncertainty:
        """The same, how far to trust what is free, and then that; ``shifts`` as of `uncertainty`."""
        return uncertainty(self._with_considered(), min(log.period for log in self.problem.logs), shifts)

    def unit(self, free: Sequence[Parameter]) -> FloatArray:
        """What ``free`` change with the mass that all else is measured by, in tolerances, (p,)."""
        return np.zeros(len(free))

    def _shifts(self) -> FloatArray | None:
        """What errors that residuals do not show make of estimates, in the same order, (p, k)."""
        return None

    def _at(self, free: Sequence[Parameter]) -> FloatArray:
        return np.array([self.at.get(p.name, 0.0) for p in free])

    def _leave_out(self) -> bool:
        """Whether anything had to be left out."""
        free = (*self.problem.free, *self.considered)
        known = frozenset(p.name for p in self.considered)
        untold = unidentifiable(free, self._at(free), self._with_considered(), self.still, known)
        self._refuse(untold.reasons, untold.considered)
        return bool(untold.reasons)

    def _refuse(self, reasons: Mapping[str, str], considered: frozenset[str]) -> None:
        """Leave parameters as robot.yaml has them; those ``considered`` are taken as uncertain."""
        self.refused |= reasons
        self.considered = [p for p in (*self.problem.free, *self.considered) if p.name in considered]
        self.problem = self.problem.restricted([p for p in self.problem.free if p.name not in reasons])
        for name in reasons:
            self.at.pop(name, None)

    def _leave_out_flat(self) -> bool:
        """Whether a spring had to be left out: recordings are nearly as probable with robot.yaml's stiffness."""
        spread = self._spread()
        doubtful = [
            (p, float(self.at[p.name]))
            for p, std in zip(self.problem.free, spread.std, strict=False)
            if p.kind == "stiffness" and std > DOUBTFUL and abs(self.at[p.name]) > std
        ]
        best = self.problem.log_likelihood(self.z) - 0.5 * float(self.z @ self.z)
        self.flat = {p.name: self._secant(p, z, best) for p, z in doubtful}
        worst = max(self.flat, key=lambda name: self.flat[name], default=None)
        if worst is None or self.flat[worst] < IDENTIFIABLE:
            return False
        reason = "the recordings are nearly as probable with robot.yaml's value; they lack " + EXCITATION["stiffness"]
        self._refuse({worst: reason}, frozenset({worst, *(p.name for p in self.considered)}))
        return True

    def _secant(self, p: Parameter, z: float, best: float) -> float:
        """Standard error by what it costs to go back to robot.yaml, all others following.

        Far from robot.yaml the likelihood may be flat on the way although it is curved at its top: how much a spring
        does grows with its compliance.
        """
        others = [other for other in self.problem.free if other is not p]
        held = self.problem.holding({p.name: 0.0}, others)
        search = Search(held, gain=ROUGH)
        try:
            there = search.maximise(self._at(others))
            back = held.log_likelihood(there) - 0.5 * float(there @ there)
        except NumericalError:  # links fly away: robot.yaml's value is out of the question
            return 0.0
        self.evaluations += search.evaluations
        return float(1 / np.sqrt(1 + 2 * max(0.0, best - back + 0.5 * z * z) / z**2))


def filters(problem: ResponseProblem) -> dict[str, float]:
    """Half a sample for a filter that robot.yaml does not have: at zero it could not be distinguished from a delay."""
    half = 0.5 * min(log.period for log in problem.logs)
    return {p.name: p.z(half) for p in problem.free if p.kind.endswith("time_constant") and p.start < half}
