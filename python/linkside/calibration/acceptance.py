"""Whether a calibration can be trusted: it must predict readings that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from linkside.arrays import FloatArray
from linkside.kalman.noise import Noise
from linkside.recording.log import Log
from linkside.robot import Robot

from .links import with_links
from .parameters import NOISE, OF_RESPONSE, Parameter
from .posterior import Posterior
from .problem import OF_SENSORS, Problem
from .search import ROUGH, Search

FOLDS = 2
"""Number of folds: each stretch of a recording is held back once."""

STRETCHES = 12
"""A recording is cut into this many stretches, which the folds take in turn."""

LOSS = -3.0
"""An outcome is refused if some sensor's readings are predicted less well than this, in log-likelihood."""

DEVIATIONS = 4
"""Steps of Gauss and Newton's method to the most probable deviation, at most."""

FAR = 3.0
"""An estimate further from robot.yaml than this, in tolerances, is not one that robot.yaml's tolerance allows for."""

HERE = 1e-3
"""An estimate at a bound where robot.yaml has it too, to within this part of its tolerance, is that of robot.yaml."""

WIDE = 1.96
"""So many standard errors an estimate may be nearer than it seems."""


@dataclass(frozen=True)
class Foretold:
    """How much better parameters predict readings that they were not fitted to.

    Attributes
    ----------
    gain : float
        Log-likelihood of all readings that were held back, over that with the values of robot.yaml; for both, the
        noise levels are fitted.
    std : float
        Its standard error, by how it differs from stretch to stretch.
    worst : float
        Gain of the worst stretch.
    sensors : dict of str to float
        Gain of each sensor's readings, predicted from the other sensors alone, as far as these tell the springs; empty
        if there is only one sensor.
    """

    gain: float
    std: float
    worst: float
    sensors: dict[str, float] = field(default_factory=dict)

    @property
    def better(self) -> bool:
        """Whether the readings are predicted better than by robot.yaml."""
        return self.gain > 0

    def __str__(self) -> str:
        """Summarise in one line."""
        each = ", ".join(f"{name} {gain:+.1f}" for name, gain in self.sensors.items())
        by_others = f"; each sensor by the others: {each}" if each else ""
        return f"readings held back: log-likelihood {self.gain:+.1f} ± {self.std:.1f}{by_others}"


def foretell(problem: Posterior, nominal: Sequence[FloatArray], z: FloatArray) -> Foretold:
    """Leave out one part of the readings after the other, fit the rest, and predict the part left out.

    What is held back are the readings of all sensors but the motors' encoders, in every other stretch of time
    (cross-validation, M. Stone, J. R. Stat. Soc. B 36, 1974).

    Parameters
    ----------
    problem
        What was solved.
    nominal : list of (T,)
        Each sample's part of the log-likelihood with the values of robot.yaml, noise levels fitted.
    z : (p,)
        Its outcome: where the fits begin.
    """
    gains: list[float] = []
    for fold in range(FOLDS):
        stretches = [_stretches(len(log), fold) for log in problem.logs]
        fitted = Search(problem.without(stretches), gain=ROUGH).maximise(z)
        found = problem.evidence(fitted, detail=True).densities
        for ours, theirs, parts in zip(found, nominal, stretches, strict=True):
            gains += [float(np.sum((ours - theirs)[part])) for part in parts]
    return Foretold(sum(gains), float(np.std(gains) * np.sqrt(len(gains))), min(gains))


def predictive(problem: Posterior, z: FloatArray, covariance: FloatArray) -> float:
    """Log-density of readings by parameters that are ``z`` to within ``covariance`` (p, p): Laplace's method.

    At the most probable deviation from ``z``, less what it is worth that readings could choose it (D. J. C. MacKay,
    Neural Computation 4, 1992).
    """
    precision = np.linalg.inv(covariance)
    away, best = np.zeros_like(z), -np.inf
    for _ in range(DEVIATIONS):
        found = problem.evidence(z + away)
        value = found.log_likelihood - 0.5 * float(away @ precision @ away)
        if value <= best:
            break
        chosen = np.linalg.slogdet(np.eye(len(z)) + covariance @ found.information)[1]
        best, density = value, value - 0.5 * float(chosen)
        curvature = precision + found.information
        away = np.asarray(np.linalg.solve(curvature, found.gradient + found.information @ away), np.float64)
    return density


def filters_gain(robot: Robot, logs: Sequence[Log], noise: Noise, free: Sequence[Parameter], z: FloatArray) -> float:
    """Log-likelihood that a Kalman filter's model of the links gains, with noise as filters assume it.

    That model shares nothing with the links' response but the robot: what explains the encoders' noise, and not the
    robot, is worse there. Sensors are as they were found in both cases.
    """
    theirs = [p for p in free if p.kind not in OF_RESPONSE]
    at = np.array([x for p, x in zip(free, z, strict=True) if p in theirs])
    nominal = np.where([p.kind in OF_SENSORS for p in theirs], at, 0.0)
    found = with_links(robot, {p.core[:2]: p.value(x) for p, x in zip(free, z.tolist(), strict=True)})
    before, after = (Problem(one, logs, noise, theirs) for one in (robot, found))
    return after.log_likelihood(at) - before.log_likelihood(nominal)


def objections(
    free: Sequence[Parameter],
    z: FloatArray,
    std: FloatArray,
    unit: FloatArray,
    foretold: Foretold | None,
    gain: float | None,
) -> tuple[str, ...]:
    """Reasons not to trust an outcome, the most important first; ``gain`` is that of `filters_gain`.

    Estimates ``z``, their standard errors ``std``, and what they change with the mass that they are measured by,
    ``unit``, are in tolerances.
    """
    found = []
    if foretold is not None and not foretold.better:
        found.append(f"it does not predict better than robot.yaml as it is ({foretold})")
    if foretold is not None:
        found += [
            f"{name} is predicted less well from the other sensors (log-likelihood {worse:+.1f})"
            for name, worse in foretold.sensors.items()
            if worse < LOSS
        ]
    if gain is not None and gain < 0:
        found.append(
            f"a Kalman filter predicts less well with these values than with robot.yaml (log-likelihood {gain:+.1f})"
        )
    far = FAR * np.hypot(1.0, unit)
    for p, x, wide, most in zip(free, z.tolist(), std.tolist(), far.tolist(), strict=True):
        if p.kind in NOISE:
            continue
        value = f"{p.name} = {p.value(x):.4g} {p.unit}".rstrip()
        if p.exceeds(x) and not (p.exceeds(0.0) and abs(x) < HERE):
            found.append(f"{value} is at its bound")
        elif abs(x) - WIDE * wide > most and p.stated:
            found.append(f"{value} is {abs(x):.1f} tolerances from {p.start:.4g}, its value in robot.yaml")
    return tuple(found)


def _stretches(count: int, fold: int) -> list[slice]:
    edges = np.linspace(0, count, STRETCHES + 1).astype(int)
    return [slice(a, b) for i, (a, b) in enumerate(pairwise(edges)) if i % FOLDS == fold]
