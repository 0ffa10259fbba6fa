"""Compilation of a Pinocchio model into the core's kinematic tree."""

import math
import re
from typing import Any

import numpy as np
import pinocchio as pin

from linkside.errors import ConfigError
from linkside.files.yaml_source import Source, suggest

from . import gearing, units
from .config import RobotConfig
from .counterbalances import Anchor, Counterbalance
from .joints import JointConfig, RotorConfig
from .sensors import FrameConfig, SensorConfig
from .urdf import impossible
from .wrenches import WrenchConfig

# About or along any axis; RUB and RevoluteUnbounded are URDF's continuous joints, whose q is (cos, sin).
SINGLE_AXIS = re.compile(r"JointModel(R|RUB|P|Revolute|RevoluteUnbounded|Prismatic)(X|Y|Z|Unaligned)")
UNIQUE = "\x1f"  # ends what makes a frame's name unique for a while
MOTOR_SIGNALS = ("theta", "dtheta", "tau")  # those of its shaft, where a log is of the motor's side
NO_TORSION = 1e-5
"""The torque of so small a torsion counts as none where friction grows with load [rad]."""

LINK_FRAMES = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)


def reduce(model: Any, config: RobotConfig, source: Source) -> Any:
    """Lock the joints that are not listed at neutral, and refuse what cannot be compiled."""
    _refuse_joint_types(model)
    _refuse_unknown_joints(model, config, source)
    listed = {joint.name for joint in config.joints} | set(config.linkages)
    locked = [index for index, name in enumerate(model.names) if index > 0 and name not in listed]
    reduced = _lock(model, locked)
    reduced.gravity.linear = np.array(config.gravity)
    _refuse_unknown_links(reduced, config, source)
    _refuse_unfit_units(reduced, config, source)
    _load(reduced, config)
    return reduced


def _load(model: Any, config: RobotConfig) -> None:
    """Scale the links' masses, and hang the payload on the tool."""
    for joint in config.joints:
        index = model.getJointId(joint.name)
        inertia = model.inertias[index]
        if joint.mass_scale != 1:
            model.inertias[index] = _scaled(inertia, joint.mass_scale)
    if config.tool is not None and config.payload.mass:
        index, pose = mount(model, config.tool)
        at = pose.act(np.array(config.payload.xyz))
        model.inertias[index] += pin.Inertia(config.payload.mass, at, np.zeros((3, 3)))


def heavier(model: Any, factor: float) -> Any:
    """Copy a model with mass and inertia of all links times a factor."""
    model = pin.Model(model)
    for index, inertia in enumerate(model.inertias):
        model.inertias[index] = _scaled(inertia, factor)
    return model


def _scaled(inertia: Any, factor: float) -> Any:
    return pin.Inertia(factor * inertia.mass, inertia.lever, factor * inertia.inertia)


def _lock(model: Any, joints: list[int]) -> Any:
    """Lock joints at neutral. Pinocchio finds its frames by name then, and links may be called as joints are."""
    model = pin.Model(model)
    if not joints:
        return model
    _refuse_unframed_joints(model)
    for index, frame in enumerate(model.frames):
        if index > 0 and frame.type != pin.FrameType.JOINT:
            frame.name = f"{index}{UNIQUE}{frame.name}"
    reduced = pin.buildReducedModel(model, joints, pin.neutral(model))
    for frame in reduced.frames:
        frame.name = frame.name.rpartition(UNIQUE)[2]
    return reduced


def moving_links(model: Any) -> dict[str, int]:
    """The frame of each link that some joint moves, by the link's name."""
    return {name: index for name, index in _links(model).items() if model.frames[index].parentJoint > 0}


def refuse_impossible_bodies(model: Any) -> None:
    """Refuse a negative mass or an inertia that is not positive semidefinite, by the joint that moves it."""
    for name, inertia in list(zip(model.names, model.inertias, strict=True))[1:]:
        if fault := impossible(inertia.mass, inertia.inertia):
            raise ConfigError(f"body moved by joint '{name}': {fault}")


def mount(model: Any, frame: FrameConfig) -> tuple[int, Any]:
    """Find the joint that moves a sensor or the tool, and the pose in that joint's body frame."""
    link = model.frames[_links(model)[frame.link]]
    pose = pin.SE3(pin.rpy.rpyToMatrix(*frame.rpy), np.array(frame.xyz))
    return link.parentJoint, link.placement * pose


def describe(config: RobotConfig, model: Any) -> dict[str, Any]:
    """Flatten a reduced model and the drives and sensors on it into plain numbers, as the core takes them."""
    names = [joint.name for joint in config.joints]
    return {
        "gravity": config.gravity,
        "bodies": _bodies(model, [*names, *config.linkages]),
        "drives": [_drive(joint) for joint in config.joints],
        "coupling": coupling_matrix(config).tolist(),
        "accelerometers": [_sensor(model, sensor) for sensor in config.accelerometers],
        "gyroscopes": [_sensor(model, sensor) for sensor in config.gyroscopes],
        "tool": None if config.tool is None else _frame(model, config.tool),
        "rotors": [_rotor(model, config, motor, rotor) for motor, rotor in config.rotors.items()],
        "counterbalances": [_counterbalance(model, names, balance) for balance in config.counterbalances],
        "wrenches": [_wrench(model, wrench) for wrench in config.wrenches],
        "gearing": _gearing(config, names),
        "followers": [(names.index(one.follows), one.ratio, one.offset) for one in config.linkages.values()],
    }


