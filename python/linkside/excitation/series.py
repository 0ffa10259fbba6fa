"""Finite Fourier series that begin and end at rest: the motions of an excitation."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from linkside.arrays import FloatArray

TERMS = 6
"""Number of frequencies of a series, a sine and a cosine each."""

DERIVATIVES = 3
"""Of the position, as many vanish at both ends: no jump of the acceleration, nor of the jerk."""

PER_PERIOD = 32
"""Samples in a period of the highest frequency by which a series is bounded."""


class FourierSeries:
    """Functions of time that span all Fourier series of some frequencies with rest at both ends.

    As in J. Swevers et al., "Optimal robot excitation and identification", IEEE Transactions on Robotics and Automation
    13(5), 1997, with the rest of K.-J. Park, "Fourier-based optimal excitation trajectories for the dynamic
    identification of robots", Robotica 24(5), 2006. Frequencies are spaced evenly on a logarithmic scale.

    Parameters
    ----------
    duration
        Of the motion, a period of its slowest part [s].
    bandwidth
        The highest frequency [Hz].

    Attributes
    ----------
    size : int
        Number of functions.
    """

    def __init__(self, duration: float, bandwidth: float) -> None:
        self.duration, self.highest = duration, int(bandwidth * duration)
        turns = np.unique(np.geomspace(1, self.highest, TERMS).round())
        self._omega = 2 * np.pi * turns / duration
        # At t = 0, of cosines the even derivatives are not zero, of sines the odd ones. Coefficients are counted in
        # equal shares of what moves links and springs, ω^1.5, so that a direction at random has all frequencies.
        self._weight = (self._omega / self._omega[0]) ** -1.5
        orders = np.arange(1, DERIVATIVES + 1)[:, None]
        slopes = (self._omega / self._omega[0]) ** orders * self._weight
        rows = np.hstack([slopes * (orders % 2 == 0), slopes * (orders % 2 == 1)])
        self._null = scipy.linalg.null_space(rows)
        self.size = self._null.shape[1]

    def __call__(self, t: FloatArray, x: FloatArray) -> FloatArray:
        """Position less that at the ends, velocity and acceleration at ``t`` (T,), for ``x`` (size, n): (3, T, n)."""
        a, b = np.split(self._null @ x, 2)
        a, b = a * self._weight[:, None], b * self._weight[:, None]
        phase = np.outer(t, self._omega)
        cos, sin, w = np.cos(phase), np.sin(phase), self._omega[:, None]
        position = (cos - 1) @ a + sin @ b
        return np.array([position, cos @ (w * b) - sin @ (w * a), -cos @ (w**2 * a) - sin @ (w**2 * b)])

    def bounds(self, x: FloatArray) -> FloatArray:
        """Give what position, velocity and acceleration never exceed, (3, n).

        A trigonometric polynomial of degree K is at most 1 / cos(π K / N) times as large as at N evenly spaced points
        (H. Ehlich and K. Zeller, Mathematische Zeitschrift 86, 1964).
        """
        count = PER_PERIOD * self.highest
        t = self.duration * np.arange(count) / count
        return np.asarray(np.abs(self(t, x)).max(axis=1) / np.cos(np.pi / PER_PERIOD))
