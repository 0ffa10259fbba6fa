"""The robot: kinematics and inertias from a URDF or a Pinocchio model, drives and sensors from robot.yaml."""

import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkside import _core
from linkside.arguments import numbers
from linkside.errors import ConfigError, EstimatorError, RobotWarning
from linkside.files.yaml_source import Source

from . import bodies, gearing
from . import compile as tree
from .config import ColumnsConfig, RobotConfig, RobotFile
from .encoders import EncoderReading, readings
from .joints import JointConfig
from .sensors import AccelerometerConfig, FrameConfig, GyroscopeConfig
from .units import Unit
from .urdf import Urdf

if TYPE_CHECKING:  # pyright does not take a cached property for the property of a protocol
    cached_property = property
else:
    from functools import cached_property

Array = NDArray[np.float64]
Scalar = TypeVar("Scalar", bound=np.generic)
Joints = Iterable[JointConfig | Mapping[str, Any]]


@dataclass(frozen=True, eq=False, repr=False)
class Robot:
    """An elastic-joint robot on a fixed base: made by `load`, `from_urdf` or `from_pinocchio`, then constant.

    Every array is in log order: the order in which the joints are listed, whatever their order in the tree.
    Dynamics take one state, (n,), or a row for each sample, (T, n), and answer likewise; any other shape is
    an EstimatorError that names the argument. SI units, radians (metres where a joint is prismatic).

    Parameters
    ----------
    config : RobotConfig
        What was said about joints, sensors and tool.
    model : pinocchio.Model
        The tree of the listed joints alone, all others locked.
    notes : tuple of str
        Doubts about masses; a method that needs masses warns of them.

    Attributes
    ----------
    core
        The robot compiled for the kernels.
    """

    config: RobotConfig
    model: Any
    notes: tuple[str, ...] = ()
    core: _core.Robot = field(init=False)

    def __post_init__(self) -> None:
        """Compile the robot."""
        object.__setattr__(self, "core", _core.Robot(self.described()))

    def described(self) -> dict[str, Any]:
        """Describe it in plain numbers, as the core takes it."""
        return tree.describe(self.config, self.model)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "Robot":
        """Read a robot.yaml and the URDF that it names.

        Raises
        ------
        ConfigError
            Either file cannot be used: one line that says where, what was expected and what was found.
        """
        source = Source.read(path)
        config = source.validate(RobotFile)
        urdf = Path(path).parent / config.urdf
        if not urdf.is_file():
            raise ConfigError(f"{source.where('urdf')}no such file: {urdf}")
        return cls._from_urdf(Urdf.read(urdf), config, source)

    @classmethod
    def from_urdf(cls, urdf: str | os.PathLike[str], joints: Joints, **settings: Any) -> "Robot":
        """Build a robot from a URDF, its path or its text; meshes are not looked at.

        Parameters
        ----------
        urdf
            Path or XML text.
        joints
            In log order, `JointConfig` or mappings with its keys; all others are locked at neutral.
        **settings
            Further keys of robot.yaml: coupling, accelerometers, gyroscopes, encoder, torque, tool, columns,
            gravity.

        Raises
        ------
        ConfigError
            The URDF or the settings cannot be used.
        """
        source = _settings(joints, settings)
        return cls._from_urdf(Urdf.read(urdf), source.validate(RobotConfig), source)

    @classmethod
    def from_pinocchio(cls, model: Any, joints: Joints, **settings: Any) -> "Robot":
        """Build a robot from a `pinocchio.Model`, gravity included; else as `from_urdf`.

        Sensors and the tool are placed on body frames, or on operational frames, of the model.
        """
        source = _settings(joints, {"gravity": model.gravity.linear, **settings})
        config = source.validate(RobotConfig)
        tree.refuse_impossible_bodies(model)
        reduced = tree.reduce(model, config, source)
        notes = (*bodies.dropped_armature(model, config.joints), *bodies.impossible_moments(reduced))
        return cls(config, reduced, notes)

    @classmethod
    def _from_urdf(cls, urdf: Urdf, config: RobotConfig, source: Source) -> "Robot":
        urdf.refuse_mimics([joint.name for joint in config.joints], config.linkages)
        model = urdf.model()
        reduced = tree.reduce(model, config, source)
        moving = tree.moving_links(reduced)
        urdf.refuse_impossible_bodies(moving)
        urdf.refuse_other(model)
        notes = (*bodies.bare_links(reduced, urdf.bare, moving), *bodies.impossible_moments(reduced))
        return cls(config, reduced, notes)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the robot was made of; it is compiled again when it is read."""
        return Robot, (self.config, self.model, self.notes)

    def __repr__(self) -> str:
        """Name the joints, rigid ones in brackets, and the sensors."""
        joints = " ".join(joint.name if joint.elastic else f"({joint.name})" for joint in self.drives)
        sensors = ", ".join(sensor.name for sensor in (*self.accelerometers, *self.gyroscopes))
        return f"<Robot {self.model.name}: {joints}; sensors: {sensors or 'none'}>"

    def scaled(
        self, *, stiffness: float = 1.0, damping: float = 1.0, motor_inertia: float = 1.0, mass: float = 1.0
    ) -> "Robot":
        """Return a robot with other parameters, such as a specimen that differs from its model: factors on all joints.

        Parameters
        ----------
        stiffness, damping, motor_inertia
            On those of robot.yaml.
        mass
            On mass and inertia of all links, payload included.
        """
        factors = {"stiffness": stiffness, "damping": damping, "motor_inertia": motor_inertia, "mass_scale": mass}
        for name, factor in factors.items():
            if not 0 < factor < np.inf:
                raise ConfigError(f"factor on {name}: {factor}, expected a positive number")
        joints = tuple(
            joint.model_copy(update={name: f * old for name, f in factors.items() if (old := getattr(joint, name))})
            for joint in self.drives
        )
        payload = self.config.payload.model_copy(update={"mass": mass * self.config.payload.mass})
        config = self.config.model_copy(update={"joints": joints, "payload": payload})
        return Robot(config, tree.heavier(self.model, mass), self.notes)

    def require_masses(self, purpose: str, *, elastic_only: bool = False) -> None:
        """Require links with masses, for a method that needs them; warn once of doubts about them.

        Parameters
        ----------
        purpose
            The method, as messages call it.
        elastic_only
            Whether only elastic joints matter to it.

        Raises
        ------
        ConfigError
            A joint moves nothing that has a mass: names its link.
        """
        for drive in self.drives:
            if drive.name in self._massless and (drive.elastic or not elastic_only):
                raise ConfigError(
                    f"link '{self._massless[drive.name]}', which joint '{drive.name}' moves, has no inertia and "
                    f"carries nothing that has: {purpose} needs masses; add an <inertial> to the URDF"
                )
        for note in self._unsaid():
            warnings.warn(f"{note} ({purpose} uses it)", RobotWarning, stacklevel=3)

    @cached_property
    def _massless(self) -> dict[str, str]:
        return bodies.massless(self.model)

    def _unsaid(self) -> tuple[str, ...]:
        """Notes that no method warned of yet."""
        said, _ = "_said" in self.__dict__, self.__dict__.setdefault("_said", True)
        return () if said else self.notes

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.config.joints)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The joints' names."""
        return tuple(joint.name for joint in self.config.joints)

    @cached_property
    def elastic(self) -> NDArray[np.bool_]:
        """Which joints have a spring, (n,); the link of any other follows its motor."""
        return _constant([joint.elastic for joint in self.drives], np.bool_)

    @cached_property
    def passive(self) -> NDArray[np.bool_]:
        """Which joints nothing drives, (n,): a spring holds them at zero, and `theta`, `dtheta`, `tau` are zero."""
        return _constant([joint.passive for joint in self.drives], np.bool_)

    @cached_property
    def gear_ratio(self) -> Array:
        """Turns of the motor for one of the link, (n,); matters only to logs from the motor's side."""
        return _constant([joint.gear_ratio for joint in self.drives], np.float64)

    @cached_property
    def coupling(self) -> Array:
        """Inertial coupling S of motors to links, (n, n), strictly upper triangular [kg m²]."""
        return _constant(tree.coupling_matrix(self.config), np.float64)

    @cached_property
    def gearing(self) -> Array:
        """Γ, (n, n): how far each motor, in columns, turns each joint, both as seen behind their gears.

        A log of motors' positions θ_m and torques τ_m is converted as it is read, θ = Γ θ_m and τ = Γ⁻ᵀ τ_m; live
        samples are to be so already.
        """
        return _constant(gearing.matrix(self.config.gearing, self.names), np.float64)

    @property
    def drives(self) -> tuple[JointConfig, ...]:
        """Spring, motor and friction of each joint."""
        return self.config.joints

    @property
    def accelerometers(self) -> tuple[AccelerometerConfig, ...]:
        """The accelerometers."""
        return self.config.accelerometers

    @property
    def gyroscopes(self) -> tuple[GyroscopeConfig, ...]:
        """The gyroscopes."""
        return self.config.gyroscopes

    @property
    def tool(self) -> FrameConfig | None:
        """The tool centre point, if there is one."""
        return self.config.tool

    @property
    def columns(self) -> ColumnsConfig:
        """What the log calls its columns."""
        return self.config.columns

    @property
    def acceleration_channels(self) -> tuple[str, ...]:
        """Columns of specific force, `<accelerometer>_x` and so on."""
        return self.config.acceleration_channels

    @cached_property
    def acceleration_errors(self) -> tuple[Array, Array]:
        """Bias [m/s²] and scale of each accelerometer channel, (m,) each; a log has them taken off its readings."""
        axes = [(sensor, "xyz".index(axis)) for sensor in self.accelerometers for axis in sensor.axes]
        bias, scale = [sensor.bias[axis] for sensor, axis in axes], [sensor.scale[axis] for sensor, axis in axes]
        return _constant(bias, np.float64), _constant(scale, np.float64)

    @property
    def gyroscope_channels(self) -> tuple[str, ...]:
        """Columns of angular rate, `<gyroscope>_wx` and so on."""
        return self.config.gyroscope_channels

    @cached_property
    def encoder_readings(self) -> dict[str, dict[int, EncoderReading]]:
        """By signal, `theta` or `q`, and by joint: how encoders read that read wrong in a way that is known."""
        each = {
            "theta": [readings(drive.encoder_error, drive.gear_ratio) for drive in self.drives],
            "q": [readings(drive.link_encoder_error, 1.0) for drive in self.drives],
        }
        found = {signal: {j: one for j, one in enumerate(all_) if one is not None} for signal, all_ in each.items()}
        return {signal: of_joints for signal, of_joints in found.items() if of_joints}

    @cached_property
    def column_units(self) -> dict[str, Unit]:
        """Units of a log's columns, by our names, of those that are not in SI units."""
        return tree.column_units(self.model, self.config)[0]

    @cached_property
    def torque_constant(self) -> tuple[float | None, ...]:
        """Torque of a motor's current [N m/A], of those whose is known."""
        return tuple(joint.torque_constant for joint in self.drives)

    @cached_property
    def velocity_index(self) -> NDArray[np.intp]:
        """Where each joint, in log order, stands in Pinocchio's velocity vector, (n,)."""
        return _constant([self._joint(name).idx_v for name in self.names], np.intp)

    def _joint(self, name: str) -> Any:
        return self.model.joints[self.model.getJointId(name)]

    def to_pinocchio(self, q: ArrayLike) -> Array:
        """Order positions as `model` does, (…, n) to (…, model.nq); a continuous joint becomes (cos, sin)."""
        q = np.asarray(q, dtype=np.float64)
        out = np.empty((*q.shape[:-1], self.model.nq))
        for name, value in self.joint_positions(q).items():
            joint = self._joint(name)
            parts = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
            out[..., joint.idx_q : joint.idx_q + joint.nq] = np.stack(parts, axis=-1)
        return out

    def velocity_to_pinocchio(self, dq: ArrayLike) -> Array:
        """Order velocities, accelerations or torques as `model` does, (…, n) to (…, model.nv)."""
        dq = np.asarray(dq, dtype=np.float64)
        out = np.empty((*dq.shape[:-1], self.model.nv))
        out[..., self.velocity_index] = dq
        for name, one in self.config.linkages.items():
            out[..., self._joint(name).idx_v] = one.ratio * dq[..., self.names.index(one.follows)]
        return out

    @cached_property
    def velocity_map(self) -> Array:
        """Pinocchio's velocities by those of the joints, (model.nv, n); times it, a Jacobian is in log order."""
        return _constant(self.velocity_to_pinocchio(np.eye(self.n)).T, np.float64)

    def joint_positions(self, q: ArrayLike) -> dict[str, Array]:
        """Positions of the tree's joints by name, those that linkages move included, of q (…, n)."""
        q = np.asarray(q, dtype=np.float64)
        found = {name: q[..., index] for index, name in enumerate(self.names)}
        return found | {name: one.ratio * found[one.follows] + one.offset for name, one in self.config.linkages.items()}

    def inverse_dynamics(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Torque on the links, M(q) q̈ + C(q, q̇) q̇ + g(q), (T, n) [N m]."""
        return self._rows(self.core.inverse_dynamics, q=q, dq=dq, ddq=ddq)

    def inverse_dynamics_derivatives(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> tuple[Array, Array, Array]:
        """Derivatives of `inverse_dynamics` by q, q̇ and q̈ (the last: mass matrix), three of (T, n, n)."""
        stacked = self._rows(self.core.inverse_dynamics_derivatives, q=q, dq=dq, ddq=ddq)
        return stacked[..., 0, :, :], stacked[..., 1, :, :], stacked[..., 2, :, :]

    def forward_dynamics(
        self, q: ArrayLike, dq: ArrayLike, theta: ArrayLike, dtheta: ArrayLike, tau: ArrayLike
    ) -> tuple[Array, Array]:
        """Accelerations of links and motors, q̈ and θ̈, under motor torques, two of (T, n) [rad/s²].

        Springs, damping, friction and coupling as in robot.yaml: De Luca, Schröder, Thümmel 2007, eq. (2);
        Ulrich, Sasiadek 2011, eqs. (10)–(16). Of a rigid joint `theta` and `dtheta` are not looked at; its motor
        accelerates as its link does.
        """
        self.require_masses("forward dynamics")
        stacked = self._rows(self.core.forward_dynamics, q=q, dq=dq, theta=theta, dtheta=dtheta, tau=tau)
        return stacked[..., 0, :], stacked[..., 1, :]

    def mass_matrix(self, q: ArrayLike) -> Array:
        """Inertia of the links M(q), (T, n, n) [kg m²]."""
        return self._rows(self.core.mass_matrix, q=q)

    def coriolis_matrix(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Coriolis matrix C(q, q̇) from Christoffel symbols, so that Ṁ − 2C is skew, (T, n, n)."""
        return self._rows(self.core.coriolis_matrix, q=q, dq=dq)

    def gravity_torque(self, q: ArrayLike) -> Array:
        """Torque that holds the links against gravity g(q), less what counterbalances carry, (T, n) [N m]."""
        return self._rows(self.core.gravity_torque, q=q)

    def link_friction(self, dq: ArrayLike, load: ArrayLike | None = None) -> Array:
        """Friction torque of the links (Ulrich and Sasiadek 2011, eq. (14)) and of their bearings, (T, n) [N m].

        `load`, (T, n): the torques that their motion takes beside it, none unless given, on which it may depend.
        """
        return self._rows(
            self.core.link_friction, dq=dq, load=np.zeros_like(numbers("dq", dq)) if load is None else load
        )

    def motor_friction(self, dtheta: ArrayLike, load: ArrayLike | None = None) -> Array:
        """Friction torque of the motors, viscous and dry with its Stribeck peak, and their gears', (T, n) [N m].

        `load`, (T, n): the torques that gears ask of motors, none unless given, a share of which is lost.
        """
        rest = np.zeros_like(numbers("dtheta", dtheta))
        return self._rows(self.core.motor_friction, dtheta=dtheta, load=rest if load is None else load)

    def specific_force(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike) -> Array:
        """Readings of the accelerometers, (T, acceleration channels) [m/s²]; +9.81 upward at rest."""
        return self._rows(self.core.specific_force, q=q, dq=dq, ddq=ddq)

    def acceleration_map(self, q: ArrayLike, dq: ArrayLike) -> tuple[Array, Array]:
        """T_A (T, channels, n) and W_A (T, channels): the accelerometers read T_A q̈ + W_A.

        De Luca, Schröder, Thümmel 2007, eq. (10).
        """
        rest = np.zeros_like(numbers("q", q))
        derivatives = self._rows(self.core.specific_force_derivatives, q=q, dq=dq, ddq=rest)
        return derivatives[..., 2, :, :], self.specific_force(q, dq, rest)

    def angular_rate(self, q: ArrayLike, dq: ArrayLike) -> Array:
        """Readings of the gyroscopes, (T, gyroscope channels) [rad/s]."""
        return self._rows(self.core.angular_rate, q=q, dq=dq)

    def tool_position(self, q: ArrayLike) -> Array:
        """Tool position in the base frame, (T, 3) [m]; raises EstimatorError if the robot has none."""
        if self.tool is None:
            raise EstimatorError("the robot has no tool: name one in robot.yaml, `tool: {link: …}`")
        return self._rows(self.core.tool_position, q=q)

    def _rows(self, kernel: Callable[..., Array], **arguments: ArrayLike) -> Array:
        """Call a kernel of (T, n) arrays on those, or on a single state (n,)."""
        arrays = {name: numbers(name, value) for name, value in arguments.items()}
        first, shape = next((name, array.shape) for name, array in arrays.items())
        if len(shape) not in (1, 2) or shape[-1] != self.n:
            raise EstimatorError(f"{first}: expected shape ({self.n},) or (T, {self.n}), got {shape}")
        for name, array in arrays.items():
            if array.shape != shape:
                raise EstimatorError(f"{name}: expected shape {shape}, that of {first}, got {array.shape}")
        out = kernel(*(np.ascontiguousarray(np.atleast_2d(array)) for array in arrays.values()))
        return out if len(shape) == 2 else out[0]


def _settings(joints: Joints, settings: Mapping[str, Any]) -> Source:
    return Source({"joints": list(joints), **settings})


def _constant(values: ArrayLike, dtype: type[Scalar]) -> NDArray[Scalar]:
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array
