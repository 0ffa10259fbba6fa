"""Calibration with motor torques: the likelihood of all readings, given the motors', by a Kalman filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from linkside.recording.log import Log

from .acceptance import Foretold, foretell
from .equations import better
from .parameters import NOISE, Parameter
from .problem import Problem
from .result import Fit
from .run import CalibrationRun, filters
from .search import GAIN, ROUGH, Progress, Search
from .starts import other_springs

ROUNDS = 3
"""How many rounds of leaving out unidentifiable parameters and estimating the others again."""


class FilterRun(CalibrationRun[Problem]):
    """Search, leave out parameters that are not identifiable, search again.

    Parameters
    ----------
    problem, still, progress
        As of `CalibrationRun`.
    start
        Where to begin, z by name; robot.yaml, or where the equations of motion fit better, where empty.
    """

    def __init__(
        self, problem: Problem, still: Sequence[str], start: Mapping[str, float], progress: Progress | None
    ) -> None:
        at = filters(problem) | dict(start) if start else better(problem, filters(problem))
        super().__init__(problem, still, at, progress)
        self.before = Fit.of(problem.evidence(np.zeros(len(problem.free)), detail=True))

    def solve(self) -> None:
        """Fit noise levels first, then springs, then all: a value that is held wrong distorts the others."""
        self._search(ROUGH, self._of(NOISE))
        self.at = other_springs(self.problem, self.at)
        self._search(ROUGH, self._of((*NOISE, "stiffness", "bias")))
        self._leave_out()
        self._search(ROUGH, self.problem.free)
        self.at = other_springs(self.problem, self.at)
        self._leave_out()
        for _ in range(ROUNDS):
            self._search(GAIN, self.problem.free)
            if not self._leave_out():
                return

    def foretold(self) -> Foretold:
        """How well the outcome predicts readings, compared with robot.yaml with fitted noise levels."""
        noise = self._of(NOISE)
        levels = iter(Search(self.problem.holding({}, noise), gain=ROUGH).maximise(np.zeros(len(noise))))
        nominal = np.array([float(next(levels)) if p.kind in NOISE else 0.0 for p in self.problem.free])
        return foretell(self.problem, self.problem.evidence(nominal, detail=True).densities, self.z)

    def held_out(self, logs: Sequence[Log]) -> tuple[float, float]:
        """Log-likelihood of other recordings, before and after."""
        test = self.problem.on(logs)
        return test.log_likelihood(np.zeros(len(self.z))), test.log_likelihood(self.z)

    def _of(self, kinds: Sequence[str]) -> list[Parameter]:
        return [p for p in self.problem.free if p.kind in kinds]

    def _search(self, gain: float, free: Sequence[Parameter]) -> None:
        """Improve the parameters ``free``; the others stay where they are."""
        search = Search(self.problem.holding(self.at, free), self.progress, gain)
        found = search.maximise(np.array([self.at.get(p.name, 0.0) for p in free]))
        self.evaluations += search.evaluations
        self.at |= dict(zip([p.name for p in free], found.tolist(), strict=True))
