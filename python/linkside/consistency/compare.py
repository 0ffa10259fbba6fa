"""Whether a filter's uncertainty is to be believed: its innovations and errors against what they should be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from linkside.errors import EstimatorError
from linkside.kalman.filtering import KalmanEstimate
from linkside.recording.estimate import Estimate, _counterparts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = npt.NDArray[np.float64]

LEVEL = 0.99
LAGS = 50
LEAST_STD = 1e-12
"""Below this a standard deviation is that of something that cannot move."""


@dataclass(frozen=True)
class Ratio:
    """A mean that should be 1, with the bounds it should be in.

    Attributes
    ----------
    mean : float
        Normalised square per degree of freedom.
    low, high : float
        Its bounds.
    inside : float
        Share of samples within their own bounds; should be `Consistency.level`.
    degrees : float
        Degrees of freedom of a sample.
    independent : float
        Share of samples that count as independent; 1 for innovations.
    varying : float or None
        Of an error, the mean without the error's constant part.
    """

    mean: float
    low: float
    high: float
    inside: float
    degrees: float
    independent: float
    varying: float | None = None

    @property
    def verdict(self) -> str:
        """``"consistent"``, ``"overconfident"`` or ``"cautious"``."""
        return "overconfident" if self.mean > self.high else "cautious" if self.mean < self.low else "consistent"


@dataclass(frozen=True, eq=False)
class Consistency:
    """How a filter's innovations, and its errors where a truth is given, compare with what it expects.

    Attributes
    ----------
    level : float
        Probability of all bounds.
    t, nis, nees : (T,)
        Time, and normalised squares of innovations and of the error of q, per degree of freedom; NaN where there is
        none.
    innovations, position, tool : Ratio
        Of innovations over the recording, of the error of q, and of the tool's. The last two are None without a truth.
    log_likelihood : float
        Of the whole recording.
    channels : tuple of str
        The m channels.
    normalised : (T, m)
        Innovations over their standard deviations.
    autocorrelation : (lags, m)
        Of those, from lag 1 on; zero for a filter that is right.
    bound : (m,)
        What an autocorrelation of white innovations exceeds with probability 1 - level.
    white : (m,)
        Whether Ljung and Box's test over all lags leaves a channel's innovations white.
    """

    level: float
    t: FloatArray
    nis: FloatArray
    nees: FloatArray | None
    innovations: Ratio
    position: Ratio | None
    tool: Ratio | None
    log_likelihood: float
    channels: tuple[str, ...]
    normalised: FloatArray
    autocorrelation: FloatArray
    bound: FloatArray
    white: npt.NDArray[np.bool_]

    @property
    def sizes(self) -> FloatArray:
        """Root mean square of each channel's normalised innovations, (m,); 1 for a filter that is right."""
        counts = np.maximum(1, np.isfinite(self.normalised).sum(axis=0))
        return np.asarray(np.sqrt(np.nansum(self.normalised**2, axis=0) / counts))

    def to_text(self) -> str:
        """Report in words."""
        parts = [("innovations", self.innovations), ("error of q", self.position), ("error of the tool", self.tool)]
        lines = [_line(name, ratio, self.level) for name, ratio in parts if ratio is not None]
        lines += self._whiteness_lines()
        lines.append(f"log-likelihood: {self.log_likelihood:.1f}")
        return "\n".join([*self._verdicts(), *lines]) + "\n"

    def figure(self) -> Figure:
        """Draw NIS over time, innovations' distribution and autocorrelation, and NEES where there is a truth."""
        from .figure import draw

        return draw(self)

    def _verdicts(self) -> list[str]:
        ratio, what = (self.position, "errors") if self.position else (self.innovations, "innovations")
        factor = float(np.sqrt(ratio.mean))
        if ratio.verdict == "consistent":
            return [f"The filter is consistent: {what} are as large as it says."]
        if ratio.verdict == "cautious":
            return [f"The filter is cautious: {what} are {_times(1 / factor)} smaller than it says."]
        constant = ratio.varying is not None and ratio.varying < 0.5 * ratio.mean
        sees = self.innovations.verdict == "overconfident"  # no innovation shows an offset at rest
        advice = "try linkside tune" if sees or not constant else "most of it is a constant offset: calibrate"
        return [f"The filter is overconfident: {what} are {_times(factor)} larger than it says; {advice}."]

    def _whiteness_lines(self) -> list[str]:
        if not self.channels:
            return ["whiteness of innovations: not known; run with innovations=True"]
        coloured = [name for name, white in zip(self.channels, self.white, strict=True) if not white]
        if not coloured:
            return [f"innovations are white in all {len(self.channels)} channels over {len(self.autocorrelation)} lags"]
        rows = [f"innovations are correlated in time in {len(coloured)} of {len(self.channels)} channels:"]
        rows += [self._channel_line(index, name) for index, name in enumerate(self.channels) if name in coloured]
        return [*rows, "  errors of the model (stiffness, mass, friction) last from sample to sample, noise does not"]

    def _channel_line(self, index: int, name: str) -> str:
        first, size = self.autocorrelation[0, index], self.sizes[index]
        bound = f"white: within ±{self.bound[index]:.2f}"
        return f"  {name}: {first:.2f} at lag 1 ({bound}), RMS {size:.2f} times what is expected"


