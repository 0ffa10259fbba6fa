"""Calibrate a robot from its own recordings."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, LinksideError, NumericalError
from linkside.files.yaml_source import suggest
from linkside.kalman.noise import Noise
from linkside.recording.log import Log
from linkside.recording.motion import moving
from linkside.robot import Robot

from .acceptance import foretell, objections
from .calibration import Calibration
from .equations import better
from .parameters import NOISE, Bounds, Parameter, choose
from .problem import Problem
from .recordings import refuse, use_torque
from .result import Estimated, Fit
from .search import GAIN, ROUGH, Progress, Search
from .starts import other_springs
from .uncertainty import Alone, Contradiction, Uncertainty, compare, uncertainty, unidentifiable

ROUNDS = 3
"""How often parameters that turn out not to be identifiable are left out and the rest is estimated anew."""


@contextmanager
def _in_our_words() -> Iterator[None]:
    """Let nothing out that is not ours."""
    try:
        yield
    except LinksideError:
        raise
    except np.linalg.LinAlgError as error:
        message = "calibration: the recordings do not tell the free parameters apart (a matrix is singular)"
        raise NumericalError(f"{message}; leave some out of free, or check the tolerances") from error
    except (ValueError, ArithmeticError) as error:
        raise EstimatorError(f"calibration: {error}") from error


@_in_our_words()
def calibrate(
    robot: Robot,
    logs: Log | Sequence[Log],
    free: Iterable[str] | None = None,
    *,
    noise: Noise | None = None,
    torque: bool | None = None,
    bounds: Bounds | None = None,
    held_out: Sequence[Log] = (),
    start: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Find a robot's parameters from its own recordings, without any external measurement.

    The posterior probability of the free parameters is maximised: the likelihood of what accelerometers (and motor
    torques) read, given the motors' positions, which the innovations of the Kalman filter on the acceleration-driven
    model give (Schweppe 1965), and a Gaussian prior around the values of robot.yaml whose widths are its
    ``tolerances``. Gradients are exact. Innovations beyond four standard
    deviations count linearly (Huber 1964), so that outliers have a bounded influence.

    Parameters
    ----------
    robot
        The robot as robot.yaml has it.
    logs
        One recording or several of the same robot, with motion in them.
    free
        Kinds of parameters such as ``"stiffness"``, or names such as ``"stiffness_axis2"``; by default
        `parameters.DEFAULT`. Those that the recordings cannot tell are left as they are, see `Calibration.refused`.
    noise
        How uncertain everything is; motors, sensors and torques also have a free factor on it by default.
    torque
        Whether motor torques are readings by the motor's equation of motion: needed for motor inertia, friction and
        coupling, and to tell stiffness from mass. By default only for a robot without accelerometers.
    bounds
        Least and largest value by name of a parameter.
    held_out
        Recordings that only test the outcome.
    start
        Where to start, by name, in tolerances: what a `Step` of an interrupted run held. By default robot.yaml, or
        where the equations of motion fit best if the recordings are more probable there.
    progress
        Called with a `Step` whenever a better point is found.

    Raises
    ------
    EstimatorError
        A name that is no parameter, bounds that contradict each other or robot.yaml, nothing to calibrate.
    LogError
        A recording without motion, with a saturated accelerometer, or of another robot.
    NumericalError
        The filter breaks down at the values of robot.yaml.
    """
    began = time.perf_counter()
    logs = [logs] if isinstance(logs, Log) else list(logs)
    refuse(robot, logs)
    torque = use_torque(robot, logs, torque)
    problem = Problem(robot, logs, noise or Noise(), torque, choose(robot, free, torque, bounds or {}))
    _refuse_unknown(problem, start or {})
    before = Fit.of(problem.evidence(np.zeros(len(problem.free)), detail=True))
    run = _Run(problem, dict(start or {}), progress)
    run.solve()
    after = run.problem.evidence(run.z, detail=True)
    foretold = foretell(run.problem, run.z) if len(run.problem.free) else None
    found = uncertainty(after, min(log.period for log in logs))
    return Calibration(
        estimates=_estimates(run.problem.free, run.z, found),
        refused=run.refused,
        before=before,
        after=Fit.of(after),
        held_out=_held_out(run.problem, run.z, held_out),
        contradictions=_contradictions(run.problem, run.z),
        foretold=foretold,
        objections=objections(run.problem.free, run.z, foretold),
        evaluations=run.evaluations,
        seconds=time.perf_counter() - began,
        problem=run.problem,
        z=run.z,
        uncertainty=found,
    )


