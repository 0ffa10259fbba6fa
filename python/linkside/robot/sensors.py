"""Sensors and frames in robot.yaml."""

from typing import Literal

from .section import Name, Section
from .values import NonNegative, Positive, PositiveVector3, Vector3


class FrameConfig(Section):
    """A frame fixed to a link: position [m] and roll, pitch, yaw [rad] in the link's frame, as in URDF."""

    link: Name
    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)


class Lateness(Section):
    """Filter and delay inside a sensor."""

    corner_frequency: Positive | None = None  # Hz; of the first-order filter inside the sensor, where it has one
    delay: NonNegative = 0.0  # s; by how much a reading is later than its time stamp says


class ThreeAxes(Lateness):
    """A sensor of up to three axes."""

    name: Name
    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"
    noise_std: Positive


class SensorConfig(FrameConfig, ThreeAxes):
    """What accelerometers and gyroscopes share."""


class AccelerometerConfig(SensorConfig):
    """A sensor of specific force; columns `<name>_x` and so on."""

    noise_std: Positive = 0.05  # m/s²
    bias: Vector3 = (0.0, 0.0, 0.0)  # m/s², x y z; a log's reading is scale · specific force + bias
    scale: PositiveVector3 = (1.0, 1.0, 1.0)


class GyroscopeConfig(SensorConfig):
    """A sensor of angular velocity; columns `<name>_wx` and so on."""

    noise_std: Positive = 0.001  # rad/s


class PlaceConfig(Section):
    """Position [m] and roll, pitch, yaw [rad] in the base frame."""

    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)


class TrackerConfig(ThreeAxes):
    """What sees a point of a link from beside the robot: laser tracker, camera, motion capture; columns `<name>_px`."""

    link: Name
    xyz: Vector3 = (0.0, 0.0, 0.0)  # m; the point, in the link's frame
    place: PlaceConfig = PlaceConfig()  # of the tracker's own axes, which readings are in
    noise_std: Positive = 1e-4  # m


class EncoderConfig(Section):
    """The motor encoders, as seen on the link side."""

    resolution: Positive = 1e-6  # rad; a 20-bit encoder behind a short gear


class LinkEncoderConfig(Lateness):
    """The encoders behind the gears, log columns `q_<joint>`."""

    resolution: NonNegative = 0.0  # rad; 0: beside `Noise.link` it does not matter


class JointTorqueConfig(Lateness):
    """The sensors of the torque that a transmission gives its link, log columns `torque_<joint>`."""

    noise_std: Positive = 1.0  # N m


class TorqueConfig(Section):
    """The motor torques, as seen on the link side."""

    noise_std: Positive = 1.0  # N m; a per mille of an industrial axis' torque


class PayloadConfig(Section):
    """What the tool carries: a mass in a point of the tool's frame."""

    mass: NonNegative = 0.0  # kg
    xyz: Vector3 = (0.0, 0.0, 0.0)  # m
