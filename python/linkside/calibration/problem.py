"""The posterior of a robot's free parameters, given recordings: value, gradient, information."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from linkside._core import Likelihood
from linkside.arrays import FloatArray
from linkside.errors import NumericalError
from linkside.kalman.noise import Noise
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.compile import unloaded
from linkside.robot.sensors import PayloadConfig

from .parameters import OF_LINK_ENCODERS, TORQUE_ONLY, CoreName, Parameter, catalogue
from .signals import noise_arrays, signals

HUBER = 4.0
"""Innovations beyond this many standard deviations count linearly."""

OF_SENSORS = (
    *("translation", "rotation", "bias", "scale", "time_constant", "delay", "sensor_noise"),
    *OF_LINK_ENCODERS,
    *TORQUE_ONLY,
)
"""Kinds that the motors' positions alone do not depend on."""

STATED = ("mass_scale", "payload_mass", "payload_xyz", "bias", "scale", "time_constant", "delay")
"""Kinds that the core takes as parameters even where they are not free."""


MOST = float(1 / np.finfo(np.float64).eps)
"""Information that a prior of one is lost beside: the derivatives of a filter that diverges grow without end."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What recordings say at one point, by the parameters' z; without the prior.

    All but `innovations` is of what the other sensors read, given the motors' positions.

    Attributes
    ----------
    log_likelihood : float
        Of all recordings, Huber's.
    gradient : (p,)
        Its gradient.
    information : (p, p)
        Fisher's information.
    used : int
        Readings.
    densities : list of (T,)
        Each sample's part of the log-likelihood, one array a recording, where asked for.
    scores : list of (T, p)
        Each sample's part of the gradient, likewise.
    innovations : list of (T, m)
        Normalised innovations, likewise.
    """

    log_likelihood: float
    gradient: FloatArray
    information: FloatArray
    used: int
    densities: list[FloatArray]
    scores: list[FloatArray]
    innovations: list[FloatArray]


