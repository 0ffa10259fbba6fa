"""How uncertain everything is: the settings of a Kalman filter, in physical units, read from and written to files."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from linkside.arrays import FloatArray
from linkside.channels import CHANNELS, Channel, widths
from linkside.errors import EstimatorError
from linkside.files.yaml_source import Source, write_yaml
from linkside.recording.log import Log
from linkside.robot import Robot

Std = Annotated[float, Field(ge=0, allow_inf_nan=False)]
PositiveStd = Annotated[float, Field(gt=0, allow_inf_nan=False)]

JERK_TIME = 0.02
"""Over this time jerk is taken to stay the same, where its size is read off a log [s]."""

LINK_WALKS = ("position_walk", "velocity_walk")
"""What lets links wander, in the order of the core."""

LEAST_JERK = 10.0
"""A log in which nothing moves still leaves this density of jerk [rad/s³/√Hz]."""


class Noise(BaseModel):
    """Standard deviations, the same for all joints or for all sensors of a kind unless given joint by joint.

    The defaults belong to industrial arms in SI units, and are meant to work untuned. Biases are kept on a short
    lead on purpose: at rest a motor's bias cannot be told from link position, nor an accelerometer's from the
    direction of gravity, so what is known of them beforehand decides.

    Attributes
    ----------
    jerk
        Density of the links' jerk beside the commanded one: acceleration wanders by this in a second
        [rad/s³/√Hz]. None: read off the log.
    transmission
        Error of a motor's predicted position beside encoder and damping, as of gear teeth [rad].
    torsion
        Relative error of the predicted torsion, as of a stiffness that is not quite right.
    motor_velocity
        Noise of the motor velocity, which the damping torque is computed from [rad/s].
    acceleration, rate
        Noise of accelerometers and gyroscopes, in multiples of their ``noise_std``.
    link
        Noise of link encoders [rad].
    joint_torque
        Noise of joint torque sensors [N m].
    link_velocity
        Noise of tachometers on the links [rad/s].
    position_walk, velocity_walk
        By how much the links' positions and velocities wander in one second beside what their acceleration does
        [rad/√s, rad/s/√s]. Zero is mechanics; more is room for what no acceleration explains, such as samples that are
        not quite in time.
    motor_bias, acceleration_bias, rate_bias
        Initial uncertainty of biases [rad, m/s², rad/s].
    motor_bias_walk, acceleration_bias_walk, rate_bias_walk
        By how much biases wander in one second [rad/√s, m/s²/√s, rad/s/√s].
    position, velocity, initial_acceleration
        Uncertainty of the links' state at the first sample, where the robot is taken to be at rest
        [rad, rad/s, rad/s²].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    jerk: PositiveStd | tuple[PositiveStd, ...] | None = None
    transmission: Std | tuple[Std, ...] = 1e-5
    torsion: Std = 3e-3
    motor_velocity: Std = 1e-3
    acceleration: PositiveStd = 1.0
    rate: PositiveStd = 1.0
    link: PositiveStd = 1e-5
    joint_torque: PositiveStd = 1.0
    link_velocity: PositiveStd = 1e-3
    position_walk: Std | tuple[Std, ...] = 0.0
    velocity_walk: Std | tuple[Std, ...] = 0.0
    motor_bias: Std = 1e-5
    motor_bias_walk: Std = 1e-6
    acceleration_bias: Std = 0.1
    acceleration_bias_walk: Std = 1e-3
    rate_bias: Std = 1e-3
    rate_bias_walk: Std = 1e-5
    position: Std = 1e-4
    velocity: Std = 1e-3
    initial_acceleration: Std = 0.1

    @classmethod
    def read(cls, path: str | PathLike[str]) -> Noise:
        """Read a tuning file: YAML with any of the attributes as keys; `ConfigError` names file, line and key."""
        return Source.read(path).validate(cls)

    def write(self, path: str | Path) -> None:
        """Write a tuning file with everything that differs from the defaults."""
        changed = {k: list(v) if isinstance(v, tuple) else v for k, v in self.model_dump(exclude_defaults=True).items()}
        write_yaml(path, changed)

    def updated(self, **changes: Any) -> Noise:
        """Give the same with some attributes changed, checked."""
        return type(self).model_validate(self.model_dump() | changes)

    def for_log(self, log: Log) -> Noise:
        """Fill in what is to be read off the log: the scale of jerk."""
        return self if self.jerk is not None else self.updated(jerk=tuple(jerk_scale(log)))

    def arrays(self, robot: Robot, kinds: tuple[str, ...]) -> dict[str, Any]:
        """Arrays for the filter: one number a joint or channel, the channels being those of ``kinds`` in order."""
        channels = channel_arrays(self, self._motor(robot), robot, kinds)
        initial = np.repeat([self.position, self.velocity, self.initial_acceleration], robot.n)
        return {name: values.tolist() for name, values in channels.items()} | {
            "jerk": per_joint("jerk", LEAST_JERK if self.jerk is None else self.jerk, robot.n).tolist(),
            "link_walk": np.concatenate([per_joint(k, getattr(self, k), robot.n) for k in LINK_WALKS]).tolist(),
            "torsion": self.torsion,
            "initial": initial.tolist(),
        }

    def _motor(self, robot: Robot) -> FloatArray:
        """Encoder steps, the transmission's error, and what the damping torque's velocity adds, D/K of its noise."""
        lag = np.array([d.damping / d.stiffness if d.elastic and d.stiffness else 0.0 for d in robot.drives])
        return np.asarray(np.hypot(motor_noise(robot, self.transmission), lag * self.motor_velocity))


