"""Particle filters beside whole arrays in NumPy and JAX: two joints, N = 1000, time for a particle and step.

The package `particles` is not beside them: it needs NumPy 1, and cannot be installed where JAX is.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module

import numpy as np
from array_particle import READING, reading
from kalman import load
from timing import Result, microseconds

from linkside import MarginalizedParticleFilter, ParticleFilter

COUNT = 1000
MANY = 10_000
SAMPLES = 400
MOST = {"linearised": 100, "bootstrap": 25}
PEERS = {"NumPy": "numpy_particle", "JAX": "jax_particle"}
"""What has to be installed, and the file that uses it; each has `run(readings, count, linearised)`."""


def bench() -> Iterator[Result]:
    """The linearised and the bootstrap proposal; in thousands, so that µs are ns a particle."""
    for proposal, most in MOST.items():
        peers = dict(against(proposal == "linearised"))
        for method in (ParticleFilter, MarginalizedParticleFilter):
            ours = timed(method, proposal, COUNT)
            for name, theirs in peers.items():
                yield Result(f"{method.__name__}, {proposal}, {COUNT}", ours, name, theirs, most=most)
    one, two = (in_process(threads) for threads in (1, 2))
    yield Result(f"ParticleFilter, linearised, {MANY}, two threads", two, "one thread", one, least_ratio=1.7)


def timed(method: type[ParticleFilter], proposal: str, count: int) -> float:
    """A step."""
    robot, log, noise = load("arm2_square", axes="xz")
    kernel = 0.5 if proposal == "linearised" else None
    estimator = method(robot, noise, particles=count, proposal=proposal, kernel=kernel)
    samples = SAMPLES * COUNT // count
    return microseconds(lambda: estimator.run(log[:samples]), samples, repeats=5)


def in_process(threads: int) -> float:
    """A step of many particles, in a process of its own: threads are chosen where it starts."""
    environment = os.environ | {"RAYON_NUM_THREADS": str(threads)}
    done = subprocess.run([sys.executable, __file__], env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def against(linearised: bool) -> Iterator[tuple[str, float | None]]:
    """A step of each peer, on the readings of an arm at rest."""
    noise = np.random.default_rng(1).standard_normal((SAMPLES, 4))
    y = reading(np, np.zeros((1, 10)), np.zeros((1, 6))) + np.array(READING) * noise
    for name, file in PEERS.items():
        try:
            run = import_module(file).run
        except ImportError as error:
            yield f"{error.name} is not installed", None
        else:
            yield name, microseconds(lambda run=run: run(y, COUNT, linearised), SAMPLES, repeats=3)


if __name__ == "__main__":
    print(timed(ParticleFilter, "linearised", MANY))
