"""Compilation of a robot's tree, its drives and sensors into what the core takes."""

import math
from typing import Any

import numpy as np

from linkside.errors import ConfigError
from linkside.files.yaml_source import Source, suggest

from . import gearing, units
from .config import RobotConfig
from .counterbalances import Anchor, Counterbalance
from .joints import JointConfig, RotorConfig
from .rigid import Body, Pose
from .sensors import FrameConfig, SensorConfig, TrackerConfig
from .tree import SINGLE_AXIS, Joint, Tree
from .urdf import impossible
from .wrenches import WrenchConfig

MOTOR_SIGNALS = ("theta", "dtheta", "tau")  # those of its shaft, where a log is of the motor's side
NO_TORSION = 1e-5
"""The torque of so small a torsion counts as none where friction grows with load [rad]."""


def reduce(tree: Tree, config: RobotConfig, source: Source) -> Tree:
    """Lock the joints that are not listed at zero, put on what is said of masses, refuse what cannot be compiled."""
    _refuse_joint_types(tree)
    _refuse_unknown_joints(tree, config, source)
    listed = {joint.name for joint in config.joints} | set(config.linkages)
    reduced = tree.locked([joint.name for joint in tree.joints if joint.name not in listed])
    _refuse_unknown_links(reduced, config, source)
    _refuse_unfit_units(reduced, config, source)
    return _loaded(reduced, config)


def _loaded(tree: Tree, config: RobotConfig) -> Tree:
    """Scale the links' masses, and hang the payload on the tool."""
    bodies = {tree.index[drive.name]: tree.joint(drive.name).body.scaled(drive.mass_scale) for drive in config.joints}
    tree = tree.with_bodies(bodies)
    if config.tool is None or not config.payload.mass:
        return tree
    joint, pose = tree.mount(config.tool)
    payload = Body.point(config.payload.mass, pose.act(np.array(config.payload.xyz)))
    return tree.with_bodies({joint: tree.joints[joint].body + payload})


def unloaded(tree: Tree, config: RobotConfig) -> Tree:
    """Take off what `reduce` put on: the payload, and the factors on masses."""
    if config.tool is not None and config.payload.mass:
        joint, pose = tree.mount(config.tool)
        payload = Body.point(-config.payload.mass, pose.act(np.array(config.payload.xyz)))
        tree = tree.with_bodies({joint: tree.joints[joint].body + payload})
    scales = {tree.index[drive.name]: 1 / drive.mass_scale for drive in config.joints}
    return tree.with_bodies({joint: tree.joints[joint].body.scaled(scale) for joint, scale in scales.items()})


def refuse_impossible_bodies(tree: Tree) -> None:
    """Refuse a negative mass or an inertia that is not positive semidefinite, by the joint that moves it."""
    for joint in tree.joints:
        if fault := impossible(joint.body.mass, joint.body.inertia):
            raise ConfigError(f"body moved by joint '{joint.name}': {fault}")


