"""Poles and drives of an observer from recordings whose states are known: what can be had, and one choice of it.

De Luca, Schröder and Thümmel (2007) tuned their observer by multi-objective optimisation against measured states. Small
errors ask for fast poles, little noise for slow ones, and an error of the stiffness is not made good by either.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, LogError, NumericalError
from linkside.kalman.jerk_driven import RauchTungStriebelSmoother
from linkside.observability.result import Observability
from linkside.observers.acceleration import AccelerationObserver
from linkside.observers.tuning_file import DRIVE, START, ObserverTuning
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.recording.motion import LEAST_MOTION
from linkside.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, float], None]

OBJECTIVES = ("position", "velocity", "torsion", "noise")
BOUNDS = {"poles": (0.25, 4.0), "stiffness": (0.8, 1.25), "damping": (0.25, 4.0), "motor_inertia": (0.8, 1.25)}
"""Least and largest factor on each value."""

POPULATION = 40
HOPELESS = 1e6

DOUBLINGS = 24
"""Of the time over which noise is summed, from one sample: an hour at 4 kHz."""


@dataclass(frozen=True, eq=False)
class Front:
    """Tunings none of which is better than another in every respect.

    Attributes
    ----------
    points : tuple of ObserverTuning
        The front, from least to most noise.
    ratios : (P, 4)
        Errors of link position, velocity and torsion, and noise, of each point, in multiples of those at the start.
    recommended : int
        Which point is nearest to having the best of everything.
    at_start : (4,)
        Root-mean-square errors over moving joints [rad, rad/s, rad], and standard deviation of the velocity that the
        sensors' noise gives rise to [rad/s], at the start.
    evaluations : int
        How often the recordings were estimated.
    smoothed : bool
        Whether the states were smoothed, for want of measured ones.
    """

    points: tuple[ObserverTuning, ...]
    ratios: FloatArray
    recommended: int
    at_start: FloatArray
    evaluations: int
    smoothed: bool = False

    @property
    def best(self) -> ObserverTuning:
        """The recommended point."""
        return self.points[self.recommended]

    def to_text(self) -> str:
        """Report start and recommendation in words."""
        units = ("rad", "rad/s", "rad", "rad/s")
        lines = [f"{'':24} {'before':>12} {'after':>12}"]
        for name, unit, start, ratio in zip(
            OBJECTIVES, units, self.at_start, self.ratios[self.recommended], strict=True
        ):
            lines.append(f"{name + ' [' + unit + ']':24} {start:12.4g} {start * ratio:12.4g}")
        for key, values in self.best.model_dump(exclude_defaults=True).items():
            lines += [f"{f'{key}_{name}':24} {'':12} {value:12.4g}" for name, value in values.items()]
        lines.append(f"{len(self.points)} points on the front, after {self.evaluations} evaluations")
        if drives := [key for key in DRIVE if self.smoothed and getattr(self.best, key)]:
            what = " and ".join(drives)
            lines.append(
                f"{what} from smoothed states, which presume those of robot.yaml: give measured ones (--states)"
            )
        return "\n".join(lines) + "\n"

    def figure(self) -> Figure:
        """Draw the front: each error over noise, the recommended point and the start marked."""
        from .front_figure import front_figure

        found = self.best.model_dump(exclude_defaults=True)
        settings = ", ".join(f"{key}_{name} {value:.4g}" for key, own in found.items() for name, value in own.items())
        return front_figure(self.ratios, self.recommended, settings or "as before")


def tune_observer(
    robot: Robot,
    logs: Log | Sequence[Log],
    states: Estimate | Sequence[Estimate] | None = None,
    free: Sequence[str] = ("poles",),
    progress: Progress | None = None,
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    evaluations: int = 2000,
    seed: int = 0,
) -> Front:
    """Find poles, and within bounds drives, with which the observer comes closest to known states.

    There are four objectives: the errors of link position, link velocity and torsion, and the noise of the velocity.
    The front is found by NSGA-II (Deb et al. 2002, from pymoo), started at the smallest sum of all (Powell).

    Parameters
    ----------
    robot
        The robot.
    logs
        One recording or several, of one sampling rate, with motion.
    states
        Motion of the links in each, measured (``q_``, ``dq_`` and, if recorded, ``theta_<joint>``) or smoothed. By
        default the smoother's estimate, which assumes the springs of robot.yaml: to find a stiffness, give measured
        states.
    free
        ``poles``, ``stiffness``, ``damping``, ``motor_inertia``; for every elastic joint that moves.
    progress
        Called as ``progress(evaluations, best sum of ratios)`` after each evaluation.
    bounds
        Least and largest factor on each free value, by its name; `BOUNDS` where not given.
    evaluations
        About how often to estimate the recordings.
    seed
        Of the search's random numbers.

    Raises
    ------
    EstimatorError
        A name or bounds that cannot be used, poles that the sampling rate cannot hold, pymoo missing.
    LogError
        A recording in which no elastic joint moves, or with no states at its times.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    bounds = {**BOUNDS, **(bounds or {})}
    _refuse(logs, free, bounds)
    smoothed = states is None
    if states is None:
        states = RauchTungStriebelSmoother(robot).run(logs)
    states = [states] if isinstance(states, Estimate) else list(states)
    if len(states) != len(logs):
        raise EstimatorError(f"states: {len(states)} given, for {len(logs)} recordings")
    search = _FrontSearch(
        robot, logs, [_known(log, s) for log, s in zip(logs, states, strict=True)], tuple(free), progress
    )
    return replace(search.front(bounds, evaluations, seed), smoothed=smoothed)