def channel_arrays(noise: Any, motor: FloatArray, robot: Robot, kinds: tuple[str, ...]) -> dict[str, FloatArray]:
    """Noise and biases of the channels of ``kinds`` in order: one number a channel.

    ``noise`` has the attributes of `Noise` that describe readings; ``motor`` is that of motor positions (n,) [rad].
    """
    chosen = [CHANNELS[kind] for kind in kinds]
    sizes = widths(robot, kinds)
    readings = [motor if kind == "motor" else _reading_noise(noise, CHANNELS[kind], robot) for kind in kinds]

    def biases(suffix: str) -> FloatArray:
        """Of each channel; zero of a kind that has none."""
        values = [getattr(noise, f"{c.kind}{suffix}") if c.biased else 0.0 for c in chosen]
        return np.repeat(np.asarray(values, float), sizes)

    return {
        "reading": np.concatenate(readings),
        "bias_walk": biases("_bias_walk"),
        "initial_bias": biases("_bias"),
    }


def _reading_noise(noise: Any, channel: Channel, robot: Robot) -> FloatArray:
    """In the channel's unit; of an inertial sensor a multiple of what robot.yaml gives."""
    value = getattr(noise, channel.noise)
    if channel.carrier == "joint":
        return np.full(robot.n, value)
    sensors = robot.accelerometers if channel.carrier == "accelerometer" else robot.gyroscopes
    return np.asarray(value * sensor_noise(sensors))


def motor_noise(robot: Robot, transmission: float | tuple[float, ...]) -> FloatArray:
    """Noise of motor positions (n,) [rad]: encoder steps, and the transmission's error."""
    step = robot.config.encoder.resolution / np.sqrt(12)
    return np.asarray(np.hypot(step, per_joint("transmission", transmission, robot.n)))


def per_joint(name: str, value: float | tuple[float, ...], n: int) -> FloatArray:
    """One number for each of n joints."""
    values = np.atleast_1d(np.asarray(value, float))
    if len(values) not in (1, n):
        raise EstimatorError(f"noise: {name} has {len(values)} entries, expected 1 or {n}")
    return np.array(np.broadcast_to(values, n))


def jerk_scale(log: Log) -> FloatArray:
    """Density of each joint's jerk (n,), from the third derivative of the motor positions [rad/s³/√Hz]."""
    half = min(len(log) - 1, 2 * round(JERK_TIME / log.period)) // 2
    if half < 2:
        return np.full(log.theta.shape[1], LEAST_JERK)
    filled = np.where(np.isnan(log.theta), np.nanmean(log.theta, axis=0), log.theta)
    # A cubic through each window of samples: its third derivative is a fixed combination of them.
    weights = 6 * np.linalg.pinv(np.vander(np.arange(-half, half + 1) * log.period, 4, increasing=True))[3]
    jerk = np.stack([np.correlate(joint, weights, "valid") for joint in filled.T], axis=1)
    return np.asarray(np.maximum(LEAST_JERK, np.sqrt(np.mean(jerk**2, axis=0) * JERK_TIME)))


def sensor_noise(sensors: Any) -> FloatArray:
    """Noise of each channel of ``sensors`` as robot.yaml has it."""
    return np.concatenate([np.full(len(s.axes), s.noise_std) for s in sensors]) if sensors else np.zeros(0)
