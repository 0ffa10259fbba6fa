"""The whole-array particle filter in NumPy; derivatives by complex steps, exact."""

import numpy as np
from array_particle import EPSILON, READING, Draws, reading, step
from numpy.typing import NDArray

Array = NDArray[np.float64]


def run(y: Array, count: int, linearised: bool) -> Array:
    """Mean of the state (T, 10)."""
    rng = np.random.default_rng(0)
    x, log = np.zeros((count, 10)), np.full(count, -np.log(count))
    out = np.empty((len(y), 10))
    for at, readings in enumerate(y):
        draws = Draws(rng.standard_normal((count, 6)), rng.standard_normal((count, 4)), rng.random())
        x, log = step(np, slopes if linearised else None, x, log, readings, draws)
        out[at] = np.exp(log) @ x
    return out


def slopes(x: Array) -> Array:
    """Readings by the noise of the two accelerations (N, 4, 2)."""
    directions = 1j * EPSILON * np.eye(6)[:2]
    return np.stack([reading(np, x, np.tile(d, (len(x), 1))).imag / EPSILON for d in directions], axis=2)


def at_rest(samples: int) -> Array:
    """Readings (T, 4) of an arm that does not move."""
    noise = np.random.default_rng(1).standard_normal((samples, 4))
    return reading(np, np.zeros((1, 10)), np.zeros((1, 6))) + np.array(READING) * noise
