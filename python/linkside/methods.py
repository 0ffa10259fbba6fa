"""The methods that ``linkside estimate --with`` knows: one entry each."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeAlias

from .estimate import Estimate
from .kalman import ExtendedKalmanFilter, RauchTungStriebelSmoother
from .log import Log
from .noise import Noise
from .observers import AccelerationObserver
from .particle import MarginalizedParticleFilter, ParticleFilter
from .poles import PolePattern
from .robot import Robot
from .sensing import is_late
from .stretches import smooth_pieces

Run: TypeAlias = Callable[[Iterable[Log]], Iterator[Estimate]]
"""Estimates from the pieces of a log."""


@dataclass(frozen=True)
class Options:
    """What the command line says about a method."""

    poles: PolePattern
    bias: bool
    form: Literal["current", "predictor"]
    tuning: Noise | None
    gate: float | None
    particles: int
    seed: int


@dataclass(frozen=True)
class Method:
    """A way to estimate.

    Attributes
    ----------
    help : str
        A line of help.
    takes : tuple of str
        The options that it looks at.
    build
        Makes it for a robot.
    whole
        Whether it takes a log as one piece, for a robot.
    """

    help: str
    takes: tuple[str, ...]
    build: Callable[[Robot, Options], Run]
    whole: Callable[[Robot], bool] = lambda _: False


def _observer(robot: Robot, options: Options) -> Run:
    return AccelerationObserver(robot, options.poles, bias=options.bias, form=options.form).run_pieces


def _ekf(robot: Robot, options: Options) -> Run:
    ekf = ExtendedKalmanFilter(robot, options.tuning, gate=options.gate)
    return partial(map, ekf.run) if is_late(robot) else ekf.run_pieces


def _smoother(robot: Robot, options: Options) -> Run:
    smoother = RauchTungStriebelSmoother(robot, options.tuning, gate=options.gate)
    return partial(map, smoother.run) if is_late(robot) else partial(smooth_pieces, smoother)


def _particle(method: type[ParticleFilter], robot: Robot, options: Options) -> Run:
    return method(robot, options.tuning, particles=options.particles, seed=options.seed).run_pieces


METHODS = {
    "observer": Method(
        "driven by accelerometers; nothing of the links' dynamics is needed", ("poles", "bias", "form"), _observer
    ),
    "ekf": Method("Kalman filter with the links' dynamics, and how sure it is", ("tuning", "gate"), _ekf, is_late),
    "smoother": Method("the same by all samples, later ones too", ("tuning", "gate"), _smoother, is_late),
    "particle": Method(
        "weighted samples of the state", ("tuning", "particles", "seed"), partial(_particle, ParticleFilter)
    ),
    "marginalized": Method(
        "the same, biases in closed form",
        ("tuning", "particles", "seed"),
        partial(_particle, MarginalizedParticleFilter),
    ),
}
