"""Residuals whose errors last, made white: samples that share an error tell less than they seem to.

What motors' encoders read wrong makes the links of the prediction ring at their own frequencies, and what a model
leaves out is slow. Weighted as if they were white, such errors would be fitted: above all with dampings that are too
strong, which take the ringing out of the prediction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.linalg
import scipy.signal

from linkside.arrays import FloatArray
from linkside.statistics import autocovariance

ORDER = 24
"""Samples that a residual is predicted from: enough for a few resonances in white noise."""

LEAST = 20
"""Samples for each of those, at least."""

FLOOR, SLOW = 1e-6, 1e-2
"""White noise that is added, as a share of the variance, so that what is not noise at all can be inverted too.

More where a channel is only looked at below a frequency: what is above it is not to come back.
"""

MISSING = 0.2
"""Where more of the samples before was missing, a residual cannot be predicted."""


@dataclass(frozen=True)
class Whitening:
    """What the samples before do not predict (L. Ljung, System Identification, 1999, section 7.2: prediction errors).

    Attributes
    ----------
    weights : (m, L)
        Of each channel's present and past samples, and of as many as ``ahead`` after it.
    ahead : int
        By how many samples what comes out is late.
    """

    weights: FloatArray
    ahead: int = 0

    @classmethod
    def of(cls, residuals: Sequence[FloatArray], slow: Mapping[int, FloatArray]) -> Whitening:
        """Fit autoregressions to (T, m) residuals, NaN where missing (Yule and Walker).

        Channels in ``slow`` go through a filter first, whose weights (odd in number) are given.
        """
        count, channels = min(len(r) for r in residuals), residuals[0].shape[1]
        order = min(ORDER, count // LEAST)
        ahead = max((len(filtered) // 2 for filtered in slow.values()), default=0)
        weights = np.zeros((channels, order + 2 * ahead + 1))
        for c in range(channels):
            filtered, own = slow.get(c, np.ones(1)), np.zeros(order + 1)
            own[0] = 1.0
            left = [np.convolve(np.nan_to_num(r[:, c]), filtered, mode="same") for r in residuals]
            covariance = np.sum([len(x) * autocovariance(x, order) for x in left], axis=0)
            if covariance[0] > 0 and order:
                covariance[0] *= 1 + (SLOW if c in slow else FLOOR)
                own[1:] = -scipy.linalg.solve_toeplitz(covariance[:-1], covariance[1:])
            first = ahead - len(filtered) // 2
            weights[c, first : first + len(filtered) + order] = np.convolve(own, filtered)
        return cls(weights, ahead)

    def rows(self, count: int) -> npt.NDArray[np.int64]:
        """Samples of ``count`` that have enough before them and after."""
        return np.arange(self.weights.shape[1] - 1, count) - self.ahead

    def __call__(self, values: FloatArray) -> FloatArray:
        """Filter (T, m, …) along time."""
        first = self.weights.shape[1] - 1
        out = np.empty_like(values[first:])
        for c, weights in enumerate(self.weights):
            out[:, c] = scipy.signal.upfirdn(weights, values[:, c], axis=0)[first : len(values)]
        return out

    def told(self, missing: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Whether samples were read, and most before them, from (T, m) flags of missing readings."""
        length = self.weights.shape[1]
        share = scipy.signal.upfirdn(np.full(length, 1 / length), missing.astype(float), axis=0)
        return np.asarray(~missing[self.rows(len(missing))] & (share[length - 1 : len(missing)] < MISSING))