def coupling_matrix(config: RobotConfig) -> np.ndarray[Any, np.dtype[np.float64]]:
    """S [kg m²], (n, n), strictly upper triangular in log order: De Luca, Schröder, Thümmel 2007, eq. (2)."""
    order = {joint.name: index for index, joint in enumerate(config.joints)}
    matrix = np.zeros((len(order), len(order)))
    for row, entries in config.coupling.items():
        for column, value in entries.items():
            matrix[order[row], order[column]] = value
    return matrix


def _gearing(config: RobotConfig, names: list[str]) -> tuple[list[int], list[float]]:
    """Joints that share motors, and their part of Γ, row by row."""
    joints = gearing.shared(config.gearing, names)
    return joints, gearing.matrix(config.gearing, names)[np.ix_(joints, joints)].ravel().tolist()


def _refuse_joint_types(model: Any) -> None:
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        if not SINGLE_AXIS.fullmatch(joint.shortname()):
            kind = joint.shortname().removeprefix("JointModel").replace("FreeFlyer", "Floating").lower()
            freedom = f"{joint.nv} degree{'s' * (joint.nv != 1)} of freedom"
            raise ConfigError(
                f"joint '{name}' is {kind} ({freedom}); linkside works on revolute and prismatic joints, "
                "fix it in the URDF"
            )


def _refuse_unframed_joints(model: Any) -> None:
    """Pinocchio crashes on locking a joint in a model that lacks the frame of some joint, as one built by hand may."""
    framed = {frame.name for frame in model.frames if frame.type == pin.FrameType.JOINT}
    for name in list(model.names)[1:]:
        if name not in framed:
            raise ConfigError(f"joint '{name}' has no frame: after model.addJoint(…) call model.addJointFrame(…)")


def _refuse_unknown_joints(model: Any, config: RobotConfig, source: Source) -> None:
    known = list(model.names)[1:]
    fixed = [frame.name for frame in model.frames if frame.type == pin.FrameType.FIXED_JOINT]
    for index, joint in enumerate(config.joints):
        if joint.name not in known:
            why = "it is fixed" if joint.name in fixed else suggest(joint.name, known)
            raise ConfigError(f"{source.where('joints', index, 'name')}no moving joint '{joint.name}'; {why}")
    for name in config.linkages:
        if name not in known:
            raise ConfigError(f"{source.where('linkages', name)}no moving joint '{name}'; {suggest(name, known)}")


def _refuse_unknown_links(model: Any, config: RobotConfig, source: Source) -> None:
    for kind in ("accelerometers", "gyroscopes", "wrenches"):
        for index, sensor in enumerate(getattr(config, kind)):
            _refuse_unknown_link(model, sensor, source.where(kind, index, "link"))
    for motor, rotor in config.rotors.items():
        _refuse_unknown_link(model, rotor, source.where("rotors", motor, "link"))
    if config.tool is not None:
        _refuse_unknown_link(model, config.tool, source.where("tool", "link"))
    for index, balance in enumerate(config.counterbalances):
        where = ("counterbalances", index)
        for at, end in enumerate(balance.ends):
            _refuse_unknown_link(model, end, source.where(*where, "ends", at, "link"), moves=False)
        bodies = {_anchor(model, end)[0] for end in balance.ends}
        if len(bodies) == 1:
            raise ConfigError(
                f"{source.where(*where, 'ends')}both points are on one link, or on links that no joint parts"
            )
        for at, joint in enumerate(balance.joints):
            if model.joints[model.getJointId(joint)].shortname().removeprefix("JointModel").startswith("P"):
                raise ConfigError(
                    f"{source.where(*where, 'joints', at)}joint '{joint}' slides, expected one that turns"
                )


def _refuse_unfit_units(model: Any, config: RobotConfig, source: Source) -> None:
    for key, fault in column_units(model, config)[1].items():
        raise ConfigError(f"{source.where('units', key)}{fault}")


def column_units(model: Any, config: RobotConfig) -> tuple[dict[str, units.Unit], dict[str, str]]:
    """Units of a log's columns by our names, and by key what is wrong with one; a motor's shaft turns in any case."""
    columns = config.columns_by_kind
    slides = [model.joints[model.getJointId(j.name)].shortname().startswith("JointModelP") for j in config.joints]
    shafts = MOTOR_SIGNALS if config.columns.motor_side else ()
    of_joints = [kind for kind in columns if kind not in ("t", "acceleration", "rate", "wrench")]
    turning = {c: kind in shafts or not s for kind in of_joints for c, s in zip(columns[kind], slides, strict=True)}
    turning |= {column: column[-2] == "m" for column in columns["wrench"]}
    return units.column_units(config.units, columns, turning)


