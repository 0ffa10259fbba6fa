"""How far to trust estimates: standard errors, identifiability, contradictions between recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from linkside.arrays import FloatArray

from .parameters import NOISE, OF_ELEMENTS, OF_LINK_ENCODERS, Parameter
from .posterior import Posterior
from .problem import Evidence
from .products import products

MEMORY = 0.1
"""Errors of a model are correlated over about this time [s]."""

IDENTIFIABLE = 0.5
"""A parameter whose standard error is more than this share of its tolerance is not identifiable from the data."""

HALF_TOLD = 0.9
"""Likewise of `NEVER_KNOWN`."""

NEVER_KNOWN = (
    *("damping", "link_friction", "link_coulomb", *OF_ELEMENTS),
    *("translation", "rotation", "bias", "scale"),
)
"""Kinds of which robot.yaml's value is a guess, as of a sensor's mounting by hand."""

STANDING_IN = (("time_constant", "delay"), OF_LINK_ENCODERS)
"""Kinds that can replace each other in one sensor: without one of them the other is identifiable."""

HIDING = 0.2
"""A parameter that is less correlated with a stiffness is not what hides it."""

ALIKE = 0.9
"""Of what hides a stiffness nearly as well, a load goes before hardening: stiffness and damping scale with it."""

SIGNIFICANT = 1e-4
"""Recordings contradict each other when estimates as far apart as theirs have a smaller probability than this."""

UNFINISHED = 0.04
"""What a search leaves of the way, squared, as a share of the variance."""

EXCITATION = {
    "stiffness": "faster motion, or a heavier load",
    "cubic_stiffness": "larger torques, from fast or loaded motion",
    "damping": "motion that leaves the link swinging, as hard stops do",
    "hysteresis_stiffness": "loads that turn round",
    "hysteresis_limit": "loads that turn round",
    "motor_inertia": "motor torques, and strong accelerations",
    "viscous": "motor torques, and long stretches at different constant speeds",
    "coulomb": "motor torques, and reversals at low speed",
    "torque_constant": "motor torques, and masses that are known",
    "torque_delay": "motor torques, and fast motion",
    "coupling": "motor torques, and accelerations of both joints",
    "mass_scale": "motor torques",
    "link_friction": "motion at different speeds, slow ones too",
    "link_coulomb": "link encoders, and reversals",
    "half_gap": "torques that change their sign",
    "payload_mass": "accelerations about several axes, in several postures",
    "payload_xyz": "the wrist in several postures, accelerated",
    "translation": "fast rotation of the link that carries the sensor",
    "rotation": "several postures that gravity shows the direction of",
    "bias": "several postures",
    "scale": "strong accelerations, and several postures",
    "time_constant": "fast motion: accelerations that change within a few samples",
    "delay": "fast motion: accelerations that change within a few samples",
    "link_time_constant": "fast motion, and link encoders",
    "link_delay": "fast motion, and link encoders",
}


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Of the estimates, in tolerances.

    Attributes
    ----------
    std : (p,)
        Standard errors.
    correlation : (p, p)
        Correlations.
    widening : (p,)
        By what factor standard errors are larger than if innovations were independent.
    """

    std: FloatArray
    correlation: FloatArray
    widening: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance, (p, p)."""
        return self.correlation * np.outer(self.std, self.std)

    @property
    def plain(self) -> FloatArray:
        """Covariance if innovations were independent, (p, p)."""
        return self.covariance / np.outer(self.widening, self.widening)

    def of(self, count: int) -> Uncertainty:
        """Of the first ``count`` only."""
        return Uncertainty(self.std[:count], self.correlation[:count, :count], self.widening[:count])

    def at_least(self, std: FloatArray) -> Uncertainty:
        """Give standard errors no smaller than ``std``."""
        return replace(self, std=np.maximum(self.std, std))


@dataclass(frozen=True)
class Untold:
    """Parameters that are not identifiable from recordings.

    Attributes
    ----------
    reasons : dict of str to str
        Parameters that stay as robot.yaml has them, with the reason.
    considered : set of str
        Of those, which are taken as uncertain: the others, such as a load, are taken as robot.yaml has them.
    """

    reasons: dict[str, str]
    considered: frozenset[str]


def uncertainty(evidence: Evidence, period: float, shifts: FloatArray | None = None) -> Uncertainty:
    """Standard errors from the information, widened where errors last.

    C = (H + 1)⁻¹ is right if the model is. If it is not, errors last from sample to sample and the variance of the
    gradient is its long-run variance J in place of H, so that C (J + 1) C takes its place (H. White, Econometrica 50,
    1982; W. K. Newey and K. D. West, Econometrica 55, 1987). Of the two, the larger is reported. To it are added errors
    that residuals do not show, one standard deviation of each in a column of ``shifts`` (p, k).
    """
    p = len(evidence.gradient)
    plain = np.linalg.inv(evidence.information + np.eye(p))
    slow = sum((long_run(scores, round(MEMORY / period)) for scores in evidence.scores), np.zeros((p, p)))
    robust = plain @ (slow + np.eye(p)) @ plain
    widening = np.sqrt(np.maximum(1.0, np.diag(robust) / np.diag(plain)))
    covariance = plain * np.outer(widening, widening)
    if shifts is not None:
        covariance = covariance + shifts @ shifts.T
    std = np.sqrt(np.diag(covariance))
    return Uncertainty(std, covariance / np.outer(std, std), std / np.sqrt(np.diag(plain)))


def long_run(scores: FloatArray, lags: int) -> FloatArray:
    """Variance of the sum of (T, p) correlated vectors, with Bartlett's weights up to ``lags``.

    Those weights are what the squares of sums over ``lags`` + 1 neighbours have, all of them in turn.
    """
    count = len(scores)
    until = np.concatenate([np.zeros((1, scores.shape[1])), np.cumsum(scores - scores.mean(axis=0), axis=0)])
    last = np.arange(count + lags)
    return products(until[np.minimum(last + 1, count)] - until[np.maximum(last - lags, 0)]) / (lags + 1)


def unidentifiable(
    free: Sequence[Parameter],
    z: FloatArray,
    evidence: Evidence,
    still: Sequence[str],
    known: frozenset[str] = frozenset(),
) -> Untold:
    """Find the parameters that are not identifiable, each with the reason: leave out the worst, then look again.

    Parameters
    ----------
    free, z, evidence
        Parameters, where they are, and what recordings say of them there.
    still
        Names of joints that do not move.
    known
        Of ``free``, those that were found so before, and considered since.
    """
    reasons = {p.name: "its joint does not move" for p in free if _of_joint(p, still)}
    considered = set(known)
    spread = max(1.0, _excess(evidence))
    kept = [i for i, p in enumerate(free) if p.name not in reasons]
    while kept:
        information = evidence.information[np.ix_(kept, kept)] / spread + np.eye(len(kept))
        covariance = np.asarray(np.linalg.inv(information), np.float64)
        std = np.sqrt(np.diag(covariance))
        chosen = [free[i] for i in kept]
        excess = [0.0 if p.name in considered else s / enough(p) for p, s in zip(chosen, std, strict=True)]
        worst = int(np.argmax(excess))
        if excess[worst] < 1:
            break
        worst = _least_told(worst, chosen, np.abs(z[kept]) / std)
        alone = 1 / np.sqrt(information[worst, worst])
        name = chosen[worst].name
        hidden_by = _hiding(worst, covariance, chosen) if alone < IDENTIFIABLE else None
        if hidden_by is None:
            reasons[name] = _reason(chosen[worst], alone, covariance, worst, chosen)
            if stands_in(chosen[worst]):
                del kept[worst]
            else:
                # It stays among what is uncertain: others are no better known for a value that nothing tells.
                considered.add(name)
        else:
            reasons[chosen[hidden_by].name] = f"with it {name} would not be identifiable; free it by name to try"
            considered.discard(chosen[hidden_by].name)
            del kept[hidden_by]
    return Untold(reasons, frozenset(considered))


def stands_in(p: Parameter) -> bool:
    """Whether another parameter of the same sensor can take a parameter's place."""
    return any(p.kind in kinds for kinds in STANDING_IN)


