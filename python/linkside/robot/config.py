"""The schema of robot.yaml: the properties of an elastic-joint robot that a URDF lacks.

SI units, everything reflected through the gear to the link side. Each model is frozen; an unknown key, a
missing one or a value out of range is a `ConfigError`: file, line, key, what was expected and what was found.
"""

from os import PathLike
from typing import Annotated

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from linkside.files.yaml_source import Source, refusal, suggest

from . import correlations, gearing
from .counterbalances import Counterbalance
from .joints import JointConfig, LinkageConfig, RotorConfig
from .section import Name, Section
from .sensors import (
    AccelerometerConfig,
    EncoderConfig,
    FrameConfig,
    GyroscopeConfig,
    JointTorqueConfig,
    LinkEncoderConfig,
    PayloadConfig,
    TorqueConfig,
    TrackerConfig,
)
from .sources import SourcesConfig
from .units import DIMENSIONS, UnitsConfig, refuse_unfit
from .values import NonNegative, Number, Positive, Vector3, some
from .wrenches import WrenchConfig


class TolerancesConfig(Section):
    """How far off the values above may be, one standard deviation: the prior of a calibration.

    Shares of the value where it is positive by nature (0.3 is 30 %), else in its unit; of noise, natural logarithms
    of factors.
    """

    stiffness: Positive = 0.2
    cubic_stiffness: Positive = 3e4  # 1/rad², times the stiffness
    damping: Positive = 1.0
    hysteresis_stiffness: Positive = 0.5
    hysteresis_limit: Positive = 0.5
    motor_inertia: Positive = 0.3
    viscous: Positive = 1.0
    coulomb: Positive = 1.0
    mass_scale: Positive = 0.1
    coupling: Positive = 0.5  # kg m²
    payload_mass: Positive = 10.0  # kg
    payload_xyz: Positive = 0.1  # m
    translation: Positive = 0.01  # m
    rotation: Positive = 0.03  # rad
    bias: Positive = 0.5  # m/s²
    scale: Positive = 0.03
    time_constant: Positive = 1e-3  # s
    delay: Positive = 1e-3  # s
    sensor_noise: Positive = 1.0
    link_friction: Positive = 0.5
    torque_constant: Positive = 0.05
    motor_friction: Positive = 0.5
    calibrated: dict[Name, Positive] = {}  # of single parameters, by the names that `calibrate` gives them
    correlations: dict[Name, dict[Name, Number]] = {}  # {one parameter: {another: -1 to 1}}, each pair once
    encoder_zero: NonNegative = 0.0  # rad; between a motor's encoder and its link; 0: positions are relative to it
    lost_motion: NonNegative = 1e-4  # rad; hysteresis, play and teeth of a gear: three of it are half of 2 arc minutes
    rigid_frequency: Positive = 20.0  # Hz; on which a joint taken as rigid may ring after all


class ColumnsConfig(Section):
    """What the log calls the columns that have other names than ours, and on which side of the gear it is."""

    model_config = ConfigDict(frozen=True, extra="allow")
    __pydantic_extra__: dict[str, Name] = Field(init=False)

    motor_side: bool = False  # theta, dtheta and tau are on the motor shaft: divide, and multiply, by the gear ratio

    @property
    def names(self) -> dict[str, str]:
        """The log's name by ours, for the columns that are named."""
        return dict(self.__pydantic_extra__ or {})

    def name_in_log(self, column: str) -> str:
        """The log's name of one of our columns."""
        return self.names.get(column, column)


