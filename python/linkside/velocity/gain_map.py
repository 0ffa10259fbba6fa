"""Gains of the reduced-order observer that depend on the posture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError


@dataclass(frozen=True, eq=False)
class GainMap:
    """A map of positions y whose derivative is the gain: ``k(y) = P y + sum of a sin(m·y) + b cos(m·y)``.

    Cristofaro and De Luca, "Reduced-order observer design for robot manipulators", 2023, Section 3.2. Every such gain
    is a Jacobian, so the observer uses differences of the map and needs no velocity. `linkside.velocity.shaped_gain`
    designs them.

    Attributes
    ----------
    linear : (n, n)
        P [1/s].
    waves : (H, n)
        m: whole numbers for revolute joints, so that a turn changes no gain; 0 for prismatic ones.
    sine, cosine : (H, n)
        a and b [1/s].
    """

    linear: FloatArray
    waves: FloatArray
    sine: FloatArray
    cosine: FloatArray

    def __post_init__(self) -> None:
        n, waves = len(self.linear), np.shape(self.waves)
        for name, expected in {"linear": (n, n), "waves": (*waves[:1], n), "sine": waves, "cosine": waves}.items():
            given = np.array(getattr(self, name), np.float64)
            if given.shape != expected:
                raise EstimatorError(f"{name} of a gain map has the shape {given.shape}, expected {expected}")
            given.setflags(write=False)
            object.__setattr__(self, name, given)

    @classmethod
    def constant(cls, gain: FloatArray) -> GainMap:
        """Give the map of a constant matrix (n, n) [1/s]."""
        none = np.zeros((0, len(gain)))
        return cls(gain, none, none, none)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.linear)

    def __call__(self, q: FloatArray) -> FloatArray:
        """Give k (T, n) at positions (T, n)."""
        phase = q @ self.waves.T
        return np.asarray(q @ self.linear.T + np.sin(phase) @ self.sine + np.cos(phase) @ self.cosine)

    def jacobian(self, q: FloatArray) -> FloatArray:
        """Give the gain ∂k/∂y (T, n, n) at positions (T, n) [1/s]."""
        phase = q @ self.waves.T
        slope = np.cos(phase)[..., None] * self.sine - np.sin(phase)[..., None] * self.cosine
        return np.asarray(self.linear + np.einsum("...hi,hj->...ij", slope, self.waves))

    def __mul__(self, factor: float) -> GainMap:
        """Scale the gain."""
        return GainMap(factor * self.linear, self.waves, factor * self.sine, factor * self.cosine)

    def settings(self) -> dict[str, Any]:
        """Give all coefficients, row by row."""
        return {name: getattr(self, name).ravel().tolist() for name in ("linear", "waves", "sine", "cosine")}
