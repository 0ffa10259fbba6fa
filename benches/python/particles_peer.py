"""The particle filter as one would write it with the package `particles`, which needs NumPy 1.

python particles_peer.py COUNT [--linearised]    prints the time of a step [µs]
"""

import argparse
from typing import Any

import numpy as np
import particles
from array_particle import NOISE, READING, moved, reading
from numpy.typing import NDArray
from numpy_particle import at_rest, slopes
from particles import distributions, state_space_models
from particles.collectors import Moments
from timing import microseconds

Array = NDArray[np.float64]

SAMPLES = 400
REST = np.zeros((1, 10))


class Motion(distributions.ProbDist):
    """Where a particle goes, by the noise that takes it there: noise enters six of ten entries of the state."""

    dim = 10

    def __init__(self, before: Array, noise: Any) -> None:
        self.before, self.noise = before, noise

    def rvs(self, size: int | None = None) -> Array:
        """States."""
        return np.concatenate(moved(self.before, self.noise.rvs(size)), axis=1)

    def logpdf(self, x: Array) -> Array:
        """Of states that the noise can lead to."""
        density: Array = self.noise.logpdf(noise_between(self.before, x))
        return density


class Arm(state_space_models.StateSpaceModel):
    """Two joints; the names are those of the package."""

    def PX0(self) -> Motion:
        """First states."""
        return self.PX(0, REST)

    def PX(self, t: int, xp: Array) -> Motion:
        """Next states."""
        return Motion(xp, normal(np.zeros(6), NOISE))

    def PY(self, t: int, xp: Array | None, x: Array) -> Any:
        """Readings."""
        before = REST if xp is None else xp
        return normal(reading(np, before, noise_between(before, x)).T, READING)

    def proposal0(self, data: Array) -> Motion:
        """First states, the readings known."""
        return self.PX0()

    def proposal(self, t: int, xp: Array, data: Array) -> Motion:
        """Next states, the readings known and linearised."""
        std = np.array(NOISE)
        rest = np.zeros((len(xp), 6))
        error = (data[t] - reading(np, xp, rest)) / READING
        identity = np.broadcast_to(np.eye(4), (len(xp), 4, 4))
        slope = np.concatenate([slopes(xp), identity], axis=2) * std / np.array(READING)[:, None]
        covariance = np.linalg.inv(np.eye(6) + slope.swapaxes(1, 2) @ slope)
        mean = np.einsum("nij,nkj,nk->ni", covariance, slope, error, optimize=True)
        return Motion(xp, distributions.VaryingCovNormal(loc=std * mean, cov=covariance * np.outer(std, std)))


def normal(means: Array, stds: tuple[float, ...]) -> Any:
    """Independent entries."""
    each = (distributions.Normal(loc=mean, scale=std) for mean, std in zip(means, stds, strict=True))
    return distributions.IndepProd(*each)


def noise_between(before: Array, after: Array) -> Array:
    """What noise (N, 6) led from one to the other."""
    return after[:, 4:] - before[:, 4:]


def run(y: Array, count: int, linearised: bool) -> Any:
    """Means and variances of the state at each step."""
    filters = state_space_models.GuidedPF if linearised else state_space_models.Bootstrap
    model = filters(ssm=Arm(), data=y)
    smc = particles.SMC(fk=model, N=count, resampling="systematic", ESSrmin=0.5, collect=[Moments()])
    smc.run()
    return smc.summaries.moments


def main() -> None:
    """Time it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", type=int)
    parser.add_argument("--linearised", action="store_true")
    options = parser.parse_args()
    y = at_rest(SAMPLES)
    print(microseconds(lambda: run(y, options.count, options.linearised), SAMPLES, repeats=1))


if __name__ == "__main__":
    main()
