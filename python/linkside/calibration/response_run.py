"""Calibration by the links' response to their motors: from slow motion to fast, from several starts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import NumericalError
from linkside.recording.log import Log

from .acceptance import Foretold, foretell, predictive
from .change import Change, change
from .parameters import NOISE, TORQUE_ONLY, Parameter, by_unit
from .prepared import recordings
from .problem import OF_SENSORS
from .response import ResponseProblem
from .result import Fit
from .run import CalibrationRun, filters
from .search import GAIN, ROUGH, Progress, Search
from .uncertainty import EXCITATION, uncertainty

CORNERS = (5.0, 12.0, 50.0)
"""Bands that are searched in turn [Hz], before the whole band: in lower bands a search converges from further away."""

ROUNDS = 3
"""How often, in each band, noise levels are updated from the residuals and unidentifiable parameters are left out."""

SETTLED = 0.02
"""A round that changes no parameter by more than this, in tolerances, is a band's last."""

FACTORS = (1 / 3, 3.0)
"""Of all springs, other starts."""

FIRST = ("stiffness", "damping", "bias")
"""Kinds that the way is found with; what makes up for these, such as a load, comes later."""

OF_SPRINGS = ("stiffness", "cubic_stiffness", "damping")
"""Kinds that one sensor alone must find as the others do."""

OF_LINKS = tuple(kind for kind in OF_SENSORS if kind not in TORQUE_ONLY)
"""Kinds of sensors alone."""

AGAIN = 8
"""How often motors' encoders are drawn again."""

WIDER = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8)
"""Factors that are tried on the corner frequencies by which motors' positions are smoothed."""

APART = 1.0
"""Springs that differ by more than this, in tolerances, are another outcome."""


