"""A particle filter as one would write it with whole arrays, for NumPy and for JAX: `step` knows neither.

The state (N, 10) is q, q̇, q̈ of two joints and the biases of four readings; the noise (N, 6) enters q̈ and the biases.
The linearised proposal draws in noise space with perturbed observations, so that only 4 by 4 matrices are solved.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

DT = 5e-4
EPSILON = 1e-20
NOISE = (0.3, 0.3, 1e-8, 1e-8, 2e-5, 2e-5)
READING = (2e-6, 2e-6, 5e-2, 5e-2)


class Draws(NamedTuple):
    """Standard normal numbers of a step for the noise (N, 6) and the readings (N, 4), and a uniform one."""

    noise: Any
    reading: Any
    uniform: Any


def step(xp: Any, slopes: Callable[..., Any] | None, x: Any, log: Any, y: Any, draws: Draws) -> tuple[Any, Any]:
    """States (N, 10) and log weights (N) after readings y (4); the bootstrap proposal without `slopes`."""
    std, noise_std = xp.asarray(READING), xp.asarray(NOISE)
    w = noise_std * draws.noise
    if slopes is not None:
        error = y - reading(xp, x, xp.zeros_like(w))
        jacobian = xp.concatenate([slopes(x), xp.broadcast_to(xp.eye(4), (len(x), 4, 4))], axis=2)
        cross = noise_std**2 * jacobian
        solve = xp.linalg.inv(cross @ jacobian.swapaxes(1, 2) + xp.diag(std**2))
        gain = cross.swapaxes(1, 2) @ solve
        apart = error - times(xp, jacobian, w) - std * draws.reading
        w, mean = w + times(xp, gain, apart), times(xp, gain, error)
        log = log + 0.5 * xp.linalg.slogdet(solve)[1] - 0.5 * ((w / noise_std) ** 2).sum(axis=1)
        departure = w - mean
        spread = (departure / noise_std) ** 2
        log = log + 0.5 * (spread.sum(axis=1) + ((times(xp, jacobian, departure) / std) ** 2).sum(axis=1))
    log = log - 0.5 * (((y - reading(xp, x, w)) / std) ** 2).sum(axis=1)
    return resample(xp, xp.concatenate(moved(x, w), axis=1), log, draws.uniform)


def resample(xp: Any, x: Any, log: Any, uniform: Any) -> tuple[Any, Any]:
    """Systematically, where the effective number of particles is below a half."""
    count = len(log)
    log = log - log.max()
    log = log - xp.log(xp.exp(log).sum())
    weights = xp.exp(log)
    low = 1 / (weights**2).sum() < count / 2
    if xp.__name__ == "numpy" and not low:
        return x, log
    chosen = xp.searchsorted(xp.cumsum(weights), (xp.arange(count) + uniform) / count).clip(0, count - 1)
    return xp.where(low, x[chosen], x), xp.where(low, -xp.log(count), log)


def moved(x: Any, w: Any) -> tuple[Any, Any, Any, Any]:
    """q, q̇, q̈ and biases a step later."""
    q, dq, ddq = x[:, :2], x[:, 2:4], x[:, 4:6] + w[:, :2]
    return q + DT * dq + DT * DT / 2 * ddq, dq + DT * ddq, ddq, x[:, 6:] + w[:, 2:]


def reading(xp: Any, x: Any, w: Any) -> Any:
    """Motor positions and an accelerometer of a two-link arm of round figures (N, 4)."""
    q, dq, ddq, bias = moved(x, w)
    q1, q2, rate1, rate, turn = q[:, 0], q[:, 1], dq[:, 0], dq.sum(axis=1), ddq.sum(axis=1)
    sin1, sin2, sin12, cos1, cos2, cos12 = (f(a) for f in (xp.sin, xp.cos) for a in (q1, q2, q1 + q2))
    coupling = 30 + 40 * cos2
    torque1 = (90 + 80 * cos2) * ddq[:, 0] + coupling * ddq[:, 1] - 40 * sin2 * (rate**2 - rate1**2)
    torque2 = coupling * ddq[:, 0] + 30 * ddq[:, 1] + 40 * sin2 * rate1**2
    gravity2 = 400 * cos12
    motor1 = q1 + (torque1 + gravity2 + 1200 * cos1) / 4e5
    motor2 = q2 + (torque2 + gravity2) / 1.5e5
    along = -sin1 * ddq[:, 0] - cos1 * rate1**2 - sin12 * turn - cos12 * rate**2
    up = cos1 * ddq[:, 0] - sin1 * rate1**2 + cos12 * turn - sin12 * rate**2 + 9.81
    return xp.stack([motor1, motor2, cos12 * along + sin12 * up, cos12 * up - sin12 * along], axis=1) + bias


def times(xp: Any, matrices: Any, vectors: Any) -> Any:
    """A product for each particle."""
    return xp.einsum("nij,nj->ni", matrices, vectors)
