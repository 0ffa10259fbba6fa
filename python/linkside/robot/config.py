"""The schema of robot.yaml: what a URDF cannot say about an elastic-joint robot.

SI units, everything reflected through the gear to the link side. Each model is frozen; an unknown key, a
missing one or a value out of range is a `ConfigError`: file, line, key, what was expected and what was found.
"""

import math
from itertools import accumulate, pairwise
from os import PathLike
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from linkside.files.yaml_source import Source, refusal, suggest

from . import correlations
from .counterbalances import Counterbalance
from .section import Listed, Name, NonNegative, Number, Positive, PositiveVector3, Section, Vector3, Vector6
from .sources import SourcesConfig

T = TypeVar("T")


def _some(value: tuple[T, ...]) -> tuple[T, ...]:
    if not value:
        raise refusal("expected a list of one joint or more, got an empty one")
    return value


def _nonzero(value: float) -> float:
    if value == 0:
        raise refusal("expected a number other than 0, got 0")
    return value


def _direction(value: tuple[float, ...]) -> tuple[float, ...]:
    if not any(value):
        raise refusal("expected a direction, got three zeros")
    return value


USUAL_FREQUENCY = 80.0
"""√(K/B) of a robot's joint [rad/s], to within a factor of 2: a motor on its spring swings at 6 to 25 Hz."""


class SoftWindup(Section):
    """Stiffness missing around zero torsion, −stiffness·exp(−shape·δ²)·δ; if negative, the spring is harder.

    Ulrich, Sasiadek 2011, eqs. (10)–(13).
    """

    stiffness: Number = 0.0  # N m/rad
    shape: NonNegative = 0.0  # 1/rad²


class StiffnessTable(Section):
    """A spring as a data sheet or a test bench has it, in place of one stiffness; odd unless a torsion is negative.

    Either `stiffness` of one number more than `torque`: rates below the first torque, between them and beyond the
    last, as catalogues of harmonic drives have them. Or `torsion` and `torque` of points, joined by a rising cubic
    spline (Fritsch and Butland 1984) or by straight lines, and straight beyond the last.
    """

    torque: Annotated[tuple[Number, ...], Listed]  # N m
    stiffness: Annotated[tuple[Positive, ...], Listed] | None = None  # N m/rad
    torsion: Annotated[tuple[Number, ...], Listed] | None = None  # rad
    interpolation: Literal["monotone", "linear"] = "monotone"

    @model_validator(mode="after")
    def _complete(self) -> "StiffnessTable":
        if (self.stiffness is None) == (self.torsion is None):
            raise refusal("expected either 'stiffness', rates between torques, or 'torsion', that of each torque")
        key = "stiffness" if self.torsion is None else "torsion"
        found, expected = len(getattr(self, key)), len(self.torque) + (key == "stiffness")
        if found != expected or not self.torque:
            raise refusal(f"expected {max(expected, 1)} numbers, got {found}: torque has {len(self.torque)}", key)
        points = [[0.0, 0.0], *(p for p in self.points if p != [0.0, 0.0])] if self._odd else self.points
        if [0.0, 0.0] not in points[:-1]:
            raise refusal("expected a point of torque 0 at torsion 0, and one beyond, where a torsion is negative", key)
        for before, after in pairwise(points):
            if after[0] <= before[0] or after[1] <= before[1]:
                raise refusal("expected torsions and torques that rise from point to point", "torque")
        return self

    @property
    def straight(self) -> bool:
        """Whether straight lines join the points."""
        return self.stiffness is not None or self.interpolation == "linear"

    @property
    def _odd(self) -> bool:
        return self.torsion is None or min(self.torsion) >= 0

    @property
    def points(self) -> list[list[float]]:
        """Torsion [rad] and torque [N m] of each; of rates, a last one so far out that the line beyond it is theirs."""
        if self.stiffness is None:
            return [list(point) for point in zip(self.torsion or (), self.torque, strict=True)]
        torques = (0.0, *self.torque, 2 * self.torque[-1])
        steps = ((b - a) / rate for (a, b), rate in zip(pairwise(torques), self.stiffness, strict=True))
        return [list(point) for point in zip(accumulate(steps), torques[1:], strict=True)]

    @property
    def nominal(self) -> float:
        """Torque over torsion at half the greatest torque given [N m/rad]: the stiffness that designs take."""
        half = 0.5 * self.torque[-1]
        points = [[0.0, 0.0], *(point for point in self.points if point[0] > 0)]
        before, after = next(pair for pair in pairwise(points) if pair[1][1] >= half)
        share = (half - before[1]) / (after[1] - before[1])
        return half / (before[0] + share * (after[0] - before[0]))


