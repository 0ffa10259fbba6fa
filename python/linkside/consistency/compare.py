"""Whether a filter's uncertainty is right: its innovations and errors compared with what they should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.kalman.filtering import KalmanEstimate
from linkside.recording.estimate import Estimate
from linkside.recording.times import counterparts
from linkside.statistics import autocovariance, long_run_variance

from .measures import Measures, Ratio

if TYPE_CHECKING:
    from matplotlib.figure import Figure


LEVEL = 0.99
LAGS = 50
LEAST_STD = 1e-12
"""Below this a standard deviation is that of something that cannot move."""


@dataclass(frozen=True, eq=False)
class Consistency(Measures):
    """Measures with a figure."""

    def figure(self) -> Figure:
        """Draw NIS over time, innovations' distribution and autocorrelation, and NEES where there is a truth."""
        from .figure import draw

        return draw(self)


def consistency(
    estimate: KalmanEstimate,
    truth: Estimate | None = None,
    *,
    channels: Sequence[str] | None = None,
    level: float = LEVEL,
    lags: int = LAGS,
) -> Consistency:
    """Compare a filter's innovations, and its errors, with their stated standard deviations.

    Normalised innovations squared (NIS) of a consistent filter are chi-square distributed, with as many degrees of
    freedom as readings, and independent from sample to sample. Normalised estimation errors squared (NEES) are the same
    of the errors, which are correlated in time, so that the bounds of their mean use the number of effectively
    independent samples. Bar-Shalom, Li and Kirubarajan, "Estimation with applications to tracking and navigation"
    (2001), section 5.4.

    Parameters
    ----------
    estimate
        Of a filter, or a smoother, whose innovations are those of its filter; run with ``innovations=True`` for
        whiteness, and with ``covariance=True`` for NEES with the joints' correlation (else each joint by itself).
    truth
        With a row at the time of every row of the estimate.
    channels
        Names of the columns of ``innovation``; without them, motors by their joints and readings by number.
    level
        Probability of bounds.
    lags
        Of the autocorrelation.

    Raises
    ------
    EstimatorError
        No innovation at all, a truth that does not cover the estimate, or an argument out of range.
    """
    if not (0 < level < 1 and lags >= 1):
        raise EstimatorError(f"level is {level} and lags is {lags}, expected between 0 and 1, and at least 1")
    if estimate.nis is None or estimate.used is None or not estimate.used.any():
        raise EstimatorError("the estimate has no innovations: consistency is for Kalman filters that used a reading")
    normalised, names = _normalised(estimate, channels)
    white = [_white(z, lags, level) for z in normalised.T]
    position, nees = _position(estimate, truth, level)
    likelihood = 0.0 if estimate.log_likelihood is None else float(estimate.log_likelihood.sum())
    return Consistency(
        level=level,
        t=estimate.t,
        nis=_per_degree(estimate.nis, estimate.used),
        nees=nees,
        innovations=_ratio(estimate.nis, estimate.used, level),
        position=position,
        tool=_tool(estimate, truth, level),
        log_likelihood=likelihood,
        channels=names,
        normalised=normalised,
        autocorrelation=np.array([a for a, _, _ in white]).reshape(len(names), lags).T,
        bound=np.array([b for _, b, _ in white]),
        white=np.array([w for _, _, w in white], bool),
    )


def _normalised(estimate: KalmanEstimate, channels: Sequence[str] | None) -> tuple[FloatArray, tuple[str, ...]]:
    if estimate.innovation is None or estimate.innovation_std is None:
        return np.empty((len(estimate), 0)), ()
    normalised = np.asarray(estimate.innovation / estimate.innovation_std)
    count, joints = normalised.shape[1], len(estimate.names)
    known = [f"theta_{name}" for name in estimate.names] + [f"reading {i}" for i in range(joints, count)]
    names = list(channels or getattr(estimate, "channels", None) or known)
    if len(names) != count:
        raise EstimatorError(f"{len(names)} channels are named, and the estimate has {count}")
    return normalised, tuple(names)


