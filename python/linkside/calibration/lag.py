"""What a sensor's first-order filter and its delay do to a signal, with derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.signal

from linkside.arrays import FloatArray


@dataclass(frozen=True)
class Lag:
    """A sampled first-order filter and a delay.

    Sampled with step h, a filter of time constant T that is fed what runs straight over a sample is
    y = α y₋ + (1 − α) f with α = exp(−h/T) and f the signal T − h α/(1 − α) earlier, to second order.

    Attributes
    ----------
    time_constant, delay : float
        In samples; no filter where the former is zero.
    """

    time_constant: float
    delay: float

    @property
    def _memory(self) -> float:
        return float(np.exp(-1 / self.time_constant)) if self.time_constant > 0 else 0.0

    @property
    def shift(self) -> float:
        """Samples by which the signal comes later, beside the filter's memory."""
        alpha = self._memory
        return self.delay + self.time_constant - alpha / (1 - alpha)

    def __call__(self, values: FloatArray) -> FloatArray:
        """Delay and filter (T, …) along time."""
        return self._filter(self._shifted(values, 0))

    def slopes(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Give the derivatives of that in time constant and delay, in samples."""
        moved, alpha = self._shifted(values, 0), self._memory
        by_delay = self._filter(self._shifted(values, 1))
        if self.time_constant <= 0:
            return np.zeros_like(values), by_delay
        slope = alpha / self.time_constant**2
        out = self._filter(moved)
        before = np.concatenate([moved[:1], out[:-1]])
        by_alpha = scipy.signal.lfilter([1.0], [1.0, -alpha], before - moved, axis=0)
        return slope * by_alpha + (1 - slope / (1 - alpha) ** 2) * by_delay, by_delay

    def _filter(self, values: FloatArray) -> FloatArray:
        alpha = self._memory
        if alpha == 0.0:
            return values
        settled = alpha * values[:1]
        return np.asarray(scipy.signal.lfilter([1 - alpha], [1.0, -alpha], values, axis=0, zi=settled)[0])

    def _shifted(self, values: FloatArray, order: int) -> FloatArray:
        """Interpolate by cubics through four samples (Lagrange); of order 1, the derivative in the shift."""
        whole = max(0, int(np.floor(self.shift)))  # rounding may leave a shift of zero below it
        u = self.shift - whole
        if order == 0 and self.shift == 0.0:
            return values
        count, before = len(values), min(whole, len(values)) + 2
        padded = np.concatenate([np.repeat(values[:1], before, axis=0), values, values[-1:]])
        return sum((x * padded[k : k + count] for k, x in enumerate(_weights(u, order))), np.zeros_like(values))


def _weights(u: float, order: int) -> tuple[float, float, float, float]:
    """Weights of the samples at 2, 1, 0 and -1 in the value at ``u``, from 0 to 1, or in its slope there."""
    if order == 0:
        a, b, c = u + 1, u - 1, u - 2
        return a * u * b / 6, -a * u * c / 2, a * b * c / 2, -u * b * c / 6
    square = 3 * u * u
    return (square - 1) / 6, -(square - 2 * u - 2) / 2, (square - 4 * u - 1) / 2, -(square - 6 * u + 2) / 6