class ResponseRun(CalibrationRun):
    """Search in one band after the other, leave out parameters that are not identifiable, search again.

    Parameters
    ----------
    problem, still, progress
        As of `CalibrationRun`.
    start
        Where to begin, z by name; robot.yaml, and springs far from it, where empty.
    """

    def __init__(
        self, problem: ResponseProblem, still: Sequence[str], start: Mapping[str, float], progress: Progress | None
    ) -> None:
        told = problem.restricted([p for p in problem.free if p.kind not in NOISE])
        super().__init__(told, still, filters(problem) | dict(start), progress)
        self.resumed = bool(start)
        self.change: Change | None = None
        self.noise = [p for p in problem.free if p.kind in NOISE]
        nominal = np.zeros(len(told.free))
        self.before = Fit.of(told.settled(nominal).evidence(nominal, detail=True))

    def solve(self) -> None:
        """Search low bands from several starts, then all bands, and leave out unidentifiable parameters."""
        everything = self.problem.free
        if not self.resumed:
            self.problem = self.problem.restricted([p for p in everything if p.kind in FIRST])
            self._begin()
            self._climb(CORNERS[2], ROUGH)
        self.problem = self.problem.restricted(everything)
        self._climb(CORNERS[2], ROUGH)
        self._smooth()
        self._climb(np.inf, ROUGH)
        self._leave_out()
        while True:
            self._climb(np.inf, GAIN)
            if not (self._leave_out() or self._leave_out_flat() or self._leave_out_chance()):
                break
        self._judge_noise()

    def _leave_out_chance(self) -> bool:
        """Whether drives had to be left as they are: what they change in the tool's path may be chance."""
        drives = [p.name for p in self.problem.free if p.kind not in OF_SENSORS]
        if not drives:
            return False
        free = (*self.problem.free, *self.considered)
        self.change = change(self.problem.restricted(free), self._at(free), self._spread().covariance)
        if self.change.told:
            return False
        unit = "rad" if self.problem.robot.tool is None else "m"
        reason = (
            f"what it and others change in the path, {self.change.moved:.2g} {unit}, is not far more than what stays "
            f"uncertain, {self.change.uncertain:.2g} {unit}; they lack {EXCITATION['stiffness']}"
        )
        self._refuse(dict.fromkeys(drives, reason), frozenset({*drives, *(p.name for p in self.considered)}))
        return True

    def foretold(self) -> Foretold:
        """How well the outcome predicts readings, compared with robot.yaml with its sensors and motors fitted.

        If nothing else was found, what the motors need is what is judged.
        """
        kept = OF_SENSORS if any(p.kind not in OF_SENSORS for p in self.problem.free) else OF_LINKS
        free = [p for p in self.problem.free if p.kind in kept and p.kind not in NOISE]
        held = self.problem.holding({}, free).settled(np.zeros(len(free)))
        at = dict(zip([p.name for p in free], Search(held, gain=ROUGH).maximise(np.zeros(len(free))), strict=True))
        nominal = np.array([at.get(p.name, 0.0) for p in self.problem.free])
        settled = self.problem.settled(nominal)
        found = foretell(self.problem, settled.evidence(nominal, detail=True).densities, self.z)
        return replace(found, sensors=self._by_others(settled, nominal))

    def _by_others(self, settled: ResponseProblem, nominal: FloatArray) -> dict[str, float]:
        """Log-density that each sensor's readings gain by springs as the others tell them, all else kept."""
        sensors = self.problem.sensors()
        drives = [p for p in self.problem.free if p.kind in OF_SPRINGS]
        if len(sensors) < 2 or not drives:
            return {}
        period = min(log.period for log in self.problem.logs)
        gains = {}
        for name, columns in sensors.items():
            rest = self.problem.reading([c for c in range(len(self.problem.channels)) if c not in columns])
            others = rest.holding(self.at, drives)
            told = Search(others, gain=ROUGH).maximise(self._at(drives))
            spread = uncertainty(others.evidence(told, detail=True), period).covariance
            after = predictive(self.problem.reading(columns).holding(self.at, drives), told, spread)
            gains[name] = after - settled.reading(columns).log_likelihood(nominal)
        return gains

    def held_out(self, logs: Sequence[Log]) -> tuple[float, float]:
        """Log-likelihood of other recordings, before and after; noise levels are fitted for both."""
        problem = self.problem
        test = ResponseProblem(
            problem.robot,
            recordings(problem.robot, logs, "tau" in problem.kinds),
            problem.free,
            base=problem.base,
            run=problem.run,
        )
        before, after = (test.settled(z).log_likelihood(z) for z in (np.zeros(len(self.z)), self.z))
        return before, after

    def _begin(self) -> None:
        """Keep the best outcome of all starts in the low bands; tell of others."""
        springs = [p for p in self.problem.free if p.kind == "stiffness"]
        starts = [self.at] + [self.at | {p.name: p.z(f * p.start) for p in springs} for f in FACTORS]
        found = []
        for start in starts:
            self.at = dict(start)
            try:
                for corner in CORNERS[:2]:
                    self._climb(corner, ROUGH)
            except NumericalError:
                continue
            found.append(self.at)
        if not found:
            raise NumericalError("the simulated links diverge with the values of robot.yaml; one of them is far off")
        self.at = found[0]
        common = self.problem.settled(self.z, CORNERS[1])
        worth = [self._posterior(common, at) for at in found]
        best = int(np.argmax(worth))
        self.at = found[best]
        self.notes = tuple(
            self._other(at, worth[best] - value)
            for at, value in zip(found, worth, strict=True)
            if springs and max(abs(at[p.name] - self.at[p.name]) for p in springs) > APART
        )

    def _posterior(self, problem: ResponseProblem, at: Mapping[str, float]) -> float:
        z = np.array([at.get(p.name, 0.0) for p in problem.free])
        return problem.log_likelihood(z) - 0.5 * float(z @ z)

    def _other(self, at: Mapping[str, float], less: float) -> str:
        springs = [p for p in self.problem.free if p.kind == "stiffness"]
        p = max(springs, key=lambda p: abs(at[p.name] - self.at[p.name]))
        return (
            f"from another start the search ends at {p.name} = {p.value(at[p.name]):.4g} {p.unit}; the recordings are "
            f"less probable there, by {less:.1f} in log-likelihood below {CORNERS[1]:g} Hz"
        )

    def _climb(self, corner: float, gain: float) -> None:
        """Search in one band, and again with noise as it then is."""
        for _ in range(ROUNDS):
            z = self.z
            self.problem = self.problem.settled(z, corner)
            search = Search(self.problem, self.progress, gain)
            found = search.maximise(z)
            self.evaluations += search.evaluations
            self.at |= dict(zip([p.name for p in self.problem.free], found.tolist(), strict=True))
            if not len(z) or np.abs(found - z).max() < SETTLED:
                return

    def _smooth(self) -> None:
        """Smooth motors' positions as it explains what the other sensors read best."""
        z = self.z
        tried = [self.problem.smoothed(wider).settled(z, np.inf) for wider in WIDER]
        self.problem = max(tried, key=lambda problem: problem.log_likelihood(z))

    def _shifts(self) -> FloatArray:
        """By errors of the motors' positions, and of the mass that all else is measured by.

        The former by a parametric bootstrap (B. Efron and R. J. Tibshirani 1993, chapter 6), a step of Gauss and
        Newton's method each: what they do to the residuals is large where links ring, lasts as long, and is no more
        independent of what a damping does there than one ringing is of another.
        """
        free = (*self.problem.free, *self.considered)
        z, problem, rng = self._at(free), self.problem.restricted(free), np.random.default_rng(0)
        drawn = [problem.measured_again(z, rng).evidence(z) for _ in range(AGAIN)]
        again = [_step(found.information, found.gradient) / np.sqrt(AGAIN) for found in drawn]
        return np.stack([*again, _step(self._with_considered().information, self.unit(free))], axis=1)

    def unit(self, free: Sequence[Parameter]) -> FloatArray:
        """What ``free`` change with the mass that all else is measured by, in tolerances, (p,)."""
        return by_unit(self.problem.robot, free, self._at(free))

    def _judge_noise(self) -> None:
        """Take sensors' noise from what is left."""
        self.problem = self.problem.settled(self.z)
        seen = [p for p in self.noise if p.kind == "sensor_noise"]
        self.at |= {p.name: p.z(self.problem.noise_of(p)) for p in seen}
        self.problem = self.problem.restricted([*self.problem.free, *seen])


def _step(information: FloatArray, gradient: FloatArray) -> FloatArray:
    """By how much a gradient moves the most probable parameters, with a prior of one."""
    return np.asarray(np.linalg.solve(information + np.eye(len(gradient)), gradient))
