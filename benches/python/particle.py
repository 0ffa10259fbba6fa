"""Particle filters beside vectorised NumPy: two joints, N = 1000, time for a particle and step."""

from collections.abc import Iterator

import numpy as np
from kalman import load
from timing import Result, microseconds

from linkside import MarginalizedParticleFilter, ParticleFilter

COUNT = 1000
SAMPLES = 400


def bench() -> Iterator[Result]:
    """The linearised and the bootstrap proposal; in thousands, so that µs are ns a particle."""
    robot, log, noise = load("arm2_square", axes="xz")
    log = log[:SAMPLES]
    peer = numpy_bootstrap(SAMPLES)
    for name, proposal, most in (("linearised", "linearised", 100), ("bootstrap", "bootstrap", 25)):
        for method in (ParticleFilter, MarginalizedParticleFilter):
            kernel = 0.5 if proposal == "linearised" else None
            estimator = method(robot, noise, particles=COUNT, proposal=proposal, kernel=kernel)
            time = microseconds(lambda e=estimator: e.run(log), SAMPLES, repeats=5)
            what = f"{method.__name__}, {name}, a step of {COUNT}"
            least = {"peer": "NumPy, bootstrap", "theirs": peer} if proposal == "bootstrap" else {}
            yield Result(what, time, most=most, **least)


def numpy_bootstrap(samples: int) -> float:
    """The same bootstrap step on a two-link arm, written with whole arrays."""
    rng = np.random.default_rng(0)
    x = 1e-3 * rng.standard_normal((COUNT, 10))
    weights = np.full(COUNT, 1 / COUNT)
    dt, std = 5e-4, np.array([0.3, 0.3, 1e-8, 1e-8, 2e-5, 2e-5])

    def run() -> None:
        nonlocal x, weights
        for _ in range(samples):
            noise = std * rng.standard_normal((COUNT, 6))
            q, dq, ddq = x[:, :2], x[:, 2:4], x[:, 4:6] + noise[:, :2]
            q, dq = q + dt * dq + dt * dt / 2 * ddq, dq + dt * ddq
            bias = x[:, 6:] + noise[:, 2:]
            x = np.hstack([q, dq, ddq, bias])
            error = two_link(q, dq, ddq) + bias
            log = np.log(weights) - 0.5 * (error**2 / 1e2).sum(axis=1)
            weights = np.exp(log - log.max())
            weights /= weights.sum()
            if 1 / (weights**2).sum() < COUNT / 2:
                chosen = np.searchsorted(np.cumsum(weights), (np.arange(COUNT) + rng.random()) / COUNT)
                x, weights = x[np.minimum(chosen, COUNT - 1)], np.full(COUNT, 1 / COUNT)

    return microseconds(run, samples, repeats=3)


def two_link(q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
    """Motor positions and an accelerometer of a two-link arm of round figures (N, 4)."""
    (sin1, sin2), (cos1, cos2), both = np.sin(q).T, np.cos(q).T, q.sum(axis=1)
    sin12, cos12, rate, turn = np.sin(both), np.cos(both), dq.sum(axis=1), ddq.sum(axis=1)
    coupling = 30 + 40 * cos2
    torque1 = (90 + 80 * cos2) * ddq[:, 0] + coupling * ddq[:, 1] - 40 * sin2 * (rate**2 - dq[:, 0] ** 2)
    torque2 = coupling * ddq[:, 0] + 30 * ddq[:, 1] + 40 * sin2 * dq[:, 0] ** 2
    gravity2 = 400 * cos12
    motor1 = q[:, 0] + (torque1 + gravity2 + 1200 * cos1) / 4e5
    motor2 = q[:, 1] + (torque2 + gravity2) / 1.5e5
    x = -sin1 * ddq[:, 0] - cos1 * dq[:, 0] ** 2 - sin12 * turn - cos12 * rate**2
    z = cos1 * ddq[:, 0] - sin1 * dq[:, 0] ** 2 + cos12 * turn - sin12 * rate**2 + 9.81
    return np.stack([motor1, motor2, cos12 * x + sin12 * z, cos12 * z - sin12 * x], axis=1)