def enough(p: Parameter) -> float:
    """Largest standard error, in tolerances, of an identifiable parameter; for noise there is no limit.

    A damping or a bias that is half known still keeps springs from making up for a wrong one; masses likewise.
    """
    return {**dict.fromkeys((*NEVER_KNOWN, "mass_scale"), HALF_TOLD), **dict.fromkeys(NOISE, np.inf)}.get(
        p.kind, IDENTIFIABLE
    )


def _least_told(index: int, free: Sequence[Parameter], told: FloatArray) -> int:
    """Of what stands in for a parameter, and that itself, what is the nearest to robot.yaml in standard errors.

    A filter and a delay of a sensor hardly differ in what is slow, but where one is large and the other is not, the
    large one must stay: without it, springs would make up for it.
    """
    own = free[index]
    kinds = next((kinds for kinds in STANDING_IN if own.kind in kinds), ())
    alike = [i for i, p in enumerate(free) if p.kind in kinds and p.core[1:] == own.core[1:]]
    return min(alike, key=lambda i: told[i], default=index)


def _hiding(index: int, covariance: FloatArray, free: Sequence[Parameter]) -> int | None:
    """Find the parameter to leave as in robot.yaml so that a stiffness becomes identifiable; None if there is none.

    Never a damping, a bias or a mounting: a spring that makes up for a wrong one is far off.
    """
    if free[index].kind != "stiffness":
        return None
    std = np.sqrt(np.diag(covariance))
    likeness = np.abs(covariance[index]) / (std * std[index])
    likeness[[p.kind in ("stiffness", *NEVER_KNOWN, *NOISE) for p in free]] = 0.0
    most = float(likeness.max())
    alike = np.flatnonzero(likeness > max(HIDING, ALIKE * most)).tolist()
    return max(alike, key=lambda i: (free[i].kind != "cubic_stiffness", likeness[i]), default=None)


