"""The posterior of a robot's free parameters, given recordings: value, gradient, information."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from linkside import _core
from linkside.arrays import FloatArray
from linkside.kalman.noise import Noise
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot import compile as tree
from linkside.robot.config import PayloadConfig

from .parameters import CoreName, Parameter, catalogue
from .signals import noise_arrays, signals

HUBER = 4.0
"""Innovations beyond so many standard deviations count linearly."""

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
    scores : list of (T, p)
        Each sample's part of the gradient, one array a recording, where asked for.
    innovations : list of (T, m)
        Normalised innovations, likewise.
    """

    log_likelihood: float
    gradient: FloatArray
    information: FloatArray
    used: int
    scores: list[FloatArray]
    innovations: list[FloatArray]


class Problem:
    """Recordings of one robot and the parameters that are free.

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
        fixed = self._fixed()
        self._cores = [self._core(base, log, fixed) for log in self.logs]

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
        parts = [core.evaluate(names, values, detail) for core in self._cores]
        return Evidence(
            log_likelihood=sum(part["log_likelihood"] for part in parts),
            gradient=slopes * sum(part["gradient"] for part in parts),
            information=np.outer(slopes, slopes) * sum(part["information"] for part in parts),
            used=sum(part["used"] for part in parts),
            scores=[part["scores"] * slopes for part in parts],
            innovations=[part["innovations"] for part in parts],
        )

    def log_likelihood(self, z: FloatArray) -> float:
        """Log-likelihood alone, without derivatives."""
        names, values = [p.core for p in self.free], self.values(z)
        return sum(core.log_likelihood(names, values) for core in self._cores)

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

    def _core(self, base: Robot, log: Log, fixed: list[tuple[CoreName, float]]) -> _core.Likelihood:
        free = {p.name for p in self._estimated}
        free_bias = [f"bias_{channel}" in free for channel in self.robot.acceleration_channels]
        noise: dict[str, Any] = noise_arrays(self.robot, log, self.noise, self.torque, free_bias)
        return _core.Likelihood(
            base.core,
            signals(self.robot, log, self.torque),
            noise=noise,
            biased=[True] * len(noise["reading"]),
            torque=self.torque,
            held=False,
            fixed=fixed,
            huber=HUBER,
        )


def bare(robot: Robot) -> Robot:
    """Take a robot's payload off, and the factors off its masses: they are parameters here."""
    model = pin.Model(robot.model)
    payload = robot.config.payload
    if robot.tool is not None and payload.mass:
        index, pose = tree.mount(model, robot.tool)
        carried = pin.Inertia(payload.mass, pose.act(np.array(payload.xyz)), np.zeros((3, 3)))
        rest = model.inertias[index].toDynamicParameters() - carried.toDynamicParameters()
        model.inertias[index] = pin.Inertia.FromDynamicParameters(rest)
    for joint in robot.drives:
        index = model.getJointId(joint.name)
        unscaled = model.inertias[index].toDynamicParameters() / joint.mass_scale
        model.inertias[index] = pin.Inertia.FromDynamicParameters(unscaled)
    joints = tuple(joint.model_copy(update={"mass_scale": 1.0}) for joint in robot.drives)
    return Robot(robot.config.model_copy(update={"joints": joints, "payload": PayloadConfig()}), model)