def _refuse_unknown_link(
    model: Any, frame: FrameConfig | RotorConfig | Anchor, where: str, *, moves: bool = True
) -> None:
    if frame.link not in _links(model):
        raise ConfigError(f"{where}no link '{frame.link}'; {suggest(frame.link, _links(model))}")
    if moves and frame.link not in moving_links(model):
        raise ConfigError(f"{where}link '{frame.link}' cannot move: no joint that is listed carries it")


def _links(model: Any) -> dict[str, int]:
    return {frame.name: index for index, frame in enumerate(model.frames) if frame.type in LINK_FRAMES}


def _bodies(model: Any, names: list[str]) -> list[dict[str, Any]]:
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    return [_body(model, data, index, names) for index in range(1, model.njoints)]


def _body(model: Any, data: Any, index: int, names: list[str]) -> dict[str, Any]:
    placement, inertia = model.jointPlacements[index], model.inertias[index]
    linear, angular = np.split(np.asarray(data.joints[index].S).reshape(6), 2)
    return {
        "parent": model.parents[index] - 1,
        "joint": names.index(model.names[index]),
        "prismatic": bool(linear.any()),
        "rotation": placement.rotation.tolist(),
        "translation": placement.translation.tolist(),
        "axis": (linear + angular).tolist(),  # one of them is zero
        "mass": inertia.mass,
        "com": inertia.lever.tolist(),
        "inertia": inertia.inertia.tolist(),
    }


def _drive(joint: JointConfig) -> dict[str, Any]:
    bearing, no_load = joint.bearing_friction, NO_TORSION * (joint.stiffness or 0.0)
    return {
        "elastic": joint.elastic,
        "stiffness": joint.stiffness or 0.0,
        "damping": joint.damping,
        "motor_inertia": math.inf if joint.passive else joint.motor_inertia or 0.0,
        "cubic_stiffness": joint.cubic_stiffness,
        "soft_windup_stiffness": joint.soft_windup.stiffness,
        "soft_windup_shape": joint.soft_windup.shape,
        "curve": joint.stiffness_table.points if joint.stiffness_table else [],
        "curve_straight": bool(joint.stiffness_table and joint.stiffness_table.straight),
        "gap": [
            joint.backlash.half_gap,
            joint.backlash.slope,
            joint.backlash.rounding or 0.1 * joint.backlash.half_gap,
        ],
        "hysteresis": [element.numbers for element in joint.hysteresis],
        "ripple": joint.harmonics,
        "encoder_lines": [cycles for _, cycles in joint.encoder_error.unknown(joint.gear_ratio)],
        "friction_viscous": joint.motor_friction.viscous,
        "friction_coulomb": joint.motor_friction.coulomb,
        "friction_stribeck": joint.motor_friction.stribeck,
        "friction_stribeck_velocity": joint.motor_friction.stribeck_velocity,
        "friction_asymmetry": joint.motor_friction.asymmetry,
        "gear_loss": [*joint.gear_loss, no_load],
        "link_friction": list(joint.link_friction),
        "bearing": [bearing.viscous, bearing.coulomb, bearing.stribeck, bearing.stribeck_velocity, bearing.asymmetry],
        "bearing_loss": [bearing.load, bearing.load, no_load],
    }


def _frame(model: Any, frame: FrameConfig) -> dict[str, Any]:
    joint, pose = mount(model, frame)
    return {"body": joint - 1, "rotation": pose.rotation.tolist(), "translation": pose.translation.tolist()}


def _rotor(model: Any, config: RobotConfig, motor: str, rotor: RotorConfig) -> dict[str, Any]:
    link = model.frames[_links(model)[rotor.link]]
    index = [joint.name for joint in config.joints].index(motor)
    axis = link.placement.rotation @ (np.array(rotor.axis) / np.linalg.norm(rotor.axis))
    return {
        "motor": index,
        "body": link.parentJoint - 1,
        "axis": axis.tolist(),
        "ratio": config.joints[index].gear_ratio,
    }


def _anchor(model: Any, end: Anchor) -> tuple[int, list[float]]:
    """The body that carries a point, −1 for the base, and where in that body's frame."""
    link = model.frames[_links(model)[end.link]]
    return link.parentJoint - 1, link.placement.act(np.array(end.xyz)).tolist()


def _counterbalance(model: Any, names: list[str], balance: Counterbalance) -> dict[str, Any]:
    ends = [_anchor(model, end) for end in balance.ends]
    return balance.compiled(ends, [names.index(joint) for joint in balance.joints])


def _wrench(model: Any, wrench: WrenchConfig) -> dict[str, Any]:
    return {
        "place": _frame(model, wrench),
        "constant": wrench.constant,
        "measured": wrench.kind == "measured",
    }


def _sensor(model: Any, sensor: SensorConfig) -> dict[str, Any]:
    axes = ["xyz".index(axis) for axis in sensor.axes]
    return {**_frame(model, sensor), "axes": axes, "noise_std": sensor.noise_std}
