"""Recordings as the links' response is compared with: motors that move smoothly, and what sensors read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy.signal

from linkside.arrays import FloatArray
from linkside.channels import CHANNELS
from linkside.recording.log import Log
from linkside.robot import Robot

from .band import MISSING
from .motors import measured_again, motors, quietest, unsettled
from .signals import filled, without_spikes

KINDS = ("acceleration", "rate", "q", "torque", "dq", "position")
"""Signals of sensors on the links, by the core's names."""

ZEROS = ("rate", "q", "torque", "position", "tau")
"""Signals with unknown zeros, which are estimated for each recording."""

LEAST_RATE, PER_PERIOD = 200.0, 16.0
"""Least rate of thinned-out samples [Hz], which shows the links' vibrations, and least number a period of a corner."""

LIGHTER = 2.8
"""Where torques are compared, motors are smoothed by so much less: the comparison is, on both sides alike."""

SHORTEST = 100
"""Fewer samples are not thinned out."""


@dataclass(frozen=True, eq=False)
class Prepared:
    """One log as a response sees it.

    Attributes
    ----------
    log : Log
        The recording.
    kinds : tuple of str
        Signals that are compared.
    motors : dict
        How its motors moved.
    readings : (T, m)
        What sensors read, filled where it is missing.
    missing : (T, m)
        Where that is.
    offset : (2n + zeros,)
        Positions and velocities of the links in the first sample, less those at which springs hold them, and what
        sensors of `ZEROS` read too much.
    every : int
        Of how many samples of the log there is one here.
    corners : (n,)
        Frequencies by which motors' positions are smoothed [Hz].
    limits : (n,)
        Frequencies below which motors' torques are compared [Hz]; empty where they are not.
    """

    log: Log
    kinds: tuple[str, ...]
    motors: dict[str, FloatArray]
    readings: FloatArray
    missing: npt.NDArray[np.bool_]
    offset: FloatArray
    every: int = 1
    corners: Sequence[float] = ()
    limits: Sequence[float] = ()

    @property
    def period(self) -> float:
        """Time from sample to sample [s]."""
        return self.log.period * self.every

    @classmethod
    def of(cls, robot: Robot, log: Log, kinds: tuple[str, ...]) -> Prepared:
        """Prepare ``log``."""
        readings = np.concatenate([_readings(robot, log, kind) for kind in kinds], axis=1)
        limits = quietest(robot, log, torque=True) if "tau" in kinds else ()
        corners = [LIGHTER * limit for limit in limits] or quietest(robot, log)
        missing, ends = np.isnan(readings), unsettled(log, corners)
        missing[:ends] = missing[len(missing) - ends :] = True
        readings[:, missing.all(axis=0)] = 0.0
        zeros = sum(width(robot, kind) for kind in kinds if kind in ZEROS)
        start = np.zeros(2 * robot.n + zeros)
        return cls(
            log, kinds, motors(robot, log, corners), filled(readings), missing, start, corners=corners, limits=limits
        )

    def coarser(self, corner: float) -> Prepared:
        """Give a few samples a period of what is below ``corner`` [Hz] instead of all, if the log has many more.

        Readings and motors go through the same filter, forwards and backwards, so that a link's response stays what it
        is.
        """
        rate = 1 / self.log.period
        every = int(rate / max(LEAST_RATE, PER_PERIOD * corner))
        if every < 2 or len(self.readings) < SHORTEST * every:
            return self
        sections = scipy.signal.butter(4, 0.3 * rate / every, fs=rate, output="sos")

        def few(values: FloatArray) -> FloatArray:
            return np.ascontiguousarray(scipy.signal.sosfiltfilt(sections, values, axis=0)[::every])

        moved = {name: few(self.motors[name]) for name in ("theta", "dtheta", "ddtheta")}
        readings, missing = few(self.readings), few(self.missing.astype(float)) > MISSING
        moved["t"] = self.motors["t"][::every].copy()
        return Prepared(self.log, self.kinds, moved, readings, missing, self.offset, every)

    def smoothed(self, robot: Robot, wider: float) -> Prepared:
        """Smooth motors' positions less, by this factor on the corner frequencies."""
        corners = [wider * corner for corner in self.corners]
        return replace(self, motors=motors(robot, self.log, corners), corners=corners)

    def measured_again(self, robot: Robot, predicted: FloatArray, rng: np.random.Generator) -> Prepared:
        """Let encoders read the motors' positions again, and all other sensors what is ``predicted`` (T, m)."""
        log = measured_again(robot, self.log, self.motors["theta"], rng)
        return replace(self, motors=motors(robot, log, self.corners), readings=predicted)

    def without(self, stretches: Sequence[slice]) -> Prepared:
        """Leave out what sensors read in some stretches."""
        missing = self.missing.copy()
        for stretch in stretches:
            missing[stretch] = True
        return replace(self, missing=missing)

    def reading(self, columns: Sequence[int]) -> Prepared:
        """Leave out what all but some channels read."""
        missing = np.ones_like(self.missing)
        missing[:, columns] = self.missing[:, columns]
        return replace(self, missing=missing)


def _readings(robot: Robot, log: Log, kind: str) -> FloatArray:
    values = getattr(log, kind)
    if kind == "acceleration":
        bias, scale = robot.acceleration_errors
        noise = np.array([sensor.noise_std for sensor in robot.accelerometers for _ in sensor.axes])
        return without_spikes(values * scale + bias, noise)
    if kind in ("q", "torque"):  # of a joint without a spring they tell nothing
        return np.where(robot.elastic, values, np.nan)
    return np.array(values)


def kinds(robot: Robot, logs: Sequence[Log]) -> tuple[str, ...]:
    """Return the signals of sensors on the links that all of ``logs`` have."""
    return tuple(kind for kind in KINDS if all(_has(robot, log, kind) for log in logs))


def recordings(robot: Robot, logs: Sequence[Log], torque: bool = False) -> list[Prepared]:
    """Prepare logs, all by the signals that they have in common, with those of motors where ``torque`` says so."""
    common = (*kinds(robot, logs), *(("tau",) if torque else ()))
    return [Prepared.of(robot, log, common) for log in logs]


def _has(robot: Robot, log: Log, kind: str) -> bool:
    values = getattr(log, kind)
    if kind == "acceleration" and not robot.acceleration_channels:
        return False
    return values is not None and values.shape[1] > 0 and bool(np.isfinite(values).any())


def width(robot: Robot, signal: str) -> int:
    """Number of a signal's channels."""
    return next(channel for channel in CHANNELS.values() if channel.signal == signal).width(robot)
