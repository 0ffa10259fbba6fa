"""Noise levels of a Kalman filter, in physical units, read from and written to files."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.channels import CHANNELS, Channel, widths
from linkside.files.yaml_source import Source, write_yaml
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.wrenches import reading_noise

from .start import Readings

Std = Annotated[float, Field(ge=0, allow_inf_nan=False)]
PositiveStd = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Time = Annotated[float, Field(gt=0)]
Settings = TypeVar("Settings", bound="ReadingNoise")

JERK_TIME = 0.02
"""Window over which jerk is taken as constant when its size is estimated from a log [s]."""

SHORTEST = 5
"""Fewest readings that a cubic is fitted to."""

JUMP = 9
"""Windows that a reading is in."""

LINK_WALKS = ("position_walk", "velocity_walk")
"""Process noise of the links, in the order of the core."""

LEAST_JERK = 10.0
"""A log in which nothing moves still leaves this density of jerk [rad/s³/√Hz]."""


class ReadingNoise(BaseModel):
    """Noise of the readings, which is the same for all models: the common part of `Noise` and `ElasticNoise`.

    The defaults belong to industrial arms in SI units, and are meant to work untuned. The priors on biases are narrow
    because at rest a motor's bias cannot be distinguished from the link's position, nor an accelerometer's from the
    direction of gravity, so the prior decides.

    Attributes
    ----------
    transmission
        Error of a motor's predicted position beside encoder and damping, as of gear teeth [rad].
    motor_velocity
        Noise of the motor velocity [rad/s].
    acceleration, rate
        Noise of accelerometers and gyroscopes, in multiples of their ``noise_std``; one number or one for each.
    link
        Noise of link encoders beside their steps, ``resolution`` of ``link_encoder`` in robot.yaml [rad].
    joint_torque
        Noise of joint torque sensors, in multiples of ``noise_std`` of ``joint_torque`` in robot.yaml, or where that is
        not given in N m.
    link_velocity
        Noise of tachometers on the links [rad/s].
    wrench
        Noise of force sensors, in multiples of the ``noise_std`` of ``wrenches`` in robot.yaml.
    tracker
        Noise of trackers, in multiples of their ``noise_std``.
    motor_bias, acceleration_bias, rate_bias, position_bias
        Initial uncertainty of biases [rad, m/s², rad/s, m]; of a tracker also for lengths of the URDF.
    motor_bias_walk, acceleration_bias_walk, rate_bias_walk, position_bias_walk
        Random walk of biases in one second [rad/√s, m/s²/√s, rad/s/√s, m/√s].
    motor_bias_time, acceleration_bias_time, rate_bias_time, position_bias_time
        Correlation time of biases [s] (Gauss–Markov process): their standard deviation stays at ``walk · √(time/2)``.
        None: the time for which this is the initial uncertainty, so that it is the same at any time. Infinite: a random
        walk without bound, with which the estimate drifts in a long recording.
    link_disturbance, link_disturbance_time
        Standard deviation and correlation time of each link's disturbance torque, if a filter estimates it [N m, s].
        None: estimated from the log; in `step`, the torque that accelerates a resting link by 10 rad/s².
    position, velocity
        Uncertainty at the first sample, where the robot is taken to be at rest [rad, rad/s].
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    transmission: Std | tuple[Std, ...] = 1e-5
    motor_velocity: Std = 1e-3
    acceleration: PositiveStd | tuple[PositiveStd, ...] = 1.0
    rate: PositiveStd | tuple[PositiveStd, ...] = 1.0
    link: PositiveStd = 1e-5
    joint_torque: PositiveStd = 1.0
    link_velocity: PositiveStd = 1e-3
    wrench: PositiveStd = 1.0
    tracker: PositiveStd = 1.0
    motor_bias: Std = 1e-5
    motor_bias_walk: Std = 1e-6
    motor_bias_time: Time | None = None
    acceleration_bias: Std = 0.1
    acceleration_bias_walk: Std = 1e-3
    acceleration_bias_time: Time | None = None
    rate_bias: Std = 1e-3
    rate_bias_walk: Std = 1e-5
    rate_bias_time: Time | None = None
    position_bias: Std = 5e-4
    position_bias_walk: Std = 5e-4
    position_bias_time: Time | None = None
    link_disturbance: Std | tuple[Std, ...] | None = None
    link_disturbance_time: PositiveStd = 1.0
    position: Std = 1e-4
    velocity: Std = 1e-3

    @classmethod
    def read(cls: type[Settings], path: str | PathLike[str]) -> Settings:
        """Read a tuning file: YAML with any of the attributes as keys; `ConfigError` names file, line and key."""
        return Source.read(path).validate(cls)

    def write(self, path: str | Path) -> None:
        """Write a tuning file with everything that differs from the defaults."""
        changed = {k: list(v) if isinstance(v, tuple) else v for k, v in self.model_dump(exclude_defaults=True).items()}
        write_yaml(path, changed)

    def updated(self: Settings, **changes: Any) -> Settings:
        """Give the same with some attributes changed, checked."""
        return type(self).model_validate(self.model_dump() | changes)


