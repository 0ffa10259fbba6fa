"""Ready-made patterns of poles for an observer's error dynamics.

A pattern gives as many poles as a joint's model has states: four for an elastic joint, five with a bias
state, three for a rigid one.

>>> damped(250).poles(4).round(3)
array([-225. +108.972j, -225. -108.972j, -187.5+165.359j, -187.5-165.359j])
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside.errors import EstimatorError

ComplexArray = npt.NDArray[np.complex128]


@dataclass(frozen=True)
class PolePattern:
    """Poles of any order around one frequency; make one by `damped`, `bessel` or `butterworth`."""

    name: str
    frequency: float
    _unit: Callable[[int], ComplexArray] = field(repr=False)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.frequency) and self.frequency > 0):
            raise EstimatorError(f"poles: frequency is {self.frequency}, expected a positive number of rad/s")

    def poles(self, order: int) -> ComplexArray:
        """Give ``order`` poles [1/s]."""
        return self.frequency * self._unit(order)


def damped(frequency: float, damping: Sequence[float] = (0.9, 0.75)) -> PolePattern:
    """Complex pairs -ω(ζ ± j√(1-ζ²)), one for each damping, and a real pole at -ω where the order is odd.

    "Well damped, about 250 rad/s" is what De Luca, Schröder and Thümmel (2007) used.

    Parameters
    ----------
    frequency
        ω [rad/s].
    damping
        ζ of each pair, in (0, 1].
    """
    if not all(0 < z <= 1 for z in damping) or not damping:
        raise EstimatorError(f"poles: damping is {tuple(damping)}, expected numbers above 0 and up to 1")

    def unit(order: int) -> ComplexArray:
        zetas = np.resize(np.asarray(damping, float), order // 2)
        upper = -zetas + 1j * np.sqrt(1 - zetas**2)
        pairs = np.stack([upper, upper.conj()], axis=1).ravel()
        return np.concatenate([pairs, -np.ones(order % 2)])

    return PolePattern("damped", frequency, unit)


def bessel(frequency: float) -> PolePattern:
    """Bessel's poles: the smoothest step response, with hardly any overshoot; ``frequency`` ω [rad/s]."""
    return PolePattern("bessel", frequency, lambda order: _signal().besselap(order, norm="mag")[1])


def butterworth(frequency: float) -> PolePattern:
    """Butterworth's poles: the flattest response up to ``frequency`` ω [rad/s]."""
    return PolePattern("butterworth", frequency, lambda order: _signal().buttap(order)[1])


def _signal() -> Any:
    """Load SciPy's filters on demand, because importing them is slow."""
    import scipy.signal

    return scipy.signal