def _of_joint(parameter: Parameter, still: Sequence[str]) -> bool:
    owned = any(parameter.name == f"{parameter.kind}_{joint}" for joint in still)
    return owned and parameter.kind != "mass_scale"


def _excess(evidence: Evidence) -> float:
    """Innovations squared over what is expected, robustly: by the median of each recording."""
    middles = [np.nanmedian(i**2) / stats.chi2.ppf(0.5, 1) for i in evidence.innovations if np.isfinite(i).any()]
    return float(np.mean(middles)) if middles else 1.0


def _reason(parameter: Parameter, alone: float, covariance: FloatArray, index: int, free: Sequence[Parameter]) -> str:
    advice = EXCITATION[parameter.kind]
    if alone >= IDENTIFIABLE or len(free) == 1:
        return f"the recordings hardly depend on it; they lack {advice}"
    std = np.sqrt(np.diag(covariance))
    correlation = covariance[index] / (std * std[index])
    correlation[index] = 0.0
    partner = int(np.argmax(np.abs(correlation)))
    other = f"{free[partner].name} (correlation {correlation[partner]:+.2f})"
    return f"it cannot be distinguished from {other}; it takes {advice}"


@dataclass(frozen=True)
class Contradiction:
    """Two recordings that call for different values.

    Attributes
    ----------
    logs : tuple of str
        Their sources.
    name : str
        The parameter that differs most.
    values : tuple of float
        Its values by each.
    distance : float
        Their distance in standard errors.
    probability : float
        Of all parameters differing by as much, were they the same.
    """

    logs: tuple[str, str]
    name: str
    values: tuple[float, float]
    distance: float
    probability: float

    def __str__(self) -> str:
        """Say so in a line."""
        a, b = self.values
        return (
            f"{self.logs[0]} and {self.logs[1]} contradict each other: {self.name} is {a:.5g} by one and {b:.5g} by "
            f"the other, {self.distance:.0f} standard errors apart; calibrate them one by one"
        )


@dataclass(frozen=True, eq=False)
class Alone:
    """What one of several recordings says by itself.

    Attributes
    ----------
    z : (p,)
        Estimates in tolerances.
    uncertainty : Uncertainty
        Theirs.
    unidentifiable : set of str
        Names of parameters that this recording does not tell.
    """

    z: FloatArray
    uncertainty: Uncertainty
    unidentifiable: frozenset[str] = frozenset()


def compare(problem: Posterior, fits: Sequence[Alone]) -> list[Contradiction]:
    """Compare the estimates by each recording alone, pair by pair, in units of their joint covariance.

    Only what both recordings tell is compared, away from bounds.
    """
    pairs = [(a, b) for a in range(len(fits)) for b in range(a + 1, len(fits))]
    found = (_between(problem, (a, b), fits[a], fits[b]) for a, b in pairs)
    return [contradiction for contradiction in found if contradiction is not None]


def _apart(a: Uncertainty, b: Uncertainty) -> FloatArray:
    """Covariance of the difference of two estimates of one robot, with the same prior, (p, p).

    Estimates are drawn to the prior's mean, each by its own covariance C: with the true z they are off by -C z, and
    around that by C - C². The search, besides, stops a little before its goal.
    """
    drawn = b.plain - a.plain
    sampled = [np.outer(u.widening, u.widening) * (u.plain - u.plain @ u.plain) for u in (a, b)]
    return np.asarray(sampled[0] + sampled[1] + drawn @ drawn + UNFINISHED * (a.plain + b.plain))


def _between(problem: Posterior, logs: tuple[int, int], a: Alone, b: Alone) -> Contradiction | None:
    chosen = [
        i
        for i, p in enumerate(problem.free)
        if p.kind not in NOISE
        and p.name not in a.unidentifiable | b.unidentifiable
        and not any(p.exceeds(float(fit.z[i])) and not p.exceeds(0.0) for fit in (a, b))
    ]
    if not chosen:
        return None
    difference = (a.z - b.z)[chosen]
    covariance = _apart(a.uncertainty, b.uncertainty)[np.ix_(chosen, chosen)]
    square = float(difference @ np.linalg.solve(covariance, difference))
    probability = float(stats.chi2.sf(square, len(chosen)))
    if probability >= SIGNIFICANT:
        return None
    distances = np.abs(difference) / np.sqrt(np.diag(covariance))
    worst = int(np.argmax(distances))
    parameter, i = problem.free[chosen[worst]], chosen[worst]
    values = (parameter.value(float(a.z[i])), parameter.value(float(b.z[i])))
    sources = (problem.logs[logs[0]].source, problem.logs[logs[1]].source)
    return Contradiction(sources, parameter.name, values, float(distances[worst]), probability)