def _refuse_unknown(problem: Problem, start: Mapping[str, float]) -> None:
    known = [parameter.name for parameter in problem.free]
    for name, z in start.items():
        if name not in known:
            raise EstimatorError(f"start: '{name}' is not a free parameter of this calibration; {suggest(name, known)}")
        if not np.isfinite(z):
            raise EstimatorError(f"start: '{name}' is {z}, expected a finite number")


class _Run:
    """Search, leave out what the recordings do not tell, search again."""

    def __init__(self, problem: Problem, start: dict[str, float], progress: Progress | None) -> None:
        self.problem, self.progress = problem, progress
        self.at = self._filters(problem) | start if start else better(problem, self._filters(problem))
        self.refused: dict[str, str] = {}
        self.evaluations = 0
        moves = np.any([moving(log) for log in problem.logs], axis=0)
        self.still = [name for name, does in zip(problem.robot.names, moves, strict=True) if not does]

    @staticmethod
    def _filters(problem: Problem) -> dict[str, float]:
        """Half a sample for a filter that robot.yaml does not have: at zero it could not be told from a delay."""
        half = 0.5 * min(log.period for log in problem.logs)
        filters = [p for p in problem.free if p.kind == "time_constant" and p.start < half]
        return {p.name: p.z(half) for p in filters}

    @property
    def z(self) -> FloatArray:
        """The best point so far."""
        return np.array([self.at.get(p.name, 0.0) for p in self.problem.free])

    def solve(self) -> None:
        self._leave_out()
        self._search(ROUGH, [p for p in self.problem.free if p.kind in NOISE])
        self.at = other_springs(self.problem, self.at)
        self._search(ROUGH, self.problem.free)
        self.at = other_springs(self.problem, self.at)
        self._leave_out()
        for _ in range(ROUNDS):
            self._search(GAIN, self.problem.free)
            if not self._leave_out():
                return

    def _search(self, gain: float, free: Sequence[Parameter]) -> None:
        """Improve the parameters ``free``; the others stay where they are."""
        search = Search(self.problem.holding(self.at, free), self.progress, gain)
        found = search.maximise(np.array([self.at.get(p.name, 0.0) for p in free]))
        self.evaluations += search.evaluations
        self.at |= dict(zip([p.name for p in free], found.tolist(), strict=True))

    def _leave_out(self) -> bool:
        """Whether anything had to be left out."""
        reasons = unidentifiable(self.problem, self.problem.evidence(self.z, detail=True), self.still)
        if reasons:
            self.refused |= reasons
            self.problem = self.problem.restricted([p for p in self.problem.free if p.name not in reasons])
        return bool(reasons)


def _estimates(free: Sequence[Parameter], z: FloatArray, found: Uncertainty) -> tuple[Estimated, ...]:
    rows = zip(free, z.tolist(), found.std.tolist(), found.widening.tolist(), strict=True)
    return tuple(Estimated(p, p.value(x), std * p.slope(x), wide, p.exceeds(x)) for p, x, std, wide in rows)


def _held_out(problem: Problem, z: FloatArray, logs: Sequence[Log]) -> tuple[float, float] | None:
    if not logs:
        return None
    refuse(problem.robot, logs)
    test = problem.on(logs)
    return test.log_likelihood(np.zeros(len(z))), test.log_likelihood(z)


def _contradictions(problem: Problem, z: FloatArray) -> tuple[Contradiction, ...]:
    """Estimate by each recording alone, from the joint estimate on."""
    if len(problem.logs) < 2:
        return ()
    fits = []
    for log in problem.logs:
        alone = problem.on([log])
        best = Search(alone).maximise(z)
        evidence = alone.evidence(best, detail=True)
        still = [name for name, does in zip(problem.robot.names, moving(log), strict=True) if not does]
        fits.append(Alone(best, uncertainty(evidence, log.period), frozenset(unidentifiable(alone, evidence, still))))
    return tuple(compare(problem, fits))
