"""Frequency bands of a recording, from low to high: a search that starts in low bands finds the right springs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.signal

from linkside.arrays import FloatArray

WIDTH = 1.5
"""Half of a window's length, in periods of its corner."""

PER_PERIOD = 4
"""Samples that are kept in a period of the corner."""

MISSING = 0.2
"""A window with a larger share of missing samples counts as missing."""


@dataclass(frozen=True)
class Band:
    """A low-pass filter that keeps every few samples: a windowed sinc, its ends left out.

    Attributes
    ----------
    weights : (L,)
        Its impulse response, of odd length; sums to one.
    every : int
        Of how many samples one is kept.
    """

    weights: FloatArray
    every: int

    @classmethod
    def below(cls, corner: float, period: float, count: int) -> Band:
        """Of what is below ``corner`` [Hz] in ``count`` samples ``period`` [s] apart; all above a third of their rate.

        The corner is higher where a window would be longer than a quarter of the recording.
        """
        corner = max(corner, 8 * WIDTH / (count * period))
        if corner * period > 1 / 3:
            return cls(np.ones(1), 1)
        half = round(WIDTH / (corner * period))
        at = np.arange(-half, half + 1)
        weights = np.sinc(2 * corner * period * at) * np.hanning(2 * half + 3)[1:-1]
        return cls(weights / weights.sum(), max(1, int(1 / (PER_PERIOD * corner * period))))

    @property
    def _first(self) -> int:
        """Among filtered samples, of which only every few are computed, the first whose window is whole."""
        return -(-(len(self.weights) - 1) // self.every)

    def rows(self, count: int) -> npt.NDArray[np.int64]:
        """Samples of ``count`` in the middle of each window."""
        return np.arange(self._first * self.every, count, self.every) - len(self.weights) // 2

    def __call__(self, values: FloatArray) -> FloatArray:
        """Filter (T, …) along time."""
        if len(self.weights) == 1:
            return values
        wanted = slice(self._first, self._first + len(self.rows(len(values))))
        return np.asarray(scipy.signal.upfirdn(self.weights, values, down=self.every, axis=0)[wanted])

    def told(self, missing: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
        """Whether enough of each window was read, from (T, m) flags of missing readings."""
        return np.asarray(self(missing.astype(float)) < MISSING)
