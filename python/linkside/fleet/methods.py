"""The methods that `linkside.fleet` and ``linkside estimate --with`` know: one entry each."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal, TypeAlias

from linkside.kalman.elastic_joint import (
    ElasticJointFilter,
    ElasticJointIteratedSmoother,
    ElasticJointSmoother,
    ElasticNoise,
)
from linkside.kalman.jerk_driven import (
    CubatureKalmanFilter,
    CubatureSmoother,
    ExtendedKalmanFilter,
    IteratedSmoother,
    RauchTungStriebelSmoother,
    UnscentedKalmanFilter,
    UnscentedSmoother,
)
from linkside.kalman.linearisation import Linearisation
from linkside.kalman.losses import Loss
from linkside.kalman.motor_jerk import MotorJerkFilter, MotorJerkNoise, MotorJerkSmoother
from linkside.kalman.noise import Noise
from linkside.kalman.stretches import smooth_pieces
from linkside.observers.poles import PolePattern, damped
from linkside.observers.tuning_file import ObserverTuning
from linkside.particle.filters import MarginalizedParticleFilter, ParticleFilter
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.velocity.observers import NicosiaTomeiObserver, ReducedOrderObserver

Run: TypeAlias = Callable[[Iterable[Log]], Iterator[Estimate]]
"""Estimates from the pieces of a log."""


@dataclass(frozen=True)
class Options:
    """Options of the methods; ``spill`` is a folder for what does not fit into memory."""

    poles: PolePattern = field(default_factory=lambda: damped(250.0))
    bias: bool = False
    form: Literal["current", "predictor"] = "current"
    tuning: Any = None
    gate: float | None = None
    link_disturbance: Literal["auto", "on", "off"] = "auto"
    loss: Loss = "squares"
    exclude_faulty: bool = False
    particles: int = 1000
    seed: int = 0
    gain: float = 100.0
    spill: Path = field(default_factory=lambda: Path(tempfile.gettempdir()))

    @property
    def of_filters(self) -> dict[str, Any]:
        """Settings of Kalman filters and smoothers."""
        disturbance = {"auto": "auto", "on": True, "off": False}[self.link_disturbance]
        settings = {"gate": self.gate, "link_disturbance": disturbance, "loss": self.loss}
        return settings | {"exclude_faulty": self.exclude_faulty}


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
    uneven
        Whether steps of time may be of any length.
    whole
        Whether it takes a log as one piece in any case; with ``exclude_faulty`` all that know it do.
    read_tuning
        Reads the file that ``--tuning`` names.
    """

    help: str
    takes: tuple[str, ...]
    build: Callable[[Robot, Options], Run]
    uneven: bool = True
    whole: bool = False
    read_tuning: Callable[[str], Any] = Noise.read


def _observer(robot: Robot, options: Options) -> Run:
    tuning = options.tuning or ObserverTuning()
    return tuning.observer(robot, options.poles, bias=options.bias, form=options.form).run_pieces


def _filter(method: type[ExtendedKalmanFilter], robot: Robot, options: Options) -> Run:
    return _in_pieces(method(robot, options.tuning, **options.of_filters), options)


def _in_pieces(method: ExtendedKalmanFilter | ElasticJointFilter | MotorJerkFilter, options: Options) -> Run:
    return partial(map, method.run) if options.exclude_faulty else method.run_pieces


def _smoother(method: type[RauchTungStriebelSmoother], robot: Robot, options: Options) -> Run:
    smoother = method(robot, options.tuning, **options.of_filters)
    return (
        partial(map, smoother.run) if options.exclude_faulty else partial(smooth_pieces, smoother, folder=options.spill)
    )


def _map(robot: Robot, options: Options) -> Run:
    return partial(map, IteratedSmoother(robot, options.tuning, **options.of_filters).run)


def _elastic_filter(linearisation: Linearisation, robot: Robot, options: Options) -> Run:
    settings = options.of_filters | {"linearisation": linearisation}
    return _in_pieces(ElasticJointFilter(robot, options.tuning, **settings), options)


def _elastic_smoother(linearisation: Linearisation, robot: Robot, options: Options) -> Run:
    settings = options.of_filters | {"linearisation": linearisation}
    return partial(map, ElasticJointSmoother(robot, options.tuning, **settings).run)


def _elastic_map(robot: Robot, options: Options) -> Run:
    return partial(map, ElasticJointIteratedSmoother(robot, options.tuning, **options.of_filters).run)


def _motor_filter(robot: Robot, options: Options) -> Run:
    return _in_pieces(MotorJerkFilter(robot, options.tuning, **options.of_filters), options)


def _motor_smoother(robot: Robot, options: Options) -> Run:
    return partial(map, MotorJerkSmoother(robot, options.tuning, **options.of_filters).run)