def describe(config: RobotConfig, tree: Tree) -> dict[str, Any]:
    """Flatten a reduced tree and the drives and sensors on it into plain numbers, as the core takes them."""
    names = [joint.name for joint in config.joints]
    return {
        "gravity": config.gravity,
        "bodies": [_body(joint, [*names, *config.linkages]) for joint in tree.joints],
        "drives": [_drive(joint) for joint in config.joints],
        "coupling": coupling_matrix(config).tolist(),
        "accelerometers": [_sensor(tree, sensor) for sensor in config.accelerometers],
        "gyroscopes": [_sensor(tree, sensor) for sensor in config.gyroscopes],
        "trackers": [_tracker(tree, tracker) for tracker in config.trackers],
        "tool": None if config.tool is None else _frame(tree, config.tool),
        "rotors": [_rotor(tree, config, motor, rotor) for motor, rotor in config.rotors.items()],
        "counterbalances": [_counterbalance(tree, names, balance) for balance in config.counterbalances],
        "wrenches": [_wrench(tree, wrench) for wrench in config.wrenches],
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


def _refuse_joint_types(tree: Tree) -> None:
    for joint in tree.joints:
        if joint.kind not in SINGLE_AXIS:
            freedom = f"{joint.freedom} degree{'s' * (joint.freedom != 1)} of freedom"
            raise ConfigError(
                f"joint '{joint.name}' is {joint.kind} ({freedom}); linkside works on revolute and prismatic joints, "
                "fix it in the URDF"
            )


def _refuse_unknown_joints(tree: Tree, config: RobotConfig, source: Source) -> None:
    known = list(tree.index)
    for index, joint in enumerate(config.joints):
        if joint.name not in known:
            why = "it is fixed" if joint.name in tree.fixed else suggest(joint.name, known)
            raise ConfigError(f"{source.where('joints', index, 'name')}no moving joint '{joint.name}'; {why}")
    for name in config.linkages:
        if name not in known:
            raise ConfigError(f"{source.where('linkages', name)}no moving joint '{name}'; {suggest(name, known)}")


def _refuse_unknown_links(tree: Tree, config: RobotConfig, source: Source) -> None:
    for kind in ("accelerometers", "gyroscopes", "trackers", "wrenches"):
        for index, sensor in enumerate(getattr(config, kind)):
            _refuse_unknown_link(tree, sensor, source.where(kind, index, "link"))
    for motor, rotor in config.rotors.items():
        _refuse_unknown_link(tree, rotor, source.where("rotors", motor, "link"))
    if config.tool is not None:
        _refuse_unknown_link(tree, config.tool, source.where("tool", "link"))
    for index, balance in enumerate(config.counterbalances):
        where = ("counterbalances", index)
        for at, end in enumerate(balance.ends):
            _refuse_unknown_link(tree, end, source.where(*where, "ends", at, "link"), moves=False)
        bodies = {_anchor(tree, end)[0] for end in balance.ends}
        if len(bodies) == 1:
            raise ConfigError(
                f"{source.where(*where, 'ends')}both points are on one link, or on links that no joint parts"
            )
        for at, joint in enumerate(balance.joints):
            if tree.joint(joint).slides:
                raise ConfigError(
                    f"{source.where(*where, 'joints', at)}joint '{joint}' slides, expected one that turns"
                )


def _refuse_unfit_units(tree: Tree, config: RobotConfig, source: Source) -> None:
    for key, fault in column_units(tree, config)[1].items():
        raise ConfigError(f"{source.where('units', key)}{fault}")


def column_units(tree: Tree, config: RobotConfig) -> tuple[dict[str, units.Unit], dict[str, str]]:
    """Units of a log's columns by our names, and by key what is wrong with one; a motor's shaft turns in any case."""
    columns = config.columns_by_kind
    slides = [tree.joint(joint.name).slides for joint in config.joints]
    shafts = MOTOR_SIGNALS if config.columns.motor_side else ()
    of_joints = [kind for kind in columns if kind not in ("t", "acceleration", "rate", "wrench", "position")]
    turning = {c: kind in shafts or not s for kind in of_joints for c, s in zip(columns[kind], slides, strict=True)}
    turning |= {column: column[-2] == "t" for column in columns["wrench"]}
    return units.column_units(config.units, columns, turning)


def _refuse_unknown_link(
    tree: Tree, frame: FrameConfig | RotorConfig | Anchor | TrackerConfig, where: str, *, moves: bool = True
) -> None:
    if frame.link not in tree.link:
        raise ConfigError(f"{where}no link '{frame.link}'; {suggest(frame.link, tree.link)}")
    if moves and frame.link not in tree.moving_links:
        raise ConfigError(f"{where}link '{frame.link}' cannot move: no joint that is listed carries it")


def _body(joint: Joint, names: list[str]) -> dict[str, Any]:
    return {
        "parent": joint.parent,
        "joint": names.index(joint.name),
        "prismatic": joint.slides,
        "rotation": joint.placement.rotation.tolist(),
        "translation": joint.placement.translation.tolist(),
        "axis": joint.axis.tolist(),
        "mass": joint.body.mass,
        "com": joint.body.com.tolist(),
        "inertia": joint.body.inertia.tolist(),
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


def _frame(tree: Tree, frame: FrameConfig) -> dict[str, Any]:
    joint, pose = tree.mount(frame)
    return {"body": joint, "rotation": pose.rotation.tolist(), "translation": pose.translation.tolist()}


def _rotor(tree: Tree, config: RobotConfig, motor: str, rotor: RotorConfig) -> dict[str, Any]:
    link = tree.link[rotor.link]
    index = [joint.name for joint in config.joints].index(motor)
    axis = link.placement.turn(np.array(rotor.axis) / math.hypot(*rotor.axis))
    return {
        "motor": index,
        "body": link.joint,
        "axis": axis.tolist(),
        "ratio": config.joints[index].gear_ratio,
    }


def _anchor(tree: Tree, end: Anchor) -> tuple[int, list[float]]:
    """The body that carries a point, −1 for the base, and where in that body's frame."""
    link = tree.link[end.link]
    return link.joint, link.placement.act(np.array(end.xyz)).tolist()


def _counterbalance(tree: Tree, names: list[str], balance: Counterbalance) -> dict[str, Any]:
    ends = [_anchor(tree, end) for end in balance.ends]
    return balance.compiled(ends, [names.index(joint) for joint in balance.joints])


def _wrench(tree: Tree, wrench: WrenchConfig) -> dict[str, Any]:
    return {
        "place": _frame(tree, wrench),
        "constant": wrench.constant,
        "measured": wrench.kind == "measured",
    }


def _tracker(tree: Tree, tracker: TrackerConfig) -> dict[str, Any]:
    target = SensorConfig.model_validate(tracker.model_dump(include={"name", "link", "xyz", "axes", "noise_std"}))
    place = Pose.of(tracker.place.xyz, tracker.place.rpy)
    return {
        "target": _sensor(tree, target),
        "rotation": place.rotation.tolist(),
        "origin": place.translation.tolist(),
    }


def _sensor(tree: Tree, sensor: SensorConfig) -> dict[str, Any]:
    axes = ["xyz".index(axis) for axis in sensor.axes]
    return {**_frame(tree, sensor), "axes": axes, "noise_std": sensor.noise_std}
