"""Whether a calibration is to be believed: it must foretell readings that it was not fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from linkside.arrays import FloatArray
from linkside.recording.log import Log

from .parameters import NOISE, Parameter
from .problem import Problem
from .search import ROUGH, Search

FOLDS = 2
"""Each stretch of a recording is held back once; as many fits."""

STRETCHES = 12
"""A recording is cut into so many, which the folds take in turn."""

FAR = 3.0
"""An estimate further from robot.yaml than this, in tolerances, is not one that robot.yaml's tolerance allows for."""


@dataclass(frozen=True)
class Foretold:
    """How much better readings are foretold by parameters that were fitted without them.

    Attributes
    ----------
    gain : float
        Log-likelihood of all readings that were held back, over that with the values of robot.yaml; for both, the
        noise levels are fitted.
    std : float
        Its standard error, by how it differs from stretch to stretch.
    worst : float
        Gain of the worst stretch.
    """

    gain: float
    std: float
    worst: float

    @property
    def better(self) -> bool:
        """Whether there is a gain at all."""
        return self.gain > 0

    def __str__(self) -> str:
        """Say so in a line."""
        return f"readings held back: log-likelihood {self.gain:+.1f} ± {self.std:.1f}"


def foretell(problem: Problem, z: FloatArray) -> Foretold:
    """Fit without a part of the readings in turn, and see how those are foretold.

    What is held back are the readings of all sensors but the motors' encoders, in every other stretch of time
    (cross-validation, M. Stone, J. R. Stat. Soc. B 36, 1974).

    Parameters
    ----------
    problem
        What was solved.
    z : (p,)
        Its outcome: where the fits begin.
    """
    nominal = problem.evidence(_noise_alone(problem), detail=True).densities
    gains: list[float] = []
    for fold in range(FOLDS):
        stretches = [_stretches(len(log), fold) for log in problem.logs]
        fitted = problem.on([_without(log, parts) for log, parts in zip(problem.logs, stretches, strict=True)])
        found = problem.evidence(Search(fitted, gain=ROUGH).maximise(z), detail=True).densities
        for ours, theirs, parts in zip(found, nominal, stretches, strict=True):
            gains += [float(np.sum((ours - theirs)[part])) for part in parts]
    return Foretold(sum(gains), float(np.std(gains) * np.sqrt(len(gains))), min(gains))


def objections(free: Sequence[Parameter], z: FloatArray, foretold: Foretold | None) -> tuple[str, ...]:
    """Reasons not to believe an outcome, the weightiest first."""
    found = []
    if foretold is not None and not foretold.better:
        found.append(f"it does not foretell better than robot.yaml as it is ({foretold})")
    for p, x in zip(free, z.tolist(), strict=True):
        if p.kind in NOISE:
            continue
        value = f"{p.name} = {p.value(x):.4g} {p.unit}".rstrip()
        if p.exceeds(x) and not p.exceeds(0.0):
            found.append(f"{value} is at its bound")
        elif abs(x) > FAR:
            found.append(f"{value} is {abs(x):.1f} tolerances from {p.start:.4g}, its value in robot.yaml")
    return tuple(found)


def _noise_alone(problem: Problem) -> FloatArray:
    """The values of robot.yaml, with noise levels fitted."""
    noise = [p for p in problem.free if p.kind in NOISE]
    levels = iter(Search(problem.holding({}, noise), gain=ROUGH).maximise(np.zeros(len(noise))))
    return np.array([float(next(levels)) if p.kind in NOISE else 0.0 for p in problem.free])


def _stretches(count: int, fold: int) -> list[slice]:
    edges = np.linspace(0, count, STRETCHES + 1).astype(int)
    return [slice(a, b) for i, (a, b) in enumerate(pairwise(edges)) if i % FOLDS == fold]


def _without(log: Log, stretches: Sequence[slice]) -> Log:
    def silenced(values: FloatArray | None) -> FloatArray | None:
        if values is None:
            return None
        out: FloatArray = values.copy()
        for part in stretches:
            out[part] = np.nan
        return out

    return replace(log, acceleration=silenced(log.acceleration), tau=silenced(log.tau))