class Backlash(Section):
    """Play between motor and link: a smooth dead zone before the spring, with a share `slope` of its stiffness."""

    half_gap: NonNegative = 0.0  # rad; the link is free to turn by as much to either side
    slope: Annotated[Number, Field(gt=0, lt=1)] = 0.01
    rounding: Positive | None = None  # rad; of the corners, a tenth of the half gap unless given


class FrictionElement(Section):
    """Friction inside a transmission, beside its spring: a spring that gives way up to a limit, and remembers its way.

    Dahl (1968); Bouc and Wen (1976) with exponent 1 and β + γ = 1; or an element of Maxwell-slip (Iwan 1966).
    """

    stiffness: Positive  # N m/rad; at rest
    limit: Positive  # N m
    law: Literal["dahl", "bouc-wen", "slip"] = "dahl"
    beta: Annotated[Number, Field(ge=0.5, le=1)] | None = None  # of bouc-wen: 1 is Dahl's, 0.5 unless given
    rounding: Annotated[Number, Field(gt=0, le=1)] | None = None  # of slip: the part of its way over which it begins to

    @model_validator(mode="after")
    def _own_keys(self) -> "FrictionElement":
        for key, law in (("beta", "bouc-wen"), ("rounding", "slip")):
            if getattr(self, key) is not None and self.law != law:
                raise refusal(f"expected none: the law is {self.law}, not {law}", key)
        return self

    @property
    def numbers(self) -> list[float]:
        """Stiffness [N m/rad], limit [N m], recoil and rounding, as the core has them."""
        beta, rounding = 0.5 if self.beta is None else self.beta, 0.1 if self.rounding is None else self.rounding
        shape = {"dahl": [1.0, 1.0], "bouc-wen": [2 * beta - 1, 1.0], "slip": [0.0, rounding]}
        return [self.stiffness, self.limit, *shape[self.law]]

    @property
    def reach(self) -> float:
        """Deflection at the limit [rad]."""
        return self.limit / self.stiffness


class Harmonic(Section):
    """One harmonic of a gear's kinematic error, amplitude·sin(order·turned + phase)."""

    order: Positive  # cycles a turn
    amplitude: Number  # rad, behind the gear
    phase: Number = 0.0  # rad
    of: Literal["motor", "output"] = "motor"  # what turns: the motor's shaft, or the gear's output


class Friction(Section):
    """Friction of a motor or of a bearing."""

    viscous: NonNegative = 0.0  # N m s/rad
    coulomb: NonNegative = 0.0  # N m
    asymmetry: Number = 0.0  # N m; by how much it is more than coulomb forwards, and less backwards
    stribeck: NonNegative = 0.0  # N m; by how much breaking away takes more than coulomb
    stribeck_velocity: Positive = 0.01  # rad/s; at which that has fallen to 1/e
    load: Annotated[Number, Field(ge=0, lt=1)] = 0.0  # share of the torque that the spring transmits, on top

    @model_validator(mode="after")
    def _brakes(self) -> "Friction":
        if abs(self.asymmetry) > self.coulomb:
            raise refusal(
                f"expected at most the coulomb friction of {self.coulomb:g}, got {self.asymmetry:g}", "asymmetry"
            )
        return self


