"""Noise from recordings: the maximum of the filter's likelihood, widened where its errors are correlated in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, LogError
from linkside.kalman.noise import Noise
from linkside.recording.log import Log
from linkside.recording.motion import LEAST_MOTION, moving
from linkside.robot import Robot

from .noise_em import ExpectationMaximisation, HeldBack, NoiseFit, refuse, with_times
from .noise_search import NoiseSearch, Progress

SPAN = (1 / 3, 1e3)
"""How far from its start a value may go: an error that one recording did not excite is there all the same."""

Method = Literal["search", "em"]


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
    std : tuple of float or None
        With ``method="em"``, standard errors of the logarithms of the most likely values; None of a value at its bound
        or refused.
    refused : dict of str to str
        Likewise, names of values that the recordings do not tell and that are as before, with the reason.
    held_back : HeldBack or None
        Likewise, how much better readings are predicted that were not fitted to.
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
    std: tuple[float | None, ...] = ()
    refused: dict[str, str] = field(default_factory=dict)
    held_back: HeldBack | None = None

    @property
    def objections(self) -> tuple[str, ...]:
        """Reasons not to trust what ``method="em"`` found."""
        if not self.std:
            return ()
        if self.held_back is None:
            return ("the recordings tell none of the free values",)
        worse = f"it does not predict better than the noise before ({self.held_back})"
        return () if self.held_back.gain > 0 else (worse,)

    @property
    def accepted(self) -> bool:
        """Whether there is no objection."""
        return not self.objections

    def to_text(self) -> str:
        """Report before and after in words."""
        lines = [f"{'':24} {'before':>12} {'most likely':>12} {'after':>12}"]
        for name, start, value, factor in zip(self.names, self.start, self.values, self.widening, strict=True):
            edge = "  at its bound" if name in self.at_bound else self._interval(name, value / factor)
            lines.append(f"{name:24} {start:12.4g} {value / factor:12.4g} {value:12.4g}{edge}")
        likelihoods = self.log_likelihood_before, self.log_likelihood_most, self.log_likelihood_after
        lines.append(f"{'log-likelihood':24} " + " ".join(f"{x:12.1f}" for x in likelihoods))
        ratios = self.nis_before, self.nis_most, self.nis_after
        lines.append(f"{'NIS per reading':24} " + " ".join(f"{x:12.3f}" for x in ratios))
        if max(self.widening) > 1:
            lines.append("after: widened, because innovations are correlated in time, as errors of a model are")
        if self.held_back is not None:
            lines.append(str(self.held_back))
        lines += [f"not accepted: {objection}" for objection in self.objections]
        return "\n".join(lines) + "\n"

    def _interval(self, name: str, most_likely: float) -> str:
        """The 95 % interval of a most likely value, or why it is refused."""
        if name in self.refused:
            return f"  as before: {self.refused[name]}"
        std = self.std[self.names.index(name)] if self.std else None
        if std is None:
            return ""
        return f"  {most_likely * np.exp(-1.96 * std):.4g} to {most_likely * np.exp(1.96 * std):.4g}"


def tune(
    robot: Robot,
    logs: Log | Sequence[Log],
    noise: Noise | None = None,
    free: Sequence[str] = ("transmission",),
    progress: Progress | None = None,
    *,
    method: Method = "search",
    span: tuple[float, float] = SPAN,
    widen: bool = True,
    **settings: Any,
) -> Tuning:
    """Find the noise with which recordings are most likely, and increase it where errors are correlated in time.

    The first part maximises the log-likelihood of the filter's innovations, summed over the recordings, over the
    logarithms of the free values: by Powell's method within bounds, or by expectation and maximisation, which also
    gives standard errors, refuses what recordings do not tell, and predicts readings that it was not fitted to.

    A likelihood assumes that a reading's errors are independent from sample to sample. Errors of a wrong stiffness or
    mass last as long as a movement, so that n readings contain less information than n independent ones. The second
    part therefore multiplies the variance of a channel's readings by the long-run variance of its normalised
    innovations, the sum of their autocovariance over all lags (Newey and West 1987), where that exceeds 1. Under an
    exact model it does not, and nothing changes.

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
        for joints that move; ``acceleration`` and ``rate`` sensor by sensor if ``noise`` has them so. Freeing
        ``motor_bias`` or a walk of biases is seldom wise: the likelihood then explains a wrong stiffness by a drifting
        bias, and the position follows it.
    progress
        Called as ``progress(evaluations, best log-likelihood)`` after each evaluation.
    method
        ``"search"``, or ``"em"`` for expectation and maximisation. With the latter a walk of biases is found with their
        correlation time as before.
    span
        Smallest and largest factor on a value at the maximum of the likelihood.
    widen
        Whether to do the second part.
    **settings
        Of the `ExtendedKalmanFilter`, such as ``damping``.

    Raises
    ------
    EstimatorError
        A name that is no attribute of `Noise`, a value that is zero and so has no logarithm, settings out of range or
        not for the method.
    LogError
        A recording without motion, or one that the filter cannot use.
    """
    logs = [logs] if isinstance(logs, Log) else list(logs)
    _refuse(logs, free, span, settings)
    settings = {"tolerances": False, "link_disturbance": False} | settings  # noise is to explain what noise can
    if method == "em":
        return _tune_by_em(robot, logs, noise or Noise(), tuple(free), progress, span, widen, settings)
    if method != "search":
        raise EstimatorError(f"method is {method!r}, expected 'search' or 'em'")
    search = NoiseSearch(robot, logs, noise or Noise(), tuple(free), settings, progress)
    best = search.maximise(span)
    factors = search.widening(best) if widen else np.ones(len(best))
    return _result(search, best, factors, span)


def _tune_by_em(
    robot: Robot,
    logs: Sequence[Log],
    noise: Noise,
    free: tuple[str, ...],
    progress: Progress | None,
    span: tuple[float, float],
    widen: bool,
    settings: dict[str, Any],
) -> Tuning:
    refuse(settings)
    search = NoiseSearch(robot, logs, with_times(noise, free), free, settings, progress)
    fit = ExpectationMaximisation(search, span).fit()
    told = np.array([name not in fit.refused for name in search.names])
    factors = np.where(told, search.widening(fit.x), 1.0) if widen else np.ones(len(fit.x))
    return _result(search, fit.x, factors, span, fit)


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


def _result(
    search: NoiseSearch, x: FloatArray, factors: FloatArray, span: tuple[float, float], fit: NoiseFit | None = None
) -> Tuning:
    """Put together what was found."""
    points = [np.zeros(len(x)), x, x + np.log(factors)]
    (before, most, after) = (search.score(point) for point in points)
    edges = np.abs(x[:, None] - np.log(span)).min(axis=1) < 0.02
    return Tuning(
        *(search.before, search.noise(points[1]), search.noise(points[2])),
        *(before[0], most[0], after[0]),
        *(before[1], most[1], after[1]),
        evaluations=search.evaluations,
        names=search.names,
        start=tuple(search.start.tolist()),
        values=tuple((search.start * np.exp(points[2])).tolist()),
        widening=tuple(factors.tolist()),
        at_bound=tuple(name for name, edge in zip(search.names, edges, strict=True) if edge),
        std=() if fit is None else tuple(None if np.isnan(s) else s for s in fit.std.tolist()),
        refused={} if fit is None else fit.refused,
        held_back=None if fit is None else fit.held_back,
    )
