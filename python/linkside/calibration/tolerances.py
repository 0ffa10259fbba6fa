"""Standard errors and correlations as robot.yaml's `tolerances` have them, in as few digits as will do."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.linalg

from linkside.arrays import FloatArray

from .parameters import KINDS, Parameter
from .result import Estimated, Result

CONSIDERED = (
    *("stiffness", "cubic_stiffness", "damping", "mass_scale", "link_friction"),
    *("translation", "rotation", "scale"),
)
"""Kinds whose standard errors count in estimates."""

DIGITS = range(2, 16)
CLOSE = 0.1
"""By so much digits may change the variance of any sum of errors."""

SINGULAR = 1e-12
"""Variances this much smaller than those of single errors are rounding."""


def errors(calibration: Result) -> tuple[list[str], FloatArray]:
    """Give the names of what filters take as uncertain, and the covariance of its errors, (p, p).

    In the measure of `linkside.robot.considered`: logarithms of positive numbers; the stiffness is that of the whole
    spring, and hardening is what it is off beside: δk₃ − k₃ δ ln K.
    """
    chosen = [i for i, e in enumerate(calibration.estimates) if _counts(e)]
    found = [calibration.estimates[i] for i in chosen]
    scale = np.array([_size(e.parameter, e.value) for e in found])
    covariance = np.outer(scale, scale) * calibration.uncertainty.covariance[np.ix_(chosen, chosen)]
    into = np.eye(len(found))
    at = {e.parameter.core: i for i, e in enumerate(found)}
    for (kind, joint, _), i in at.items():
        if kind == "cubic_stiffness" and (spring := at.get(("stiffness", joint, 0))) is not None:
            into[i, spring] = -found[i].value
    return [e.parameter.name for e in found], into @ covariance @ into.T


def _size(p: Parameter, value: float) -> float:
    """One tolerance in that measure."""
    return p.tolerance / value if KINDS[p.kind].relative and not p.relative else p.tolerance


def _counts(e: Estimated) -> bool:
    known = np.isfinite(e.std) and e.std > 0 and not e.at_bound
    return bool(known and e.value and e.parameter.kind in CONSIDERED)


def readable(names: Sequence[str], covariance: FloatArray) -> tuple[list[float], dict[str, dict[str, float]]]:
    """Round standard errors and correlations alike, so that hardly any sum of errors becomes larger or smaller.

    Where a product is known far better than its factors, that takes more digits than two.

    Returns
    -------
    std : list of float
        By ``names``.
    correlations : dict
        Those that do not vanish; each pair once, in the order of ``names``.
    """
    std = np.sqrt(np.diag(covariance))
    exact = covariance / np.outer(std, std)
    least = SINGULAR * np.eye(len(names))
    for digits in DIGITS:
        rounded_std = np.array([float(f"{x:.{digits}g}") for x in std])
        correlation = np.round(exact, digits)
        np.fill_diagonal(correlation, 1.0)
        share = rounded_std / std
        there = correlation * np.outer(share, share) + least
        if np.abs(scipy.linalg.eigvalsh(there, exact + least) - 1).max() < CLOSE:
            break
    rows = {
        a: {b: x for b, x in zip(names[i + 1 :], correlation[i, i + 1 :].tolist(), strict=True) if x}
        for i, a in enumerate(names)
    }
    return rounded_std.tolist(), {a: row for a, row in rows.items() if row}