class MotorFriction(Friction):
    """Friction between motor and ground."""


class BearingFriction(Friction):
    """Friction between a link and what carries it."""


class Efficiency(Section):
    """How much of a torque comes through a gear: to the link when its motor drives, to the motor when driven back."""

    driving: Annotated[Number, Field(gt=0, le=1)] = 1.0
    back_driving: Annotated[Number, Field(gt=0, le=1)] = 1.0


class JointConfig(Section):
    """One joint and its drive; with `elastic: false` the link follows its motor."""

    name: Name
    elastic: bool = True
    passive: bool = False  # nothing drives it, nor reads it: a bearing, a link or a base that bends about angle zero
    stiffness: Positive | None = None  # K, N m/rad; an elastic joint has it or a table; `unknown`: see below
    stiffness_known: bool = True  # else `stiffness` is where a calibration begins, to within a factor of 3
    stiffness_table: StiffnessTable | None = None
    backlash: Backlash = Backlash()
    hysteresis: tuple[FrictionElement, ...] = ()  # friction beside the spring, side by side
    ripple: tuple[Harmonic, ...] = ()  # the gear's output stands at θ + their sum
    damping: NonNegative = 0.0  # D, N m s/rad
    motor_inertia: Positive | None = None  # B, kg m²; required when elastic
    gear_ratio: Annotated[Number, AfterValidator(_nonzero)] = 1.0  # negative: the motor turns the other way
    cubic_stiffness: NonNegative = 0.0  # N m/rad³
    soft_windup: SoftWindup = SoftWindup()
    motor_friction: MotorFriction = MotorFriction()
    efficiency: Efficiency = Efficiency()  # of the gear
    link_friction: Vector6 = (0.0,) * 6  # γ₁ … γ₆ of Ulrich, Sasiadek 2011, eq. (14)
    bearing_friction: BearingFriction = BearingFriction()  # of the link too, as motors have it
    mass_scale: Positive = 1.0  # factor on mass and inertia of the link that the joint moves, as the URDF has them

    @model_validator(mode="before")
    @classmethod
    def _begin_somewhere(cls, data: Any) -> Any:
        """In place of a stiffness that is unknown, that with which the motor alone swings at `USUAL_FREQUENCY`."""
        if not (isinstance(data, dict) and data.get("stiffness") == "unknown"):
            return data
        inertia = data.get("motor_inertia")
        if not isinstance(inertia, int | float) or isinstance(inertia, bool) or not 0 < inertia < math.inf:
            raise refusal("expected motor_inertia beside it, which says where a calibration begins", "stiffness")
        return {**data, "stiffness": USUAL_FREQUENCY**2 * float(inertia), "stiffness_known": False}

    @model_validator(mode="after")
    def _table_alone(self) -> "JointConfig":
        """A table stands in for rates; `stiffness` is then its nominal one."""
        if self.stiffness_table is None:
            return self
        nominal = self.stiffness_table.nominal
        if self.stiffness not in (None, nominal):
            raise refusal("expected no stiffness beside a table", "stiffness")
        if self.cubic_stiffness or self.soft_windup.stiffness:
            raise refusal("expected neither cubic_stiffness nor soft_windup beside a table", "stiffness_table")
        self.__dict__["stiffness"] = nominal
        return self

    @model_validator(mode="after")
    def _spring_complete(self) -> "JointConfig":
        for key in ("stiffness",) if self.passive else ("stiffness", "motor_inertia"):
            if self.elastic and getattr(self, key) is None:
                raise refusal(f"missing key '{key}': an elastic joint needs a number greater than 0")
        return self

    @model_validator(mode="after")
    def _passive_alone(self) -> "JointConfig":
        if self.passive and not self.elastic:
            raise refusal("expected an elastic joint: a passive one is a spring", "passive")
        for key in ("motor_inertia", "gear_ratio", "motor_friction", "efficiency", "ripple"):
            if self.passive and key in self.model_fields_set and getattr(self, key) is not None:
                raise refusal("expected none: the joint is passive", key)
        return self

    @model_validator(mode="after")
    def _ripple_turns(self) -> "JointConfig":
        """A gear with an error still turns its output as it turns itself, and behind it is a spring."""
        for key in ("ripple", "hysteresis"):
            if getattr(self, key) and not self.elastic:
                raise refusal("expected none: the joint is rigid", key)
        for index, harmonic in enumerate(self.ripple):
            if harmonic.of == "motor" and "gear_ratio" not in self.model_fields_set:
                raise refusal("missing key 'gear_ratio': the motor's turns are counted by it", "ripple", index, "of")
        change = sum(abs(amplitude * frequency) for amplitude, frequency, _ in self.harmonics)
        if change > 0.2:
            raise refusal(f"expected to change the output's speed by at most 0.2 of it, got {change:.3g}", "ripple")
        return self

    @model_validator(mode="after")
    def _loads_known(self) -> "JointConfig":
        """What a rigid joint transmits depends on accelerations, and those on friction."""
        for key in ("motor_friction", "bearing_friction"):
            if getattr(self, key).load and not self.elastic:
                raise refusal("expected none: the joint is rigid", key, "load")
        if not self.elastic and self.efficiency != Efficiency():
            raise refusal("expected none: the joint is rigid", "efficiency")
        driven = self.gear_loss[1]
        if driven >= 1:
            raise refusal(
                f"expected more than the load friction of {self.motor_friction.load:g}", "efficiency", "back_driving"
            )
        return self

    @property
    def gear_loss(self) -> tuple[float, float]:
        """Friction as a share of the torque that the motor feels, where it drives and where it is driven."""
        load = self.motor_friction.load
        return load + 1 / self.efficiency.driving - 1, load + 1 - self.efficiency.back_driving

    @property
    def harmonics(self) -> list[list[float]]:
        """Amplitude [rad], cycles a turn of the reflected motor angle and phase [rad] of each."""
        turns = {"motor": self.gear_ratio, "output": 1.0}
        return [[each.amplitude, each.order * turns[each.of], each.phase] for each in self.ripple]

    @model_validator(mode="after")
    def _spring_monotone(self) -> "JointConfig":
        """The slope of −k·exp(−a δ²)·δ lies between −k and 2 exp(−3/2) k."""
        windup = self.soft_windup.stiffness
        steepest = max(windup, -2 * math.exp(-1.5) * windup)
        if self.stiffness is not None and windup and steepest >= self.stiffness:
            message = f"expected less than the stiffness {self.stiffness:g} can bear, got {windup:g}"
            raise refusal(f"{message}: the spring's torque must rise with torsion", "soft_windup", "stiffness")
        return self


