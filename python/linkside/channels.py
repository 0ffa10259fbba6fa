"""Kinds of channels: what each measures, in which columns, and how uncertain it may be.

One row a kind. Logs, noise, filters and the simulator go by this table: a new kind of sensor is a row here, a
field of `Log`, its noise in `Noise` and `ElasticNoise`, and its reading in the core.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol


class Carriers(Protocol):
    """What carries channels: a robot's joints and sensors."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joints in log order."""

    @property
    def acceleration_channels(self) -> tuple[str, ...]:
        """Accelerometer columns, such as ``tool_acc_x``."""

    @property
    def gyroscope_channels(self) -> tuple[str, ...]:
        """Gyroscope columns, such as ``gyro_wx``."""

    @property
    def position_channels(self) -> tuple[str, ...]:
        """Columns of trackers, such as ``laser_px``."""

    @property
    def wrench_channels(self) -> tuple[str, ...]:
        """Columns of force sensors, such as ``press_fx``."""


@dataclass(frozen=True)
class Channel:
    """A kind of channels.

    Attributes
    ----------
    kind : str
        What settings of filters call it.
    signal : str
        What logs, the simulator and the core call it: the attribute of `Log` and the stem of its columns.
    unit : str
        Of a reading.
    carrier : str
        What has one: a joint, or each axis of an accelerometer, a gyroscope, a tracker or a wrench from outside.
    noise : str
        Attribute of `Noise` that says how uncertain a reading is.
    biased : bool
        Whether a filter may estimate a bias; its uncertainty and walk are ``<kind>_bias`` and ``<kind>_bias_walk``.
    outliers : bool
        Whether a particle filter may take its noise to have heavy tails.
    extra : bool
        Whether few robots have it: a simulated recording has it only if a sensor is given.
    drives : bool
        Whether it is what moves the motors, which a simulation has anyhow.
    """

    kind: str
    signal: str
    unit: str
    carrier: Literal["joint", "accelerometer", "gyroscope", "wrench", "tracker"]
    noise: str
    biased: bool = False
    outliers: bool = False
    extra: bool = False
    drives: bool = False

    def columns(self, robot: Carriers) -> tuple[str, ...]:
        """Names of its columns in a log, as they are called unless robot.yaml renames them."""
        if self.carrier == "joint":
            return joint_columns(self.signal, robot.names)
        of_sensors = {
            "accelerometer": robot.acceleration_channels,
            "gyroscope": robot.gyroscope_channels,
            "wrench": robot.wrench_channels,
            "tracker": robot.position_channels,
        }
        return of_sensors[self.carrier]

    def width(self, robot: Carriers) -> int:
        """Channels of this kind."""
        return len(self.columns(robot))


CHANNELS = {
    channel.kind: channel
    for channel in (
        Channel("motor", "theta", "rad", "joint", "transmission", biased=True, outliers=True),
        Channel("acceleration", "acceleration", "m/s²", "accelerometer", "acceleration", biased=True, outliers=True),
        Channel("dtheta", "dtheta", "rad/s", "joint", "motor_velocity"),
        Channel("rate", "rate", "rad/s", "gyroscope", "rate", biased=True, outliers=True),
        Channel("q", "q", "rad", "joint", "link", outliers=True, extra=True),
        Channel("torque", "torque", "N m", "joint", "joint_torque", outliers=True, extra=True),
        Channel("dq", "dq", "rad/s", "joint", "link_velocity", extra=True),
        Channel("wrench", "wrench", "N, N m", "wrench", "wrench", outliers=True),
        Channel("position", "position", "m", "tracker", "tracker", biased=True, outliers=True),
        Channel("tau", "tau", "N m", "joint", "motor_torque", biased=True, drives=True),
    )
}
"""By kind, in the core's order."""

BIASED = tuple(kind for kind, channel in CHANNELS.items() if channel.biased)
"""Kinds that may have a bias."""

OUTLIERS = tuple(kind for kind, channel in CHANNELS.items() if channel.outliers)
"""Kinds whose noise may have heavy tails."""


def joint_columns(signal: str, joints: Iterable[str]) -> tuple[str, ...]:
    """Columns of a signal with one column a joint, ``<signal>_<joint>``."""
    return tuple(f"{signal}_{joint}" for joint in joints)


def widths(robot: Carriers, kinds: Sequence[str]) -> list[int]:
    """How many channels there are of each kind."""
    return [CHANNELS[kind].width(robot) for kind in kinds]
