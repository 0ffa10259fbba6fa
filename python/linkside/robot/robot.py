"""The robot: kinematics and inertias from a URDF or a Pinocchio model, drives and sensors from robot.yaml."""

import os
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from linkside import _core
from linkside.errors import ConfigError, RobotWarning
from linkside.files.yaml_source import Source

from . import bodies, gearing, pinocchio_model
from . import compile as compiling
from .config import ColumnsConfig, RobotConfig, RobotFile
from .dynamics import Dynamics
from .encoders import EncoderReading, readings
from .joints import JointConfig
from .sensors import AccelerometerConfig, FrameConfig, GyroscopeConfig, ThreeAxes, TrackerConfig
from .tree import Tree
from .units import Unit
from .urdf import Urdf
from .wrenches import WrenchConfig

if TYPE_CHECKING:  # pyright does not take a cached property for the property of a protocol
    cached_property = property
else:
    from functools import cached_property

Array = NDArray[np.float64]
Scalar = TypeVar("Scalar", bound=np.generic)
Joints = Iterable[JointConfig | Mapping[str, Any]]


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Dynamics):
    """An elastic-joint robot on a fixed base: made by `load`, `from_urdf` or `from_pinocchio`, then constant.

    Every array is in log order: the order in which the joints are listed, whatever their order in the tree. Dynamics
    take one state, (n,), or a row for each sample, (T, n), and return the same shape; any other shape raises an
    EstimatorError that names the argument. SI units, radians (metres where a joint is prismatic).

    Parameters
    ----------
    config : RobotConfig
        The description of joints, sensors and tool.
    tree : Tree
        The listed joints alone, all others locked.
    notes : tuple of str
        Doubts about masses; a method that needs masses warns of them.

    Attributes
    ----------
    core
        The robot compiled for the kernels.
    """

    config: RobotConfig
    tree: Tree
    notes: tuple[str, ...] = ()
    core: _core.Robot = field(init=False)

    def __post_init__(self) -> None:
        """Compile the robot."""
        object.__setattr__(self, "core", _core.Robot(self.described()))

    def described(self) -> dict[str, Any]:
        """Describe it in plain numbers, as the core takes it."""
        return compiling.describe(self.config, self.tree)

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
        """Build a robot from a URDF, its path or its text; meshes are not read.

        Parameters
        ----------
        urdf
            Path or XML text.
        joints
            In log order, `JointConfig` or mappings with its keys; all others are locked at neutral.
        **settings
            Further keys of robot.yaml: coupling, accelerometers, gyroscopes, trackers, encoder, torque, tool, columns,
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
        whole = pinocchio_model.read(model)
        compiling.refuse_impossible_bodies(whole)
        reduced = compiling.reduce(whole, config, source)
        notes = (*bodies.dropped_armature(model, config.joints), *bodies.impossible_moments(reduced))
        return cls(config, reduced, notes)

    @classmethod
    def _from_urdf(cls, urdf: Urdf, config: RobotConfig, source: Source) -> "Robot":
        urdf.refuse_mimics([joint.name for joint in config.joints], config.linkages)
        reduced = compiling.reduce(urdf.tree(), config, source)
        urdf.refuse_impossible_bodies(reduced.moving_links)
        notes = (*bodies.bare_links(reduced, urdf.bare), *bodies.impossible_moments(reduced))
        return cls(config, reduced, notes)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle what the robot was made of; it is compiled again when it is read."""
        return Robot, (self.config, self.tree, self.notes)

    def __repr__(self) -> str:
        """Name the joints, rigid ones in brackets, and the sensors."""
        joints = " ".join(joint.name if joint.elastic else f"({joint.name})" for joint in self.drives)
        all_: tuple[ThreeAxes, ...] = (*self.accelerometers, *self.gyroscopes, *self.trackers)
        sensors = ", ".join(sensor.name for sensor in all_)
        return f"<Robot {self.tree.name}: {joints}; sensors: {sensors or 'none'}>"

    def scaled(
        self, *, stiffness: float = 1.0, damping: float = 1.0, motor_inertia: float = 1.0, mass: float = 1.0
    ) -> "Robot":
        """Return a robot with other parameters, such as one that differs from its model: factors on all joints.

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
        return Robot(config, self.tree.heavier(mass), self.notes)

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
            A joint moves no mass; names its link.
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
        return bodies.massless(self.tree)

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
        return _constant(compiling.coupling_matrix(self.config), np.float64)

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
    def trackers(self) -> tuple[TrackerConfig, ...]:
        """What sees points of links from beside the robot."""
        return self.config.trackers

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

    @property
    def varying_wrenches(self) -> tuple[WrenchConfig, ...]:
        """Wrenches from outside that are not constant, which filters have in their state."""
        return tuple(wrench for wrench in self.config.wrenches if wrench.kind != "constant")

    @property
    def position_channels(self) -> tuple[str, ...]:
        """Columns of trackers, `<tracker>_px` and so on."""
        return self.config.position_channels

    @property
    def wrench_channels(self) -> tuple[str, ...]:
        """Columns of force sensors, `<wrench>_fx` and so on."""
        return self.config.wrench_channels

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
        return compiling.column_units(self.tree, self.config)[0]

    @cached_property
    def torque_constant(self) -> tuple[float | None, ...]:
        """Torque of a motor's current [N m/A], of those whose is known."""
        return tuple(joint.torque_constant for joint in self.drives)

    @cached_property
    def model(self) -> Any:
        """The same tree as a `pinocchio.Model`, with its gravity; ImportError if Pinocchio is not there."""
        return pinocchio_model.build(self.tree, self.config.gravity)

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
        for name, value in self.joint_velocities(dq).items():
            out[..., self._joint(name).idx_v] = value
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

    def joint_velocities(self, dq: ArrayLike) -> dict[str, Array]:
        """Velocities, or other rates, of the tree's joints by name, those that linkages move included, of dq (…, n)."""
        dq = np.asarray(dq, dtype=np.float64)
        found = {name: dq[..., index] for index, name in enumerate(self.names)}
        return found | {name: one.ratio * found[one.follows] for name, one in self.config.linkages.items()}


def _settings(joints: Joints, settings: Mapping[str, Any]) -> Source:
    return Source({"joints": list(joints), **settings})


def _constant(values: ArrayLike, dtype: type[Scalar]) -> NDArray[Scalar]:
    array = np.array(values, dtype)
    array.flags.writeable = False
    return array
