"""Noise by expectation and maximisation: closed steps, standard errors, and readings held back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.kalman.jerk_driven import ExtendedKalmanFilter
from linkside.kalman.noise import Noise
from linkside.kalman.starting import first_readings
from linkside.recording.estimate import result_of
from linkside.recording.log import Log
from linkside.statistics import long_run_variance

from .noise_search import NoiseSearch

STRETCHES = 12
"""A recording is cut into this many stretches, of which every other one is held back, then the rest."""

ROUGH, FINE = 1e-2, 1e-6
"""Steps end where the next one would add less than this to the log-likelihood."""

PASSES = 100
"""Steps, at most."""

CHANGES = (0.1, 7.0)
"""By what a step may multiply a variance, at least and at most."""

SHARES = (1.0, 0.5, 0.25)
"""Parts of a step of scoring that are tried in turn."""

LEAST = 1e-3
"""Information that a step of scoring takes a value to have, at least: it does not go far where there is none."""

SHARP = 0.2
"""A value with a smaller standard error, in logarithms, is told."""

SMALLER = np.log(3.0)
"""Others must be told from what is smaller by this."""

HARDLY = 1.92
"""Log-likelihood by which it is told: half of the 95th percentile of chi-square."""

INSTEAD = 0.2
"""A value that changes by more than this, in logarithms, where another is smaller stands in for that."""

RANDOM = ("reading", "jerk", "link_walk", "bias_walk", "torsion")
"""Arrays of `Noise.arrays` that say how random something is at each sample."""

Chosen = npt.NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class NoiseEvidence:
    """What recordings say of p values, in their logarithms.

    Attributes
    ----------
    log_likelihood : (k,)
        Of each of k stretches.
    score : (k, p)
        Derivatives of it.
    information : (k, p, p)
        Fisher's information.
    dimensions : (p,)
        Random numbers in the recordings whose standard deviation a value is.
    scores : list of (T, p)
        Each log's scores, sample by sample.
    """

    log_likelihood: FloatArray
    score: FloatArray
    information: FloatArray
    dimensions: FloatArray
    scores: list[FloatArray]


@dataclass(frozen=True)
class HeldBack:
    """How much better values predict readings that they were not fitted to.

    Attributes
    ----------
    gain : float
        Log-likelihood of all stretches, each by values fitted to others, over that with the values before.
    std : float
        Its standard error, by how it differs from stretch to stretch.
    """

    gain: float
    std: float

    def __str__(self) -> str:
        """Summarise in one line."""
        return f"readings held back: log-likelihood {self.gain:+.1f} ± {self.std:.1f}"


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """The most likely values.

    Attributes
    ----------
    x : (p,)
        Logarithms of the factors on the values before.
    std : (p,)
        Their standard errors; NaN of a value that is at its bound or not identifiable.
    refused : dict of str to str
        Values that are not identifiable and stay as they were, with the reason.
    held_back : HeldBack or None
        None: nothing is identifiable.
    """

    x: FloatArray
    std: FloatArray
    refused: dict[str, str]
    held_back: HeldBack | None


class ExpectationMaximisation:
    """Steps to the most likely noise of a search's recordings.

    The expected log-density of readings and random numbers together, given the readings, is largest where the variance
    of each source is the mean square of its own random numbers, given all readings (R. H. Shumway and D. S. Stoffer,
    J. Time Series Analysis 3, 1982). That step never lowers the likelihood, but is short where the noise of one sample
    is hardly seen. Fisher's scoring, with the information from the same pass, is therefore tried first (M. W. Watson
    and R. F. Engle, J. Econometrics 23, 1983).

    Where a log starts, and how long its biases last, stays as with the values before. Channels are linearised at the
    filter's own estimates; how these move with the noise does not count in derivatives.

    Parameters
    ----------
    search
        Recordings and free values.
    span
        Smallest and largest factor on a value.
    """

    def __init__(self, search: NoiseSearch, span: tuple[float, float]) -> None:
        self._search, (self._low, self._high) = search, np.log(span)
        self._start = search.noises(np.zeros(len(search.start)))

    def fit(self) -> NoiseFit:
        """Find the most likely values, what is not identifiable among them left out."""
        x = np.zeros(len(self._search.start))
        free, refused = np.ones(len(x), bool), dict[str, str]()
        while free.any():
            x, found = self._climb(x, free)
            worst = self._least_told(x, found, free)
            if worst is None:
                x, found = self._climb(x, free, gain=FINE)
                return NoiseFit(x, self._std(x, found, free), refused, self._hold_back(x, free))
            index, reason = worst
            refused[self._search.names[index]] = reason
            free[index], x[index] = False, 0.0
        return NoiseFit(x, np.full(len(x), np.nan), refused, None)

    def evidence(self, x: FloatArray) -> NoiseEvidence:
        """What all recordings say, by the derivatives of their filters."""
        logs = self._search.logs
        jobs = [self._job(*each) for each in zip(self._search.filters(x), logs, range(len(logs)), strict=True)]
        outcomes = _core.ExtendedKalmanFilter.noise_evidence(jobs)
        found = [result_of(log.source, one) for log, one in zip(logs, outcomes, strict=True)]
        self._search.note(x, float(sum(one["log_likelihood"].sum() for one in found)))

        def by_stretch(name: str) -> FloatArray:
            edges = [range(0, len(log), _stretch(log)) for log in logs]
            return np.concatenate([np.add.reduceat(one[name], at) for one, at in zip(found, edges, strict=True)])

        return NoiseEvidence(
            by_stretch("log_likelihood"),
            2 * by_stretch("scores"),  # derivatives by the logarithms of variances, twice those of deviations
            4 * np.concatenate([one["information"] for one in found]),
            np.asarray(sum(one["dimensions"].sum(axis=0) for one in found)),
            [2 * one["scores"] for one in found],
        )

    def step(self, found: NoiseEvidence) -> FloatArray:
        """A step of expectation and maximisation from where the evidence is, (p,).

        The mean square of a source's random numbers, given all readings, is by Fisher's identity its variance times
        1 + score / dimensions.
        """
        return _changed(found.score.sum(axis=0) / np.maximum(found.dimensions, 1.0))

    def _job(self, ekf: ExtendedKalmanFilter, log: Log, index: int) -> tuple[Any, Any, list[dict[str, Any]], int]:
        kinds = ekf.kinds(log)
        core = ekf.core(kinds, ekf.noise, log.period)
        ekf.begin(core, first_readings(log), kinds, self._start[index])
        return core, ekf.arrays(log, kinds), self._shares(ekf.noise, kinds), _stretch(log)

    def _shares(self, noise: Noise, kinds: tuple[str, ...]) -> list[dict[str, Any]]:
        """The noise of each entry alone: what twice its variance would add."""
        plain = _squares(noise, self._search, kinds)
        return [_alone(plain, _squares(noise.updated(**twice), self._search, kinds)) for twice in self._doubled(noise)]

    def _doubled(self, noise: Noise) -> list[dict[str, Any]]:
        changes = []
        for name, member in self._search.entries:
            values = np.array(getattr(noise, name), float)
            values[() if member is None else member] *= np.sqrt(2)
            changes.append({name: values.tolist() if member is None else tuple(values.tolist())})
        return changes

    def _climb(
        self, x: FloatArray, free: Chosen, chosen: Chosen | None = None, gain: float = ROUGH
    ) -> tuple[FloatArray, NoiseEvidence]:
        """Steps that each raise the likelihood of the ``chosen`` stretches, until one gains less than that."""
        found = self.evidence(x)
        for _ in range(PASSES):
            score, information = _of(found, chosen)
            moving = self._inside(x, score, free)
            scoring = np.zeros(len(x))
            within = np.ix_(moving, moving)
            scoring[moving] = np.linalg.solve(information[within] + LEAST * np.eye(moving.sum()), score[moving])
            if 0.5 * score @ scoring < gain:
                break
            steps = [*(_changed(2 * share * scoring) for share in SHARES), np.where(moving, self.step(found), 0.0)]
            better = self._better(x, found, steps, chosen)
            if better is None:
                break
            gained = _sum(better[1].log_likelihood, chosen) - _sum(found.log_likelihood, chosen)
            x, found = better
            if gained < gain:
                break
        return x, found

    def _better(
        self, x: FloatArray, found: NoiseEvidence, steps: Sequence[FloatArray], chosen: Chosen | None
    ) -> tuple[FloatArray, NoiseEvidence] | None:
        """The first of the steps that raises the likelihood."""
        for step in steps:
            there = np.clip(x + step, self._low, self._high)
            at = self.evidence(there)
            if _sum(at.log_likelihood, chosen) > _sum(found.log_likelihood, chosen):
                return there, at
        return None

    def _inside(self, x: FloatArray, score: FloatArray, free: Chosen) -> Chosen:
        """Free values, but for those that are at a bound and would be beyond."""
        return np.asarray(free & ~((x <= self._low) & (score < 0)) & ~((x >= self._high) & (score > 0)))

    def _least_told(self, x: FloatArray, found: NoiseEvidence, free: Chosen) -> tuple[int, str] | None:
        """The value that recordings tell least from its start and, but for bounds, from a third of it; and why."""
        for i in np.flatnonzero(free & (found.dimensions == 0)).tolist():
            return i, "after the first sample nothing in the recordings has it"
        within = np.flatnonzero(free)
        std = np.sqrt(np.diag(np.linalg.inv(_of(found)[1][np.ix_(within, within)] + np.eye(len(within)))))
        least, told = HARDLY, None
        for i in within[std > SHARP].tolist():
            others = [x[i] - SMALLER, 0.0] if self._low < x[i] < self._high else [0.0]
            loss, fitted = max((self._loss(x, found, free, i, other) for other in others), key=lambda each: each[0])
            if loss < least:
                least, told = loss, (i, self._reason(i, fitted - x))
        return told

    def _loss(
        self, x: FloatArray, found: NoiseEvidence, free: Chosen, index: int, other: float
    ) -> tuple[float, FloatArray]:
        """What log-likelihood is less where one value is another and the rest is fitted to that; and where that is."""
        chosen = np.arange(len(x)) == index
        fitted, at = self._climb(np.where(chosen, other, x), free & ~chosen)
        return float(_sum(found.log_likelihood) - _sum(at.log_likelihood)), fitted

    def _reason(self, index: int, changes: FloatArray) -> str:
        """Why a value is not told, others changing where it is smaller."""
        changes = np.where(np.arange(len(changes)) == index, 0.0, np.abs(changes))
        if changes.max() > INSTEAD:
            return f"it cannot be distinguished from {self._search.names[int(np.argmax(changes))]}"
        return "the recordings hardly depend on it"

    def _std(self, x: FloatArray, found: NoiseEvidence, free: Chosen) -> FloatArray:
        """Standard errors by the information, or larger where scores are correlated in time (H. White 1982)."""
        within = np.flatnonzero(free & (x > self._low) & (x < self._high))
        covariance = np.linalg.inv(_of(found)[1][np.ix_(within, within)])
        influences = [scores[:, within] @ covariance for scores in found.scores]
        robust = [sum(len(one) * long_run_variance(one[:, i]) for one in influences) for i in range(len(within))]
        std = np.full(len(x), np.nan)
        std[within] = np.sqrt(np.maximum(np.diag(covariance), robust))
        return std

    def _hold_back(self, x: FloatArray, free: Chosen) -> HeldBack:
        """Fit every other stretch of the recordings, and predict the rest; then the other way round."""
        before = self.evidence(np.zeros(len(x))).log_likelihood
        order = np.concatenate([np.arange(0, len(log), _stretch(log)) // _stretch(log) for log in self._search.logs])
        gains = []
        for fold in range(2):
            _, found = self._climb(x, free, order % 2 != fold)
            gains += (found.log_likelihood - before)[order % 2 == fold].tolist()
        return HeldBack(sum(gains), float(np.std(gains) * np.sqrt(len(gains))))


def with_times(noise: Noise, free: Sequence[str]) -> Noise:
    """The same with correlation times of their own for biases whose walk is free.

    Raises
    ------
    EstimatorError
        A walk without a bias.
    """
    times: dict[str, float] = {}
    for name in free:
        bias = name.removesuffix("_walk")
        if not name.endswith("_bias_walk") or getattr(noise, f"{bias}_time") is not None:
            continue
        if getattr(noise, bias) == 0:
            times[f"{bias}_time"] = np.inf
        elif getattr(noise, name) > 0:
            times[f"{bias}_time"] = 2 * (getattr(noise, bias) / getattr(noise, name)) ** 2
    return noise.updated(**times)


def refuse(settings: dict[str, Any]) -> None:
    """Refuse settings of a filter whose readings are not those of a linear model with Gaussian noise."""
    for name, plain in (("loss", "squares"), ("linearisation", "derivatives")):
        if settings.get(name, plain) != plain:
            raise EstimatorError(f"{name} is {settings[name]!r}, expected {plain!r} for method='em'")
    if settings.get("link_disturbance"):
        raise EstimatorError("link_disturbance is not for method='em'")


def _changed(changes: FloatArray) -> FloatArray:
    """Logarithms of the factors on values whose variances change by these shares of themselves.

    Likelihoods are nearly quadratic in variances, down to none of them, and are ridges where their sum is what is told.
    """
    return np.asarray(0.5 * np.log(np.clip(1 + changes, *CHANGES)))


def _stretch(log: Log) -> int:
    """Rows of a stretch."""
    return -(-len(log) // STRETCHES)


def _squares(noise: Noise, search: NoiseSearch, kinds: tuple[str, ...]) -> dict[str, FloatArray]:
    arrays = noise.arrays(search.robot, kinds)
    return {name: np.square(arrays[name]) for name in RANDOM} | {
        name: np.asarray(arrays[name]) for name in ("bias_time", "initial", "initial_bias")
    }


def _alone(plain: dict[str, FloatArray], more: dict[str, FloatArray]) -> dict[str, Any]:
    alone: dict[str, Any] = {name: np.sqrt(more[name] - plain[name]).tolist() for name in RANDOM}
    return alone | {name: plain[name].tolist() for name in ("bias_time", "initial", "initial_bias")}


def _sum(values: FloatArray, chosen: Chosen | None = None) -> Any:
    return (values if chosen is None else values[chosen]).sum(axis=0)


def _of(found: NoiseEvidence, chosen: Chosen | None = None) -> tuple[FloatArray, FloatArray]:
    """Score and information of the ``chosen`` stretches."""
    return _sum(found.score, chosen), _sum(found.information, chosen)