def _particle(method: type[ParticleFilter], robot: Robot, options: Options) -> Run:
    return method(robot, options.tuning, particles=options.particles, seed=options.seed).run_pieces


def _velocity(method: type[ReducedOrderObserver], robot: Robot, options: Options) -> Run:
    return method(robot, options.gain).run_pieces


OF_FILTERS = ("tuning", "gate", "link_disturbance", "loss", "exclude_faulty")
"""Options of Kalman filters and smoothers."""

METHODS = {
    "observer": Method(
        "driven by accelerometers; needs no link dynamics",
        ("poles", "bias", "form", "tuning"),
        _observer,
        uneven=False,
        read_tuning=ObserverTuning.read,
    ),
    "ekf": Method(
        "Kalman filter with link dynamics and standard deviations", OF_FILTERS, partial(_filter, ExtendedKalmanFilter)
    ),
    "ukf": Method("ekf with sigma points in place of derivatives", OF_FILTERS, partial(_filter, UnscentedKalmanFilter)),
    "ckf": Method("ukf without the central point", OF_FILTERS, partial(_filter, CubatureKalmanFilter)),
    "smoother": Method(
        "as ekf, but each row from all samples, later ones too",
        OF_FILTERS,
        partial(_smoother, RauchTungStriebelSmoother),
    ),
    "ukf-smoother": Method(
        "smoother with sigma points in place of derivatives", OF_FILTERS, partial(_smoother, UnscentedSmoother)
    ),
    "ckf-smoother": Method("ukf-smoother without the central point", OF_FILTERS, partial(_smoother, CubatureSmoother)),
    "map": Method(
        "the most probable motion, found by iterations of smoother; --loss huber or student-t for outliers",
        OF_FILTERS,
        _map,
        whole=True,
    ),
    "elastic-ekf": Method(
        "Kalman filter on the elastic-joint dynamics, driven by the motor torques; needs no accelerometer",
        OF_FILTERS,
        partial(_elastic_filter, "derivatives"),
        read_tuning=ElasticNoise.read,
    ),
    "elastic-ukf": Method(
        "elastic-ekf with sigma points in place of derivatives",
        OF_FILTERS,
        partial(_elastic_filter, "unscented"),
        read_tuning=ElasticNoise.read,
    ),
    "elastic-ckf": Method(
        "elastic-ukf without the central point",
        OF_FILTERS,
        partial(_elastic_filter, "cubature"),
        read_tuning=ElasticNoise.read,
    ),
    "elastic-smoother": Method(
        "as elastic-ekf, but each row from all samples, later ones too",
        OF_FILTERS,
        partial(_elastic_smoother, "derivatives"),
        whole=True,
        read_tuning=ElasticNoise.read,
    ),
    "elastic-ukf-smoother": Method(
        "elastic-smoother with sigma points in place of derivatives",
        OF_FILTERS,
        partial(_elastic_smoother, "unscented"),
        whole=True,
        read_tuning=ElasticNoise.read,
    ),
    "elastic-ckf-smoother": Method(
        "elastic-ukf-smoother without the central point",
        OF_FILTERS,
        partial(_elastic_smoother, "cubature"),
        whole=True,
        read_tuning=ElasticNoise.read,
    ),
    "elastic-map": Method(
        "the most probable motion on the elastic-joint dynamics",
        OF_FILTERS,
        _elastic_map,
        whole=True,
        read_tuning=ElasticNoise.read,
    ),
    "motor-ekf": Method(
        "Kalman filter on the elastic-joint dynamics, motors moving as measured; needs no motor torque",
        OF_FILTERS,
        _motor_filter,
        read_tuning=MotorJerkNoise.read,
    ),
    "motor-smoother": Method(
        "motor-ekf using all samples, later ones included",
        OF_FILTERS,
        _motor_smoother,
        whole=True,
        read_tuning=MotorJerkNoise.read,
    ),
    "particle": Method(
        "particle filter, weighted samples of the state",
        ("tuning", "particles", "seed"),
        partial(_particle, ParticleFilter),
    ),
    "marginalized": Method(
        "as particle, with biases computed in closed form",
        ("tuning", "particles", "seed"),
        partial(_particle, MarginalizedParticleFilter),
    ),
    "reduced-order": Method(
        "velocities from motor positions and torques, with joints assumed rigid",
        ("gain",),
        partial(_velocity, ReducedOrderObserver),
        uneven=False,
    ),
    "nicosia-tomei": Method(
        "as reduced-order, with a spring on the position error",
        ("gain",),
        partial(_velocity, NicosiaTomeiObserver),
        uneven=False,
    ),
}