def consistency(
    estimate: KalmanEstimate,
    truth: Estimate | None = None,
    *,
    channels: Sequence[str] | None = None,
    level: float = LEVEL,
    lags: int = LAGS,
) -> Consistency:
    """Compare a filter's innovations, and its errors, with what it expects of them.

    Normalised innovations squared (NIS) of a filter that is right are chi-square, as many degrees of freedom as
    readings, independent from sample to sample; normalised estimation errors squared (NEES) likewise, but errors are
    correlated in time, so that the bounds of their mean are those of as many samples as are independent. Bar-Shalom,
    Li and Kirubarajan, "Estimation with applications to tracking and navigation" (2001), section 5.4.

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


def autocovariance(values: FloatArray, lags: int) -> FloatArray:
    """Autocovariance of a series at lags 0 … lags about zero, (lags + 1,); NaN are left out, and the rest joined."""
    known = values[np.isfinite(values)]
    size = len(known)
    if size == 0:
        return np.zeros(lags + 1)
    spectrum = np.abs(np.fft.rfft(known, 2 * size)) ** 2
    covariance = np.fft.irfft(spectrum)[: min(lags + 1, size)] / size
    return np.pad(covariance, (0, lags + 1 - len(covariance)))


def long_run_variance(values: FloatArray) -> float:
    """Sum of a series' autocovariance about its mean over all lags: what the variance of its sum grows by each sample.

    Taken up to where the autocovariance first meets zero, beyond which an estimate is mostly noise (Geyer 1992).
    """
    known = values[np.isfinite(values)]
    if len(known) < 2:
        return 0.0
    covariance = autocovariance(known - known.mean(), len(known) - 1)
    end = int(np.argmax(covariance <= 0)) or len(covariance)
    return float(covariance[0] + 2 * covariance[1:end].sum())


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
    error = estimate.q - truth.q[_counterparts(estimate.t, truth.t, "the truth")]
    return _error_ratio(error, estimate.q_std, estimate.covariance, level)


def _tool(estimate: KalmanEstimate, truth: Estimate | None, level: float) -> Ratio | None:
    """The same of the tool, axis by axis; an axis that the robot cannot move along has no error."""
    if truth is None or truth.tool_position is None or estimate.tool_position is None or estimate.tool_std is None:
        return None
    error = estimate.tool_position - truth.tool_position[_counterparts(estimate.t, truth.t, "the truth")]
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


def _times(factor: float) -> str:
    return f"{factor:.2g} times" if factor >= 1.1 else "slightly"


def _line(name: str, ratio: Ratio, level: float) -> str:
    varying = "" if ratio.varying is None else f", {ratio.varying:.3g} without its constant part"
    bounds = f"{100 * level:g} % bounds {ratio.low:.3f} to {ratio.high:.3f}"
    share = f"{100 * ratio.inside:.1f} % of samples within theirs"
    return f"{name}: {ratio.mean:.3g} per degree of freedom{varying}; {bounds}; {share} ({ratio.verdict})"