class Problem:
    """Recordings of one robot and the parameters that are free.

    What is maximised is the density of what accelerometers (and motor torques) read, given what the motors' encoders
    read: ln p(θ, a) − ln p(θ). The encoders' own density must not count. With random jerk on the links, a soft spring
    makes p(θ) roll off with ω⁻² where a stiff one has ω⁻⁶; commanded motion is smoother than either, so that p(θ)
    favours "no spring" by thousands in log-likelihood on a smooth motion, whatever the spring is.

    Parameters
    ----------
    robot, logs
        The robot and its recordings.
    noise
        How uncertain everything else is.
    torque
        Whether motor torques are readings.
    free
        The free parameters.
    held
        Further parameters and the z that each is held at; all others are as in robot.yaml.
    """

    def __init__(
        self,
        robot: Robot,
        logs: Sequence[Log],
        noise: Noise,
        torque: bool,
        free: Sequence[Parameter],
        held: Sequence[tuple[Parameter, float]] = (),
    ) -> None:
        self.robot, self.logs, self.noise, self.torque = robot, list(logs), noise, torque
        self.free, self.held = tuple(free), tuple(held)
        base = bare(robot)
        self._cores = [self._core(base, log) for log in self.logs]
        alone = _blind(base)
        self._motors = [self._motors_alone(alone, log) for log in self.logs]

    def restricted(self, free: Sequence[Parameter]) -> Problem:
        """Give the same problem with other parameters free."""
        return Problem(self.robot, self.logs, self.noise, self.torque, free)

    def holding(self, at: Mapping[str, float], free: Sequence[Parameter]) -> Problem:
        """Give the same problem with only some of its parameters free, the others held at ``at``, their z by name."""
        held = [(p, at.get(p.name, 0.0)) for p in self.free if p not in free]
        return Problem(self.robot, self.logs, self.noise, self.torque, free, held)

    def on(self, logs: Sequence[Log]) -> Problem:
        """Give the same problem on other recordings."""
        return Problem(self.robot, logs, self.noise, self.torque, self.free)

    def alone(self, index: int, z: FloatArray) -> Problem:
        """Give the same problem on one of its recordings."""
        return self.on([self.logs[index]])

    def without(self, stretches: Sequence[Sequence[slice]]) -> Problem:
        """Give the same problem where stretches of each recording were not read, but for the motors' positions."""
        return self.on([_silenced(log, parts) for log, parts in zip(self.logs, stretches, strict=True)])

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in the order of `Evidence.innovations`."""
        log = self.logs[0]
        torques = log.columns("tau") if self.torque else ()
        return (*log.columns("theta"), *self.robot.acceleration_channels, *torques)

    def values(self, z: FloatArray) -> list[float]:
        """Physical values."""
        return [p.value(x) for p, x in zip(self.free, z, strict=True)]

    def evidence(self, z: FloatArray, detail: bool = False) -> Evidence:
        """Evaluate at one point; raises NumericalError where the filter breaks down."""
        names, values = [p.core for p in self.free], self.values(z)
        slopes = np.array([p.slope(x) for p, x in zip(self.free, z, strict=True)])
        seen = np.flatnonzero([p.kind not in OF_SENSORS for p in self.free])
        parts = [core.evaluate(names, values, detail) for core in self._cores]
        motors = [core.evaluate([names[i] for i in seen], [values[i] for i in seen], detail) for core in self._motors]
        gradient, information = sum(part["gradient"] for part in parts), sum(part["information"] for part in parts)
        gradient[seen] -= sum(part["gradient"] for part in motors)
        information[np.ix_(seen, seen)] -= sum(part["information"] for part in motors)
        for part, motor in zip(parts, motors, strict=True):
            part["scores"][:, seen] -= motor["scores"]
        return Evidence(
            log_likelihood=sum(p["log_likelihood"] - m["log_likelihood"] for p, m in zip(parts, motors, strict=True)),
            gradient=slopes * gradient,
            information=_positive(np.outer(slopes, slopes) * information),
            used=sum(p["used"] - m["used"] for p, m in zip(parts, motors, strict=True)),
            densities=[p["densities"] - m["densities"] for p, m in zip(parts, motors, strict=True)],
            scores=[part["scores"] * slopes for part in parts],
            innovations=[part["innovations"] for part in parts],
        )

    def log_likelihood(self, z: FloatArray) -> float:
        """Log-likelihood alone, without derivatives."""
        names, values = [p.core for p in self.free], self.values(z)
        seen = [i for i, p in enumerate(self.free) if p.kind not in OF_SENSORS]
        all_readings = sum(core.log_likelihood(names, values) for core in self._cores)
        motors = ([names[i] for i in seen], [values[i] for i in seen])
        return float(all_readings - sum(core.log_likelihood(*motors) for core in self._motors))

    @property
    def _estimated(self) -> tuple[Parameter, ...]:
        """Those that are not what robot.yaml says, free or held."""
        return (*self.free, *(p for p, _ in self.held))

    def _fixed(self) -> list[tuple[CoreName, float]]:
        free = self._estimated
        late = {p.core[1] for p in free if p.kind in ("time_constant", "delay")}
        late |= {i for i, s in enumerate(self.robot.accelerometers) if s.corner_frequency or s.delay}
        stated = [p for p in catalogue(self.robot, False) if p.kind in STATED and p.name not in {f.name for f in free}]
        held = [(p.core, p.value(z)) for p, z in self.held]
        return held + [(p.core, p.start) for p in stated if self._matters(p, late)]

    def _matters(self, parameter: Parameter, late: set[int]) -> bool:
        if parameter.kind == "time_constant":
            return bool(self.robot.accelerometers[parameter.core[1]].corner_frequency)
        return parameter.kind != "delay" or parameter.core[1] in late

    def _core(self, base: Robot, log: Log) -> Likelihood:
        free = {p.name for p in self._estimated}
        free_bias = [f"bias_{channel}" in free for channel in self.robot.acceleration_channels]
        noise: dict[str, Any] = noise_arrays(self.robot, log, self.noise, self.torque, free_bias)
        return _likelihood(base, signals(self.robot, log, self.torque), noise, self.torque, self._fixed())

    def _motors_alone(self, alone: Robot, log: Log) -> Likelihood:
        """The density of the motors' positions by themselves."""
        log = replace(log, acceleration=None)
        noise: dict[str, Any] = noise_arrays(alone, log, self.noise, False, [])
        fixed = [(name, value) for name, value in self._fixed() if name[0] not in OF_SENSORS]
        return _likelihood(alone, signals(alone, log, False), noise, False, fixed)


def _silenced(log: Log, stretches: Sequence[slice]) -> Log:
    def silenced(values: FloatArray | None) -> FloatArray | None:
        if values is None:
            return None
        out: FloatArray = values.copy()
        for part in stretches:
            out[part] = np.nan
        return out

    return replace(log, acceleration=silenced(log.acceleration), tau=silenced(log.tau))


def _likelihood(
    robot: Robot, arrays: dict[str, Any], noise: dict[str, Any], torque: bool, fixed: list[tuple[CoreName, float]]
) -> Likelihood:
    biased = [True] * len(noise["reading"])
    return Likelihood(robot.core, arrays, noise=noise, biased=biased, torque=torque, fixed=fixed, huber=HUBER)


def _blind(robot: Robot) -> Robot:
    """Take a robot's accelerometers off."""
    return Robot(robot.config.model_copy(update={"accelerometers": ()}), robot.tree)


def _positive(information: FloatArray) -> FloatArray:
    """Information without directions of negative curvature, which the difference of two samples' sums may have."""
    if not np.abs(information).max(initial=0.0) < MOST:
        raise NumericalError("calibration: the filter's derivatives diverge with these values; one of them is far off")
    values, vectors = np.linalg.eigh(information)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def bare(robot: Robot) -> Robot:
    """Take a robot's payload off, and the factors off its masses: they are parameters here."""
    joints = tuple(joint.model_copy(update={"mass_scale": 1.0}) for joint in robot.drives)
    return Robot(
        robot.config.model_copy(update={"joints": joints, "payload": PayloadConfig()}),
        unloaded(robot.tree, robot.config),
    )