class Noise(ReadingNoise):
    """Standard deviations, the same for all joints or for all sensors of a kind unless given joint by joint.

    Attributes
    ----------
    transmission, motor_velocity, acceleration, rate, link, joint_torque, link_velocity, wrench, tracker
        And position, velocity and biases: as of `ReadingNoise`. Motor velocities are what the damping torque is
        computed from.
    jerk
        Density of the links' jerk in addition to the commanded one: the random walk of acceleration in one second
        [rad/s³/√Hz]. None: estimated from the log.
    torsion
        Relative error of the predicted torsion, for example from a wrong stiffness.
    position_walk, velocity_walk
        Random walk of the links' positions and velocities in one second, in addition to the motion by their
        acceleration [rad/√s, rad/s/√s]. Zero is exact kinematics; larger values allow for other errors, such as inexact
        sampling times.
    initial_acceleration
        Uncertainty of the links' acceleration at the first sample [rad/s²].
    """

    jerk: PositiveStd | tuple[PositiveStd, ...] | None = None
    torsion: Std = 3e-3
    position_walk: Std | tuple[Std, ...] = 0.0
    velocity_walk: Std | tuple[Std, ...] = 0.0
    initial_acceleration: Std = 0.1

    def for_log(self, log: Log, robot: Robot) -> Noise:
        """Fill in what is estimated from the log: the scale of jerk."""
        if self.jerk is not None:
            return self
        jerk = np.hypot(jerk_scale(log), ripple_jerk(log, robot))
        return self.updated(jerk=tuple(np.where(robot.passive, passive_jerk(log, robot), jerk).tolist()))

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


def channel_arrays(
    noise: ReadingNoise, motor: FloatArray, robot: Robot, kinds: tuple[str, ...]
) -> dict[str, FloatArray]:
    """Noise and biases of the channels of ``kinds`` in order: one number a channel.

    ``motor`` is the noise of motor positions (n,) [rad].
    """
    chosen = [CHANNELS[kind] for kind in kinds]
    readings = [motor if kind == "motor" else _reading_noise(noise, CHANNELS[kind], robot) for kind in kinds]
    biases = np.repeat([_bias(noise, channel) for channel in chosen], widths(robot, kinds), axis=0)
    bias, walk, time = biases.T
    return {"reading": np.concatenate(readings), "initial_bias": bias, "bias_walk": walk, "bias_time": time}


def _bias(noise: ReadingNoise, channel: Channel) -> tuple[float, float, float]:
    """Initial uncertainty, walk and time constant of the biases of a kind of channel."""
    if not channel.biased:
        return 0.0, 0.0, np.inf
    bias, walk, time = (getattr(noise, f"{channel.kind}_bias{what}") for what in ("", "_walk", "_time"))
    if time is None and bias > 0 and walk > 0:
        time = 2 * (bias / walk) ** 2
    return bias, walk, time or np.inf


