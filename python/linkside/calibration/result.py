"""What a calibration found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkside.arrays import FloatArray
from linkside.statistics import autocovariance

from .acceptance import Foretold
from .parameters import Parameter
from .posterior import Posterior
from .problem import Evidence
from .uncertainty import Contradiction, Uncertainty

LAGS = 50


@dataclass(frozen=True)
class Estimated:
    """A parameter's estimate.

    Attributes
    ----------
    parameter : Parameter
        Which.
    value, std : float
        Its value and standard error.
    widening : float
        Factor by which the standard error was increased because errors of the model are correlated in time.
    at_bound : bool
        Whether the value is at a bound: then its standard error means little.
    """

    parameter: Parameter
    value: float
    std: float
    widening: float
    at_bound: bool


@dataclass(frozen=True, eq=False)
class Fit:
    """How well parameters explain recordings.

    Attributes
    ----------
    log_likelihood : float
        Of all recordings.
    used : int
        Readings.
    nis : (m,)
        Normalised innovation squared of each channel; 1 when innovations are as large as expected.
    autocorrelation : (lags, m)
        Of normalised innovations from lag 1 on; 0 when they are white.
    """

    log_likelihood: float
    used: int
    nis: FloatArray
    autocorrelation: FloatArray

    @classmethod
    def of(cls, evidence: Evidence) -> Fit:
        """Summarise evidence with details."""
        joined = np.vstack(evidence.innovations)
        covariance = np.array([autocovariance(channel, LAGS) for channel in joined.T])
        correlation = covariance[:, 1:] / np.maximum(covariance[:, :1], 1e-300)
        counts = np.maximum(1, np.isfinite(joined).sum(axis=0))
        return cls(evidence.log_likelihood, evidence.used, np.nansum(joined**2, axis=0) / counts, correlation.T)


@dataclass(frozen=True, eq=False)
class Result:
    """Most probable parameters, and how far to trust them.

    Attributes
    ----------
    estimates : tuple of Estimated
        Those that were freed.
    refused : dict of str to str
        Those that are not identifiable from the recordings, with the reason; they stay as in robot.yaml.
    correlation : (p, p)
        Of the estimates.
    before, after : Fit
        At the values of robot.yaml, and at the estimates.
    held_out : tuple of float, optional
        Log-likelihood of recordings that were not used, before and after.
    contradictions : tuple of Contradiction
        Between recordings.
    notes : tuple of str
        Other outcomes that a search ended at.
    foretold : Foretold, optional
        How well readings are predicted by parameters that were fitted without them.
    objections : tuple of str
        Reasons not to trust the outcome.
    evaluations : int
        Of the likelihood with its gradient.
    seconds : float
        How long it took.
    problem : Problem
        What was solved; its recordings and free parameters.
    z : (p,)
        The estimates in tolerances.
    uncertainty : Uncertainty
        Likewise.
    """

    estimates: tuple[Estimated, ...]
    refused: dict[str, str]
    before: Fit
    after: Fit
    held_out: tuple[float, float] | None
    contradictions: tuple[Contradiction, ...]
    notes: tuple[str, ...]
    foretold: Foretold | None
    objections: tuple[str, ...]
    evaluations: int
    seconds: float
    problem: Posterior
    z: FloatArray
    uncertainty: Uncertainty

    @property
    def accepted(self) -> bool:
        """Whether nothing speaks against the outcome."""
        return not self.objections

    @property
    def correlation(self) -> FloatArray:
        """Correlations of the estimates, (p, p)."""
        return self.uncertainty.correlation

    def __getitem__(self, name: str) -> Estimated:
        """Give an estimate by its parameter's name, such as ``stiffness_axis2``."""
        return next(e for e in self.estimates if e.parameter.name == name)

    def to_text(self) -> str:
        """Report in words."""
        lines = [f"refused: {objection}" for objection in self.objections]
        lines.append(f"{'':28} {'before':>12} {'estimate':>12} {'std. error':>11}")
        for e in self.estimates:
            edge = "  at its bound" if e.at_bound else ""
            lines.append(f"{e.parameter.name:28} {e.parameter.start:12.5g} {e.value:12.5g} {e.std:11.2g}{edge}")
        lines += [f"not estimated: {name}: {reason}" for name, reason in self.refused.items()]
        lines.append(self._fit_line())
        if self.foretold is not None:
            lines.append(f"{self.foretold} against robot.yaml, with parameters fitted without them")
        if self.held_out is not None:
            lines.append(f"held out: log-likelihood {self.held_out[0]:.1f} before, {self.held_out[1]:.1f} after")
        wide = max((e.widening for e in self.estimates), default=1.0)
        if wide > 1.5:
            lines.append(f"standard errors are up to {wide:.1f} times as large as with white innovations")
        lines += [f"warning: {c}" for c in (*self.contradictions, *self.notes)]
        return "\n".join(lines) + "\n"

    def _fit_line(self) -> str:
        b, a = self.before, self.after
        return (
            f"log-likelihood {b.log_likelihood:.1f} before, {a.log_likelihood:.1f} after; largest correlation of "
            f"innovations from sample to sample {np.abs(b.autocorrelation[0]).max():.2f} before, "
            f"{np.abs(a.autocorrelation[0]).max():.2f} after"
        )