def _refuse(logs: Sequence[Log], free: Sequence[str], bounds: Mapping[str, tuple[float, float]]) -> None:
    if not logs:
        raise EstimatorError("there is no log to tune with")
    for name in [*free, *bounds]:
        if name not in BOUNDS:
            raise EstimatorError(f"free: {name!r} is not one of {', '.join(BOUNDS)}")
    if not free or isinstance(free, str):
        raise EstimatorError(f"free is {free!r}, expected some of {', '.join(BOUNDS)}")
    for name, (low, high) in bounds.items():
        if not 0 < low < high < np.inf:
            raise EstimatorError(f"bounds: {name} is {low, high}, expected two rising factors above 0")


def _known(log: Log, states: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Positions, velocities and torsions at a log's times."""
    rows = np.searchsorted(states.t, log.t - 0.01 * log.period)
    there = rows < len(states.t)
    if not there.all() or np.abs(states.t[np.where(there, rows, 0)] - log.t).max() > 0.01 * log.period:
        raise LogError(f"{log.source}: its states have no row at some of its times")
    if states.dq is None:
        raise LogError(f"{log.source}: its states have no velocities, columns dq_<joint>")
    q, dq = states.q[rows], states.dq[rows]
    return q, dq, (log.theta if states.theta is None else states.theta[rows]) - q


@dataclass
class _FrontSearch:
    """Free values as a vector: logarithms of the factor on each one's start."""

    robot: Robot
    logs: list[Log]
    known: list[tuple[FloatArray, FloatArray, FloatArray]]
    free: tuple[str, ...]
    progress: Progress | None
    evaluations: int = 0
    best: float = np.inf
    entries: list[tuple[str, str, float]] = field(init=False)

    def __post_init__(self) -> None:
        """Lay out the vector, and measure the start."""
        theta = np.concatenate([log.theta - log.theta[:1] for log in self.logs])
        self.moving = self.robot.elastic & (np.nanmax(np.abs(theta), axis=0) > LEAST_MOTION)
        if not self.moving.any():
            sources = ", ".join(log.source for log in self.logs)
            raise LogError(
                f"{sources}: no elastic joint's motor moves by more than {LEAST_MOTION} rad: record a motion of "
                "those to be tuned"
            )
        drives = [drive for drive, moves in zip(self.robot.drives, self.moving, strict=True) if moves]
        starts = [(key, d.name, START if key == "poles" else getattr(d, key)) for key in self.free for d in drives]
        self.entries = [(key, name, start) for key, name, start in starts if start]
        postures = np.ascontiguousarray(np.nan_to_num(np.concatenate([log.theta for log in self.logs]))[::50])
        deviation = np.sqrt(np.median(Observability.of(self.robot, postures).joints ** 2, axis=0))
        self.acceleration_std = dict(zip(np.array(self.robot.names)[self.robot.elastic], deviation, strict=True))
        self.at_start = self.errors(self.tuning(np.zeros(len(self.entries))))

    def tuning(self, x: FloatArray) -> ObserverTuning:
        """The tuning at a vector; poles are always named."""
        names = [name for name, elastic in zip(self.robot.names, self.robot.elastic, strict=True) if elastic]
        values: dict[str, dict[str, float]] = {"poles": dict.fromkeys(names, START)}
        for (key, name, start), factor in zip(self.entries, np.exp(x), strict=True):
            values.setdefault(key, {})[name] = float(start * factor)
        return ObserverTuning.model_validate(values)

    def errors(self, tuning: ObserverTuning) -> FloatArray:
        """Mean squares by objective and moving joint, (4, joints)."""
        observer = tuning.observer(self.robot)
        squares, rows = np.zeros((3, int(self.moving.sum()))), 0
        for (q, dq, torsion), estimate in zip(self.known, observer.run(self.logs), strict=True):
            assert estimate.dq is not None
            assert estimate.theta is not None
            parts = estimate.q - q, estimate.dq - dq, estimate.theta - estimate.q - torsion
            squares += [np.nansum(part[:, self.moving] ** 2, axis=0) for part in parts]
            rows += len(estimate)
        return np.vstack([squares / rows, self._noise(observer)])

    def _noise(self, observer: AccelerationObserver) -> FloatArray:
        """Variance of each moving joint's velocity from encoder and accelerometer noise, by Lyapunov's equation.

        The error of a prediction, but for what the sample's own acceleration reading adds, goes over a period by
        Φ(1 − g C); C is the motor position.
        """
        period, encoder = self.logs[0].period, self.robot.config.encoder.resolution / np.sqrt(12)
        out = []
        for drive in (d for d, moves in zip(observer.robot.drives, self.moving, strict=True) if moves):
            joint, poles = self.robot.names.index(drive.name), observer.poles[drive.name]
            transition, held, ramp, gain = _core.sampled_observer(observer.robot.core, joint, poles, period)
            corrected = np.eye(len(gain)) - np.outer(gain, np.eye(len(gain))[0])
            std = self.acceleration_std[drive.name]
            # A reading counts twice, as an interval's end and as the next one's beginning.
            end, beginning = std * ramp[:, 1], std * (held[:, 1] - ramp[:, 1])
            inputs = np.stack([transition @ corrected @ end + beginning, encoder * transition @ gain], axis=1)
            before = _stationary(transition @ corrected, inputs @ inputs.T)
            now = corrected @ (before + np.outer(end, end)) @ corrected.T + encoder**2 * np.outer(gain, gain)
            out.append(now[3, 3])
        return np.array(out)

    def ratios(self, x: FloatArray) -> FloatArray:
        """Objectives in multiples of those at the start, root mean square over joints, (4,)."""
        try:
            value = np.sqrt(np.mean(self.errors(self.tuning(x)) / self.at_start, axis=1))
        except NumericalError:  # this far out the observer diverges
            value = np.full(len(OBJECTIVES), HOPELESS)
        self.evaluations += 1
        self.best = min(self.best, float(value.sum()))
        if self.progress is not None:
            self.progress(self.evaluations, self.best)
        return np.asarray(value)

    def front(self, bounds: Mapping[str, tuple[float, float]], evaluations: int, seed: int) -> Front:
        """Search, and choose."""
        low, high = np.log([bounds[key] for key, _, _ in self.entries]).T
        self.tuning(high).observer(self.robot, period=self.logs[0].period)  # poles too fast for the rate are refused
        seeds = self._seeds(low, high, max(evaluations // 3, 10))
        x, ratios = _pareto(self.ratios, seeds, low, high, evaluations - self.evaluations, seed)
        order = np.argsort(ratios[:, -1], kind="stable")
        x, ratios = x[order], ratios[order]
        spread = np.maximum(np.ptp(ratios, axis=0), 1e-12)
        distance = np.linalg.norm((ratios - ratios.min(axis=0)) / spread, axis=1)
        start = np.sqrt(self.at_start.mean(axis=1))
        points = tuple(self.tuning(point) for point in x)
        return Front(points, ratios, int(np.argmin(distance)), start, self.evaluations)

    def _seeds(self, low: FloatArray, high: FloatArray, evaluations: int) -> FloatArray:
        """The start, and the least sum of all objectives."""
        from scipy.optimize import minimize

        start = np.clip(np.zeros(len(low)), low, high)
        options = {"maxfev": evaluations, "xtol": 1e-3, "ftol": 1e-4}
        bounds = list(zip(low, high, strict=True))
        least = minimize(lambda x: self.ratios(x).sum(), start, method="Powell", bounds=bounds, options=options)
        return np.array([start, np.clip(least.x, low, high)])


def _stationary(transition: FloatArray, noise: FloatArray) -> FloatArray:
    """P = A P Aᵀ + Q of a stable A, by doubling the span of the sum (R. A. Smith, SIAM J. Appl. Math. 16, 1968).

    States of such different size as θ and q̇ leave nothing of the digits of a linear system for P's entries.
    """
    for _ in range(DOUBLINGS):
        noise = noise + transition @ noise @ transition.T
        transition = transition @ transition
    return noise


def _pareto(
    objectives: Callable[[FloatArray], FloatArray],
    seeds: FloatArray,
    low: FloatArray,
    high: FloatArray,
    evaluations: int,
    seed: int,
) -> tuple[FloatArray, FloatArray]:
    """Points of a Pareto front and their objectives, by NSGA-II."""
    try:
        from pymoo.algorithms.moo.nsga2 import NSGA2
        from pymoo.core.problem import ElementwiseProblem
        from pymoo.optimize import minimize
    except ImportError:
        raise EstimatorError("tuning an observer needs pymoo: pip install 'linkside[tune]'") from None

    class PoleProblem(ElementwiseProblem):  # type: ignore[misc]  # pymoo has no types
        def _evaluate(self, x: FloatArray, out: dict[str, Any], *_: Any, **__: Any) -> None:
            out["F"] = objectives(x)

    rng = np.random.default_rng(seed)
    around = np.clip(seeds[1] + 0.1 * (high - low) * rng.standard_normal((POPULATION // 2, len(low))), low, high)
    anywhere = rng.uniform(low, high, (POPULATION - len(around) - len(seeds), len(low)))
    problem = PoleProblem(n_var=len(low), n_obj=len(OBJECTIVES), xl=low, xu=high)
    algorithm = NSGA2(pop_size=POPULATION, sampling=np.vstack([seeds, around, anywhere]))
    result = minimize(problem, algorithm, ("n_eval", max(evaluations, POPULATION)), seed=seed)
    return np.atleast_2d(result.X), np.atleast_2d(result.F)