class RotorConfig(Section):
    """The link that carries a motor's rotor, and the axis of its spin in that link's frame.

    The coupling S(q) of that motor follows from both and from the joint's `gear_ratio` and `motor_inertia`. The link's
    inertia in the URDF has the rotor's mass, but not its spin inertia.
    """

    link: Name
    axis: Annotated[Vector3, AfterValidator(_direction)]


class FrameConfig(Section):
    """A frame fixed to a link: position [m] and roll, pitch, yaw [rad] in the link's frame, as in URDF."""

    link: Name
    xyz: Vector3 = (0.0, 0.0, 0.0)
    rpy: Vector3 = (0.0, 0.0, 0.0)


class Lateness(Section):
    """What is inside a sensor whose readings are of the past."""

    corner_frequency: Positive | None = None  # Hz; of the first-order filter inside the sensor, where it has one
    delay: NonNegative = 0.0  # s; by how much a reading is later than its time stamp says


class SensorConfig(FrameConfig, Lateness):
    """What accelerometers and gyroscopes share."""

    name: Name
    axes: Literal["x", "y", "z", "xy", "xz", "yz", "xyz"] = "xyz"
    noise_std: Positive


class AccelerometerConfig(SensorConfig):
    """A sensor of specific force; columns `<name>_x` and so on."""

    noise_std: Positive = 0.05  # m/s²
    bias: Vector3 = (0.0, 0.0, 0.0)  # m/s², x y z; a log's reading is scale · specific force + bias
    scale: PositiveVector3 = (1.0, 1.0, 1.0)