def _reading_noise(noise: ReadingNoise, channel: Channel, robot: Robot) -> FloatArray:
    """In the channel's unit; of inertial and torque sensors a multiple of what robot.yaml gives."""
    value = getattr(noise, channel.noise)
    if channel.kind == "q" and robot.config.link_encoder is not None:
        value = np.hypot(robot.config.link_encoder.resolution / np.sqrt(12), value)
    if channel.kind == "torque" and robot.config.joint_torque is not None:
        value = robot.config.joint_torque.noise_std * value
    if channel.kind == "tau":
        return np.asarray(value * torque_noise(robot))
    if channel.kind == "q":
        return np.asarray(np.hypot(value, link_lines(robot)))
    if channel.carrier == "joint":
        return np.full(robot.n, value)
    if channel.carrier == "wrench":
        return np.asarray(value * reading_noise(robot.varying_wrenches))
    carriers = {"accelerometer": robot.accelerometers, "gyroscope": robot.gyroscopes, "tracker": robot.trackers}
    sensors = carriers[channel.carrier]
    return sensor_noise(sensors, per_joint(channel.noise, value, len(sensors)))


def motor_noise(robot: Robot, transmission: float | tuple[float, ...]) -> FloatArray:
    """Noise of motor positions (n,) [rad]: encoder steps, and the transmission's error."""
    step = robot.config.encoder.resolution / np.sqrt(12) * np.linalg.norm(robot.gearing, axis=1)
    return np.asarray(np.hypot(step, per_joint("transmission", transmission, robot.n)))


def link_lines(robot: Robot) -> FloatArray:
    """Noise of link encoders (n,) by lines of their disks, whose phase no run tells [rad]."""
    lines = [drive.link_encoder_error.unknown(1.0) for drive in robot.drives]
    return np.array([np.sqrt(sum(0.5 * amplitude**2 for amplitude, _ in own)) for own in lines])


def torque_noise(robot: Robot) -> FloatArray:
    """Noise of motor torques (n,), of motors that turn several joints as those have it [N m]."""
    return np.asarray(robot.config.torque.noise_std * np.linalg.norm(np.linalg.inv(robot.gearing), axis=0))


def friction_at_unit_speed(robot: Robot) -> FloatArray:
    """Torque that each motor's friction has at 1 rad/s (n,); 1 if it has none [N m]."""
    return np.array([d.motor_friction.viscous + d.motor_friction.coulomb or 1.0 for d in robot.drives])


def jerk_scale(log: Log | Readings) -> FloatArray:
    """Density of each joint's jerk (n,), from the third derivative of the motor positions [rad/s³/√Hz].

    That of cubics through windows of `JERK_TIME`, of five readings at least; readings that are missing are left out.
    """
    with np.errstate(over="ignore", invalid="ignore"):  # of absurd readings, which the filter then names
        return np.array([_jerk_scale(log.t, theta) for theta in log.theta.T])


def ripple_jerk(log: Log, robot: Robot) -> FloatArray:
    """Density of the jerk that the gears' ripple gives the links (n,), motors turning as in ``log`` [rad/s³/√Hz].

    A harmonic a sin(νθ) is one of frequency ω = ν|θ̇|, of jerk a ω³/√2 that lasts for 1/ω: a density of a ω^(5/2)/√2.
    Faster than the link can swing on its spring, it is less by the square of that.
    """
    density = np.zeros(robot.n)
    steps = np.diff(log.theta, axis=0) / np.diff(log.t)[:, None]
    rippled = [j for j, drive in enumerate(robot.drives) if drive.ripple and np.isfinite(steps[:, j]).any()]
    if not rippled:
        return density
    posture = np.nan_to_num([np.median(angle[np.isfinite(angle)]) for angle in log.theta.T])
    swing = np.diag(np.linalg.inv(robot.mass_matrix(posture)))
    for j in rippled:
        for amplitude, frequency, _ in robot.drives[j].harmonics:
            turning = np.abs(frequency * steps[np.isfinite(steps[:, j]), j])
            slow = (robot.drives[j].stiffness or 0.0) * swing[j] / np.maximum(turning, 1e-9) ** 2
            density[j] += 0.5 * np.mean((amplitude * turning**2.5 * np.minimum(1.0, slow)) ** 2)
    return np.asarray(np.sqrt(density))


