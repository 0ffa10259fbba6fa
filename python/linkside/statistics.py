"""Sizes of errors, and sequences that are correlated in time."""

from __future__ import annotations

import numpy as np

from .arrays import FloatArray


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(values**2)))


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