class RobotConfig(Section):
    """The settings of a robot that a URDF lacks; joints in the order of the log."""

    rate_hz: Positive | None = None  # of the log; for the reader of the file, nothing depends on it
    gravity: Vector3 = (0.0, 0.0, -9.81)  # m/s², of free fall in the base frame
    joints: Annotated[tuple[JointConfig, ...], AfterValidator(some)]
    coupling: dict[str, dict[str, Number]] = {}  # S, kg m²: {link's joint: {motor's joint: value}}
    rotors: dict[str, RotorConfig] = {}  # motors carried by links, by the joint that they drive
    gearing: dict[str, dict[str, Number]] = {}  # Γ: {joint: {joint whose motor turns it, too: how far}}; 1 by its own
    linkages: dict[Name, LinkageConfig] = {}  # joints of the URDF that others move, by their names
    counterbalances: tuple[Counterbalance, ...] = ()  # what carries part of the weight
    wrenches: tuple[WrenchConfig, ...] = ()  # what acts on links from outside
    accelerometers: tuple[AccelerometerConfig, ...] = ()
    gyroscopes: tuple[GyroscopeConfig, ...] = ()
    trackers: tuple[TrackerConfig, ...] = ()
    encoder: EncoderConfig = EncoderConfig()
    torque: TorqueConfig = TorqueConfig()
    link_encoder: LinkEncoderConfig | None = None
    joint_torque: JointTorqueConfig | None = None
    tool: FrameConfig | None = None
    payload: PayloadConfig = PayloadConfig()
    tolerances: TolerancesConfig = TolerancesConfig()
    columns: ColumnsConfig = ColumnsConfig()
    units: UnitsConfig = {}  # of the log's columns, by kind or by column: {theta: deg, tool_acc_x: g}
    sources: SourcesConfig = SourcesConfig()

    @property
    def acceleration_channels(self) -> tuple[str, ...]:
        """Columns of specific force [m/s²], in the order in which sensors and axes are listed."""
        return tuple(f"{sensor.name}_{axis}" for sensor in self.accelerometers for axis in sensor.axes)

    @property
    def gyroscope_channels(self) -> tuple[str, ...]:
        """Columns of angular velocity [rad/s], likewise."""
        return tuple(f"{sensor.name}_w{axis}" for sensor in self.gyroscopes for axis in sensor.axes)

    @property
    def position_channels(self) -> tuple[str, ...]:
        """Columns of trackers [m], likewise."""
        return tuple(f"{sensor.name}_p{axis}" for sensor in self.trackers for axis in sensor.axes)

    @property
    def wrench_channels(self) -> tuple[str, ...]:
        """Columns of force sensors [N, N m], `<wrench>_fx` and so on."""
        return tuple(column for one in self.wrenches if one.kind == "measured" for column in one.columns)

    @property
    def columns_by_kind(self) -> dict[str, tuple[str, ...]]:
        """Every column that a log of this robot may have, by what it measures."""
        joints = [joint.name for joint in self.joints]
        columns = {kind: tuple(f"{kind}_{joint}" for joint in joints) for kind in DIMENSIONS}
        inertial = {"acceleration": self.acceleration_channels, "rate": self.gyroscope_channels}
        outside = {"wrench": self.wrench_channels, "position": self.position_channels}
        return columns | {"t": ("t",)} | inertial | outside

    @model_validator(mode="after")
    def _driven(self) -> "RobotConfig":
        if all(joint.passive for joint in self.joints):
            raise refusal("expected a joint with a motor: all are passive", "joints")
        return self

    @model_validator(mode="after")
    def _names_unique(self) -> "RobotConfig":
        for key in ("joints", "accelerometers", "gyroscopes", "trackers", "wrenches"):
            seen: dict[str, int] = {}
            for index, item in enumerate(getattr(self, key)):
                if (first := seen.setdefault(item.name, index)) != index:
                    raise refusal(f"expected a name of its own, got that of {key}[{first}]", key, index, "name")
        return self

    @model_validator(mode="after")
    def _coupling_triangular(self) -> "RobotConfig":
        order = {joint.name: index for index, joint in enumerate(self.joints) if joint.elastic and not joint.passive}
        for row, entries in self.coupling.items():
            for keys in ((row,), *((row, column) for column in entries)):
                if keys[-1] not in order:
                    raise refusal(f"expected an elastic joint; {suggest(keys[-1], order)}", "coupling", *keys)
                if len(keys) == 2 and order[row] >= order[keys[1]]:
                    raise refusal(f"expected a joint after '{row}': S is strictly upper triangular", "coupling", *keys)
        return self

    @model_validator(mode="after")
    def _correlations_possible(self) -> "RobotConfig":
        sensors = (sensor.name for sensor in self.accelerometers)
        known = correlations.names((joint.name for joint in self.joints), sensors)
        correlations.refuse_impossible(self.tolerances.correlations, known)
        return self

    @model_validator(mode="after")
    def _payload_carried(self) -> "RobotConfig":
        if self.payload.mass and self.tool is None:
            raise refusal("expected a tool that carries it: name one, `tool: {link: …}`", "payload", "mass")
        return self

    @model_validator(mode="after")
    def _rotors_known(self) -> "RobotConfig":
        joints = [joint.name for joint in self.joints if not joint.passive]
        for motor in self.rotors:
            if motor not in joints:
                raise refusal(f"expected a joint; {suggest(motor, joints)}", "rotors", motor)
            if any(entries.get(motor) for entries in self.coupling.values()):
                raise refusal("expected no coupling of this motor: a rotor brings its own", "rotors", motor)
        return self

    @model_validator(mode="after")
    def _gearing_possible(self) -> "RobotConfig":
        coupled = [motor for entries in self.coupling.values() for motor, inertia in entries.items() if inertia]
        gearing.refuse_impossible(self.gearing, self.joints, [*coupled, *self.rotors])
        return self

    @model_validator(mode="after")
    def _linkages_known(self) -> "RobotConfig":
        names = [joint.name for joint in self.joints]
        for joint, linkage in self.linkages.items():
            if joint in names:
                raise refusal("expected a joint that is not listed: its leader moves it", "linkages", joint)
            if linkage.follows not in names:
                raise refusal(f"expected a joint; {suggest(linkage.follows, names)}", "linkages", joint, "follows")
        return self

    @model_validator(mode="after")
    def _balanced_joints_known(self) -> "RobotConfig":
        names = [joint.name for joint in self.joints]
        for index, balance in enumerate(self.counterbalances):
            for at, joint in enumerate(balance.joints):
                if joint not in names:
                    raise refusal(f"expected a joint; {suggest(joint, names)}", "counterbalances", index, "joints", at)
        return self

    @model_validator(mode="after")
    def _columns_known(self) -> "RobotConfig":
        known = [column for columns in self.columns_by_kind.values() for column in columns]
        for column in self.columns.names:
            if column not in known:
                raise refusal(f"unknown column; {suggest(column, known)}", "columns", column)
        return self

    @model_validator(mode="after")
    def _units_fit(self) -> "RobotConfig":
        refuse_unfit(self.units, self.columns_by_kind)
        return self


class RobotFile(RobotConfig):
    """A robot.yaml: the settings, and the URDF they complete."""

    urdf: Name  # relative to the file


def load_config(path: str | PathLike[str]) -> RobotFile:
    """Read a robot.yaml.

    Raises
    ------
    ConfigError
        A file missing or not valid YAML; a key unknown, missing or given twice; a value out of range.
    """
    return Source.read(path).validate(RobotFile)
