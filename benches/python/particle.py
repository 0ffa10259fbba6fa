"""Particle filters beside whole arrays in NumPy and JAX, and `particles`: two joints, N = 1000, a particle and step.

The package `particles` needs NumPy 1, and cannot be installed where JAX is: it gets an environment of its own. Its
matrices are small; with more than one thread of BLAS it takes several times as long.
"""

import os
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

from kalman import load
from numpy_particle import at_rest
from own_environment import interpreter
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
    estimator = method(robot, noise, particles=count, proposal=proposal, kernel=kernel, start="rest", tolerances=False)
    samples = SAMPLES * COUNT // count
    return microseconds(lambda: estimator.run(log[:samples]), samples, repeats=5)


def in_process(threads: int) -> float:
    """A step of many particles, in a process of its own: threads are chosen where it starts."""
    environment = os.environ | {"RAYON_NUM_THREADS": str(threads)}
    done = subprocess.run([sys.executable, __file__], env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout)


def against(linearised: bool) -> Iterator[tuple[str, float | None]]:
    """A step of each peer, on the readings of an arm at rest."""
    y = at_rest(SAMPLES)
    for name, file in PEERS.items():
        try:
            run = import_module(file).run
        except ImportError as error:
            yield f"{error.name} is not installed", None
        else:
            yield name, microseconds(lambda run=run: run(y, COUNT, linearised), SAMPLES, repeats=3)
    yield in_own_environment(linearised)


def in_own_environment(linearised: bool) -> tuple[str, float | None]:
    """A step of the package `particles`."""
    python = interpreter("particles", "particles==0.4", "numpy<2")
    if python is None:
        return "particles is not installed", None
    command = [python, Path(__file__).with_name("particles_peer.py"), str(COUNT), *["--linearised"] * linearised]
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    return "particles", float(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)


if __name__ == "__main__":
    print(timed(ParticleFilter, "linearised", MANY))