def _white(values: FloatArray, lags: int, level: float) -> tuple[FloatArray, float, bool]:
    """Autocorrelation of one channel from lag 1, its bound, and the verdict of Ljung and Box (1978)."""
    count = int(np.isfinite(values).sum())
    if count <= lags + 1:
        return np.full(lags, np.nan), np.nan, True
    covariance = autocovariance(values, lags)
    if covariance[0] == 0:
        return np.zeros(lags), 0.0, True
    correlation = covariance[1:] / covariance[0]
    statistic = count * (count + 2) * np.sum(correlation**2 / (count - np.arange(1, lags + 1)))
    bound = stats.norm.ppf(0.5 + level / 2) / np.sqrt(count)
    return correlation, float(bound), bool(statistic < stats.chi2.ppf(level, lags))


def _per_degree(squares: FloatArray, degrees: npt.NDArray[Any]) -> FloatArray:
    return np.asarray(np.where(degrees > 0, squares / np.maximum(degrees, 1), np.nan))


def _ratio(squares: FloatArray, degrees: npt.NDArray[Any], level: float, independent: float = 1.0) -> Ratio:
    """Mean of chi-square values per degree of freedom, and its bounds when this share of them is independent."""
    known = np.isfinite(squares) & (degrees > 0)
    squares, degrees = squares[known], degrees[known]
    total = float(degrees.sum())
    tails = np.array([0.5 - level / 2, 0.5 + level / 2])
    low, high = stats.chi2.ppf(tails, independent * total) / (independent * total)
    kinds, which = np.unique(degrees, return_inverse=True)
    own = stats.chi2.ppf(tails[:, None], kinds)[:, which]
    inside = float(np.mean((squares >= own[0]) & (squares <= own[1])))
    mean = float(squares.sum()) / total
    return Ratio(mean, float(low), float(high), inside, float(degrees.mean()), independent)


def _independent(squares: FloatArray) -> float:
    """Share of samples that count as independent: variance over long-run variance."""
    known = squares[np.isfinite(squares)]
    slow = long_run_variance(known)
    return min(1.0, float(np.var(known)) / slow) if slow > 0 else 1.0


def _position(estimate: KalmanEstimate, truth: Estimate | None, level: float) -> tuple[Ratio | None, FloatArray | None]:
    """NEES of q: over all joints at once where the covariance was kept, else joint by joint."""
    if truth is None:
        return None, None
    if estimate.q_std is None:
        raise EstimatorError("the estimate has no standard deviations to compare its error with")
    error = estimate.q - truth.q[counterparts(estimate.t, truth.t, "the truth")]
    return _error_ratio(error, estimate.q_std, estimate.covariance, level)


def _tool(estimate: KalmanEstimate, truth: Estimate | None, level: float) -> Ratio | None:
    """The same of the tool, axis by axis; an axis that the robot cannot move along has no error."""
    if truth is None or truth.tool_position is None or estimate.tool_position is None or estimate.tool_std is None:
        return None
    error = estimate.tool_position - truth.tool_position[counterparts(estimate.t, truth.t, "the truth")]
    return _error_ratio(error, estimate.tool_std, None, level)[0]


def _error_ratio(
    error: FloatArray, std: FloatArray, covariance: FloatArray | None, level: float
) -> tuple[Ratio | None, FloatArray | None]:
    """Ratio of an error, (T, k), and its normalised squares per degree of freedom; None where nothing is known."""
    degrees = np.where(np.isfinite(error).all(axis=1), int((std > LEAST_STD).all(axis=0).sum()), 0)
    if not degrees.any():
        return None, None
    squares = _squares(error, std, covariance)
    ratio = _ratio(squares, degrees, level, _independent(squares))
    varying = _squares(error - np.nanmean(error, axis=0), std, covariance)
    return replace(ratio, varying=float(np.nansum(varying) / degrees.sum())), _per_degree(squares, degrees)


def _squares(error: FloatArray, std: FloatArray, covariance: FloatArray | None) -> FloatArray:
    """Normalised squares, (T,), of what is uncertain at all."""
    uncertain = (std > LEAST_STD).all(axis=0)
    if covariance is None:
        return np.asarray(((error / np.where(uncertain, std, np.inf)) ** 2).sum(axis=1))
    chosen = np.flatnonzero(uncertain)
    error, block = error[:, chosen], covariance[:, chosen[:, None], chosen]
    return np.asarray((error * np.linalg.solve(block, error[:, :, None])[:, :, 0]).sum(axis=1))