class GyroscopeConfig(SensorConfig):
    """A sensor of angular velocity; columns `<name>_wx` and so on."""

    noise_std: Positive = 0.001  # rad/s


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


class TolerancesConfig(Section):
    """How far off the values above may be, one standard deviation: the prior of a calibration.

    Shares of the value where it is positive by nature (0.3 is 30 %), else in its unit; of noise, natural logarithms
    of factors.
    """

    stiffness: Positive = 0.2
    cubic_stiffness: Positive = 3e4  # 1/rad², times the stiffness
    damping: Positive = 1.0
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
    motor_noise: Positive = 3.0
    torque_noise: Positive = 3.0
    sensor_noise: Positive = 1.0
    jerk_noise: Positive = 1.0
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
    """All that a URDF cannot say about a robot; joints in the order of the log."""

    rate_hz: Positive | None = None  # of the log; for the reader of the file, nothing depends on it
    gravity: Vector3 = (0.0, 0.0, -9.81)  # m/s², of free fall in the base frame
    joints: Annotated[tuple[JointConfig, ...], AfterValidator(_some)]
    coupling: dict[str, dict[str, Number]] = {}  # S, kg m²: {link's joint: {motor's joint: value}}
    rotors: dict[str, RotorConfig] = {}  # motors carried by links, by the joint that they drive
    counterbalances: tuple[Counterbalance, ...] = ()  # what carries part of the weight
    accelerometers: tuple[AccelerometerConfig, ...] = ()
    gyroscopes: tuple[GyroscopeConfig, ...] = ()
    encoder: EncoderConfig = EncoderConfig()
    torque: TorqueConfig = TorqueConfig()
    link_encoder: LinkEncoderConfig | None = None
    joint_torque: JointTorqueConfig | None = None
    tool: FrameConfig | None = None
    payload: PayloadConfig = PayloadConfig()
    tolerances: TolerancesConfig = TolerancesConfig()
    columns: ColumnsConfig = ColumnsConfig()
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
    def log_columns(self) -> tuple[str, ...]:
        """Every column that a log of this robot may have."""
        signals = ("theta", "dtheta", "tau", "q", "dq", "ddq", "torque", "qref", "dqref", "ddqref")
        motors = (f"{signal}_{joint.name}" for signal in signals for joint in self.joints)
        return ("t", *motors, *self.acceleration_channels, *self.gyroscope_channels)

    @model_validator(mode="after")
    def _driven(self) -> "RobotConfig":
        if all(joint.passive for joint in self.joints):
            raise refusal("expected a joint with a motor: all are passive", "joints")
        return self

    @model_validator(mode="after")
    def _names_unique(self) -> "RobotConfig":
        for key in ("joints", "accelerometers", "gyroscopes"):
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
    def _balanced_joints_known(self) -> "RobotConfig":
        names = [joint.name for joint in self.joints]
        for index, balance in enumerate(self.counterbalances):
            for at, joint in enumerate(balance.joints):
                if joint not in names:
                    raise refusal(f"expected a joint; {suggest(joint, names)}", "counterbalances", index, "joints", at)
        return self

    @model_validator(mode="after")
    def _columns_known(self) -> "RobotConfig":
        for column in self.columns.names:
            if column not in self.log_columns:
                raise refusal(f"unknown column; {suggest(column, self.log_columns)}", "columns", column)
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
