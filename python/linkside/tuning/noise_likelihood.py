"""Noise from recordings: the maximum of the filter's likelihood, widened where its errors are correlated in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.optimize

from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.channels import CHANNELS, widths
from linkside.errors import EstimatorError, LogError, NumericalError
from linkside.kalman.filtering import KalmanEstimate
from linkside.kalman.jerk_driven import ExtendedKalmanFilter
from linkside.kalman.noise import Noise, jerk_scale
from linkside.recording.log import Log
from linkside.recording.motion import LEAST_MOTION, moving
from linkside.robot import Robot
from linkside.statistics import long_run_variance

Progress = Callable[[int, float], None]


SPAN = (1 / 3, 1e3)
"""How far from its start a value may go: an error that one recording did not excite is there all the same."""

PER_JOINT = ("jerk", "transmission", "position_walk", "velocity_walk")
DESCRIBED = {channel.noise: kind for kind, channel in CHANNELS.items()} | {
    "torsion": "motor",
    "motor_velocity": "motor",
}
"""Kind of the channels whose readings a value of `Noise` describes; the others describe states."""

RESTARTS = 4
HOPELESS = 1e12


@dataclass(frozen=True)
class Tuning:
    """What tuning found.

    Attributes
    ----------
    before, most_likely, after : Noise
        At the start, at the maximum of the likelihood, and widened for correlation.
    log_likelihood_before, log_likelihood_most, log_likelihood_after : float
        Logarithm of the recordings' probability density under each.
    nis_before, nis_most, nis_after : float
        Normalised innovation squared per reading; 1 if innovations are as large as the filter expects.
    evaluations : int
        How often the recordings were filtered.
    names : tuple of str
        What was free, such as ``transmission_axis2``.
    start, values : tuple of float
        Its values before and after, in the same order.
    widening : tuple of float
        The factor of each value between the maximum of the likelihood and the end.
    at_bound : tuple of str
        Names whose most likely value is at the edge of what was allowed.
    """

    before: Noise
    most_likely: Noise
    after: Noise
    log_likelihood_before: float
    log_likelihood_most: float
    log_likelihood_after: float
    nis_before: float
    nis_most: float
    nis_after: float
    evaluations: int
    names: tuple[str, ...]
    start: tuple[float, ...]
    values: tuple[float, ...]
    widening: tuple[float, ...]
    at_bound: tuple[str, ...]

    def to_text(self) -> str:
        """Report before and after in words."""
        lines = [f"{'':24} {'before':>12} {'most likely':>12} {'after':>12}"]
        for name, start, value, factor in zip(self.names, self.start, self.values, self.widening, strict=True):
            edge = "  at its bound" if name in self.at_bound else ""
            lines.append(f"{name:24} {start:12.4g} {value / factor:12.4g} {value:12.4g}{edge}")
        likelihoods = self.log_likelihood_before, self.log_likelihood_most, self.log_likelihood_after
        lines.append(f"{'log-likelihood':24} " + " ".join(f"{x:12.1f}" for x in likelihoods))
        ratios = self.nis_before, self.nis_most, self.nis_after
        lines.append(f"{'NIS per reading':24} " + " ".join(f"{x:12.3f}" for x in ratios))
        if max(self.widening) > 1:
            lines.append("after: widened, because innovations are correlated in time, as errors of a model are")
        return "\n".join(lines) + "\n"


def tune(
    robot: Robot,
    logs: Log | Sequence[Log],
    noise: Noise | None = None,
    free: Sequence[str] = ("transmission",),
    progress: Progress | None = None,
    *,
    span: tuple[float, float] = SPAN,
    widen: bool = True,
    **settings: Any,
) -> Tuning:
    """Find the noise with which recordings are most likely, and increase it where errors are correlated in time.

    The first part maximises the log-likelihood of the filter's innovations, summed over the recordings, over the
    logarithms of the free values (Powell's method within bounds). A likelihood assumes that a reading's errors are
    independent from sample to sample. Errors of a wrong stiffness or mass last as long as a movement, so that n
    readings contain less information than n independent ones. The second part therefore multiplies the variance of a
    channel's readings by the long-run variance of its normalised innovations, the sum of their autocovariance over all
    lags (Newey and West 1987), where that exceeds 1. Under an exact model it does not, and nothing changes.

    Parameters
    ----------
    robot
        The robot.
    logs
        One recording or several, with motion in them.
    noise
        Where to start, and the values that are not free. Unless free, the scale of jerk is estimated from each log.
    free
        Attributes of `Noise`. ``transmission``, ``jerk`` and the links' walks are found joint by joint, the first only
        for joints that move. Freeing ``motor_bias`` or a walk of biases is seldom wise: the likelihood then explains a
        wrong stiffness by a drifting bias, and the position follows it.
    progress
        Called as ``progress(evaluations, best log-likelihood)`` after each evaluation.
    span
        Smallest and largest factor on a value at the maximum of the likelihood.
    widen
        Whether to do the second part.
    **settings
        Of the `ExtendedKalmanFilter`, such as ``damping``.

    Raises
    ------
    EstimatorError
        A name that is no attribute of `Noise`, a value that is zero and so has no logarithm, settings out of range.
    LogError
        A recording without motion, or one that the filter cannot use.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    _refuse(logs, free, span, settings)
    settings = {"tolerances": False, "link_disturbance": False} | settings  # noise is to explain what noise can
    search = _NoiseSearch(robot, logs, noise or Noise(), tuple(free), settings, progress)
    best = search.maximise(span)
    factors = search.widening(best) if widen else np.ones(len(best))
    return search.result(best, factors, span)


def _refuse(logs: Sequence[Log], free: Sequence[str], span: tuple[float, float], settings: dict[str, Any]) -> None:
    if not logs:
        raise EstimatorError("there is no log to tune with")
    if not free or isinstance(free, str):
        raise EstimatorError(f"free is {free!r}, expected a sequence of attributes of Noise")
    for name in free:
        if name not in Noise.model_fields:
            raise EstimatorError(f"free: {name!r} is not one of {', '.join(Noise.model_fields)}")
    if not 0 < span[0] <= 1 < span[1] < np.inf:
        raise EstimatorError(f"span is {span}, expected a factor of at most 1 and one above 1")
    if settings.get("gate") is not None:
        raise EstimatorError("gate: a likelihood must not choose its readings; tune without")
    for log in logs:
        if not moving(log).any():
            raise LogError(f"{log.source}: no motor moves by more than {LEAST_MOTION} rad: nothing to tune noise with")


@dataclass
class _NoiseSearch:
    """The free values as a vector: logarithms of the factor on each one's start."""

    robot: Robot
    logs: Sequence[Log]
    before: Noise
    free: tuple[str, ...]
    settings: dict[str, Any]
    progress: Progress | None
    evaluations: int = 0
    best: float = -np.inf
    best_at: FloatArray = field(init=False)
    entries: list[tuple[str, int | None]] = field(init=False)
    base: Noise = field(init=False)
    start: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Lay out the vector."""
        self.base = self._with_arrays()
        joints = np.any([moving(log) for log in self.logs], axis=0)
        self.entries = [(name, joint) for name in self.free for joint in self._joints(name, joints)]
        values = [getattr(self.base, name) for name, _ in self.entries]
        pairs = zip(values, self.entries, strict=True)
        self.start = np.array([value if joint is None else value[joint] for value, (_, joint) in pairs])
        for (name, _), value in zip(self.entries, self.start, strict=True):
            if value <= 0:
                raise EstimatorError(f"free: {name} starts at {value:g}; give it a value above 0 to vary")
        self._jerks = [self.base.for_log(log, self.robot).jerk for log in self.logs]

    def _with_arrays(self) -> Noise:
        """The start, with an entry a joint of what is free joint by joint; jerk is the largest of the logs'."""
        noise = self.before
        if "jerk" in self.free and noise.jerk is None:
            noise = noise.updated(jerk=tuple(np.max([jerk_scale(log) for log in self.logs], axis=0)))
        chosen = [name for name in PER_JOINT if name in self.free]
        return noise.updated(**{n: tuple(per_joint(n, getattr(noise, n), self.robot.n)) for n in chosen})

    def _joints(self, name: str, moving: npt.NDArray[np.bool_]) -> list[int | None]:
        if name not in PER_JOINT:
            return [None]
        return [joint for joint in range(self.robot.n) if name != "transmission" or moving[joint]]

    def noise(self, x: FloatArray) -> Noise:
        """The noise at a vector."""
        changes: dict[str, Any] = {}
        for (name, joint), value in zip(self.entries, self.start * np.exp(x), strict=True):
            if joint is None:
                changes[name] = float(value)
            else:
                changes.setdefault(name, list(getattr(self.base, name)))[joint] = float(value)
        return self.base.updated(**changes)

    def run(self, x: FloatArray, innovations: bool = False) -> list[KalmanEstimate]:
        """Filter every log, one after the other."""
        noise = self.noise(x)
        jerks = [noise.jerk] * len(self.logs) if "jerk" in self.free else self._jerks
        filters = [ExtendedKalmanFilter(self.robot, noise.updated(jerk=j), **self.settings) for j in jerks]
        return [f.run(log, innovations=innovations) for f, log in zip(filters, self.logs, strict=True)]

    def cost(self, x: FloatArray) -> float:
        """Minus the log-likelihood."""
        try:
            value = _total(self.run(x), "log_likelihood")
        except NumericalError:  # this far out the filter diverges
            value = -HOPELESS
        self.evaluations += 1
        if value > self.best:
            self.best, self.best_at = value, np.array(x)
        if self.progress is not None:
            self.progress(self.evaluations, self.best)
        return -value

    def maximise(self, span: tuple[float, float]) -> FloatArray:
        """Look for one factor for all values first, then for each its own."""
        low, high = np.log(span)
        ones = np.ones(len(self.start))

        def together(y: float) -> float:
            return self.cost(y * ones)

        options = {"xatol": 0.05}
        scipy.optimize.minimize_scalar(together, bounds=(low, high), method="bounded", options=options)
        self.cost(0 * ones)
        self._descend((low, high))
        return self.best_at

    def _descend(self, bounds: tuple[float, float]) -> None:
        """Powell's method, restarted at the best point until that gains little, because valleys are narrow."""
        options = {"xtol": 1e-2, "ftol": 1e-9}
        for _ in range(RESTARTS):
            reached = self.best
            scipy.optimize.minimize(
                self.cost, self.best_at, method="Powell", bounds=[bounds] * len(self.start), options=options
            )
            if not self.best - reached > 0.1:
                return

    def widening(self, x: FloatArray) -> FloatArray:
        """The factor on each value that describes readings: the root of its channels' long-run variance, at least 1."""
        by_kind = self._long_run_variances(x)
        factors = np.ones(len(x))
        for index, (name, joint) in enumerate(self.entries):
            variances = by_kind.get(DESCRIBED.get(name, ""))
            if variances is not None:
                factors[index] = np.sqrt(max(1.0, float(np.mean(variances) if joint is None else variances[joint])))
        return factors

    def _long_run_variances(self, x: FloatArray) -> dict[str, FloatArray]:
        """Of each channel's normalised innovations by kind, the mean over the logs that have it."""
        found: dict[str, list[FloatArray]] = {}
        for log, estimate in zip(self.logs, self.run(x, innovations=True), strict=True):
            kinds = ExtendedKalmanFilter(self.robot, **self.settings).kinds(log)
            assert estimate.innovation is not None
            assert estimate.innovation_std is not None
            normalised = estimate.innovation / estimate.innovation_std
            ends = np.cumsum(widths(self.robot, kinds))
            for kind, part in zip(kinds, np.split(normalised, ends[:-1], axis=1), strict=True):
                found.setdefault(kind, []).append(np.array([long_run_variance(channel) for channel in part.T]))
        return {kind: np.mean(variances, axis=0) for kind, variances in found.items() if variances[0].size}

    def result(self, x: FloatArray, factors: FloatArray, span: tuple[float, float]) -> Tuning:
        """Put together what was found."""
        points = [np.zeros(len(x)), x, x + np.log(factors)]
        (before, most, after) = (self._score(point) for point in points)
        edges = np.abs(x[:, None] - np.log(span)).min(axis=1) < 0.02
        names = [name if joint is None else f"{name}_{self.robot.names[joint]}" for name, joint in self.entries]
        return Tuning(
            *(self.before, self.noise(points[1]), self.noise(points[2])),
            *(before[0], most[0], after[0]),
            *(before[1], most[1], after[1]),
            evaluations=self.evaluations,
            names=tuple(names),
            start=tuple(self.start.tolist()),
            values=tuple((self.start * np.exp(points[2])).tolist()),
            widening=tuple(factors.tolist()),
            at_bound=tuple(name for name, edge in zip(names, edges, strict=True) if edge),
        )

    def _score(self, x: FloatArray) -> tuple[float, float]:
        estimates = self.run(x)
        return _total(estimates, "log_likelihood"), _total(estimates, "nis") / _total(estimates, "used")


def _total(estimates: Sequence[KalmanEstimate], name: str) -> float:
    return float(sum(getattr(estimate, name).sum() for estimate in estimates))