def passive_jerk(log: Log, robot: Robot) -> FloatArray:
    """Density of the jerk of joints without motor (n,), which swing as the others accelerate [rad/s³/√Hz].

    An acceleration a of a driven joint bends the spring of a passive one, of inertia m and frequency ω, as far as an
    acceleration c a/m of its own would, c the inertia that both share: by x = c a/(m ω²), about which it then swings. A
    vibration of that amplitude has the jerk x ω³/√2, for 1/ω: a density of x ω^(5/2)/√2.
    """
    if not robot.passive.any():
        return np.zeros(robot.n)
    posture = np.nan_to_num([np.median(angle[np.isfinite(angle)]) for angle in log.theta.T])
    mass = robot.mass_matrix(posture)
    square = np.array([drive.stiffness or 0.0 for drive in robot.drives]) / np.diag(mass)
    moved = np.abs(mass) @ acceleration_scale(log) / np.diag(mass)
    return np.asarray(np.maximum(LEAST_JERK, np.sqrt(0.5 * np.sqrt(square)) * moved))


def acceleration_scale(log: Log) -> FloatArray:
    """Root mean square of each motor's acceleration (n,), from cubics as `jerk_scale` has them [rad/s²]."""
    with np.errstate(over="ignore", invalid="ignore"):
        found = [_cubics(log.t, theta) for theta in log.theta.T]
    return np.array([0.0 if one is None else np.sqrt(np.mean(one.acceleration**2)) for one in found])


@dataclass
class _Cubics:
    """Cubics through windows of a signal: acceleration and jerk amid each, and half of a window's time [s]."""

    acceleration: FloatArray
    jerk: FloatArray
    half: float


def _jerk_scale(t: FloatArray, theta: FloatArray) -> float:
    found = _cubics(t, theta)
    if found is None:
        return LEAST_JERK
    # Over a window longer than that, jerk that lasts is as much as more of it that does not.
    lasting = max(JERK_TIME, found.half)
    return max(LEAST_JERK, float(np.sqrt(np.mean(_without_jump(found.jerk**2)) * lasting)))


def _cubics(t: FloatArray, theta: FloatArray) -> _Cubics | None:
    there = ~np.isnan(theta)
    t, theta = t[there], theta[there]
    if len(t) < SHORTEST:
        return None
    period = float(np.median(np.diff(t)))
    count = min(len(t), max(SHORTEST, 2 * round(JERK_TIME / period) + 1))
    every = max(1, count // 8)
    times, angles = (np.lib.stride_tricks.sliding_window_view(x, count)[::every] for x in (t, theta))
    whole = times[:, -1] - times[:, 0] < 2 * (count - 1) * period
    if not whole.any():
        return None
    times, angles = times[whole], angles[whole]
    span = 0.5 * (times[:, -1:] - times[:, :1])
    s = (times - times[:, :1]) / span - 1.0
    powers = np.stack([np.ones_like(s), s, s * s, s * s * s], axis=2)
    normal, right = powers.swapaxes(1, 2) @ powers, powers.swapaxes(1, 2) @ (angles - angles[:, :1])[:, :, None]
    powers_of_s = np.linalg.solve(normal, right)[:, :, 0]
    jerk = 6 * powers_of_s[:, 3] / span[:, 0] ** 3
    return _Cubics(2 * powers_of_s[:, 2] / span[:, 0] ** 2, jerk, (count - 1) * period / 2)


def _without_jump(squares: FloatArray) -> FloatArray:
    """Leave out the windows of one reading where nearly all jerk is in them: it jumped; no motion is so short."""
    largest = np.sort(squares)[::-1]
    few = len(largest) < 10 * JUMP or largest[:JUMP].sum() < 0.9 * largest.sum()
    return largest if few else largest[JUMP:]


def sensor_noise(sensors: Any, factors: FloatArray) -> FloatArray:
    """Noise of each channel of ``sensors``: what robot.yaml has, times a factor for each sensor."""
    each = [np.full(len(s.axes), f * s.noise_std) for s, f in zip(sensors, factors.tolist(), strict=True)]
    return np.concatenate(each) if each else np.zeros(0)
