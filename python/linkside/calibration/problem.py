"""What recordings say of a robot's parameters, and how probable they are to a Kalman filter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from linkside._core import Likelihood
from linkside.arrays import FloatArray
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


@dataclass(frozen=True, eq=False)
class Evidence:
    """What recordings say at one point, by the parameters' z; without the prior.

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
    """How probable recordings are to a Kalman filter on the jerk-driven model.

    It is the density of what accelerometers read, given what the motors' encoders read: ln p(θ, a) − ln p(θ). The
    encoders' own density must not count. With random jerk on the links, a soft spring makes p(θ) roll off with ω⁻²
    where a stiff one has ω⁻⁶; commanded motion is smoother than either, so that p(θ) favours "no spring" by thousands
    in log-likelihood on a smooth motion, whatever the spring is.

    Parameters
    ----------
    robot, logs
        The robot and its recordings.
    noise
        How uncertain everything else is.
    free
        Parameters that are not as in robot.yaml.
    """

    def __init__(self, robot: Robot, logs: Sequence[Log], noise: Noise, free: Sequence[Parameter]) -> None:
        self.robot, self.noise, self.free = robot, noise, tuple(free)
        base = bare(robot)
        alone = _blind(base)
        self._cores = [self._core(base, log) for log in logs]
        self._motors = [self._motors_alone(alone, log) for log in logs]

    def log_likelihood(self, z: FloatArray) -> float:
        """Log-likelihood where the parameters have these values, in tolerances."""
        at = [(p.core, p.value(x)) for p, x in zip(self.free, z, strict=True)]
        seen = [(name, value) for name, value in at if name[0] not in OF_SENSORS]
        everything = sum(core.log_likelihood(*_split(at)) for core in self._cores)
        return float(everything - sum(core.log_likelihood(*_split(seen)) for core in self._motors))

    def _fixed(self) -> list[tuple[CoreName, float]]:
        late = {p.core[1] for p in self.free if p.kind in ("time_constant", "delay")}
        late |= {i for i, s in enumerate(self.robot.accelerometers) if s.corner_frequency or s.delay}
        free = {p.name for p in self.free}
        stated = [p for p in catalogue(self.robot, False) if p.kind in STATED and p.name not in free]
        return [(p.core, p.start) for p in stated if self._matters(p, late)]

    def _matters(self, parameter: Parameter, late: set[int]) -> bool:
        if parameter.kind == "time_constant":
            return bool(self.robot.accelerometers[parameter.core[1]].corner_frequency)
        return parameter.kind != "delay" or parameter.core[1] in late

    def _core(self, base: Robot, log: Log) -> Likelihood:
        free = {p.name for p in self.free}
        free_bias = [f"bias_{channel}" in free for channel in self.robot.acceleration_channels]
        noise: dict[str, Any] = noise_arrays(self.robot, log, self.noise, free_bias)
        return _likelihood(base, signals(self.robot, log), noise, self._fixed())

    def _motors_alone(self, alone: Robot, log: Log) -> Likelihood:
        """The density of the motors' positions by themselves."""
        log = replace(log, acceleration=None)
        noise: dict[str, Any] = noise_arrays(alone, log, self.noise, [])
        fixed = [(name, value) for name, value in self._fixed() if name[0] not in OF_SENSORS]
        return _likelihood(alone, signals(alone, log), noise, fixed)


def _split(values: Sequence[tuple[CoreName, float]]) -> tuple[list[CoreName], list[float]]:
    return [name for name, _ in values], [value for _, value in values]


def _likelihood(
    robot: Robot, arrays: dict[str, Any], noise: dict[str, Any], fixed: list[tuple[CoreName, float]]
) -> Likelihood:
    biased = [True] * len(noise["reading"])
    return Likelihood(robot.core, arrays, noise=noise, biased=biased, fixed=fixed, huber=HUBER)


def _blind(robot: Robot) -> Robot:
    """Take a robot's accelerometers off."""
    return Robot(robot.config.model_copy(update={"accelerometers": ()}), robot.tree)


def bare(robot: Robot) -> Robot:
    """Take a robot's payload off, and the factors off its masses: they are parameters here."""
    joints = tuple(joint.model_copy(update={"mass_scale": 1.0}) for joint in robot.drives)
    return Robot(
        robot.config.model_copy(update={"joints": joints, "payload": PayloadConfig()}),
        unloaded(robot.tree, robot.config),
    )
