"""Keys of robot.yaml that not every method accounts for; such a method refuses them by name."""

from __future__ import annotations

from collections.abc import Callable

from linkside.errors import EstimatorError

from .robot import Robot
from .transmission import Efficiency

UNKNOWN = "stiffness: unknown"
"""What only a calibration accounts for."""

VARYING = "varying wrenches"
"""Wrenches whose size robot.yaml does not say."""

LATE = ("corner_frequency", "delay")
"""Keys of what makes a sensor late."""


def _late(carrier: str, key: str) -> Callable[[Robot], list[str]]:
    """The sensors of a ``carrier`` that have a key of `LATE`; of joints, the name of their section."""

    def owners(robot: Robot) -> list[str]:
        found = getattr(robot.config, carrier)
        if isinstance(found, tuple):
            return [sensor.name for sensor in found if getattr(sensor, key)]
        return [carrier] if found is not None and getattr(found, key) else []

    return owners


def _frictions(robot: Robot, key: str) -> list[str]:
    """Joints with that key in the friction of their motor or their bearing."""
    return [d.name for d in robot.drives if getattr(d.motor_friction, key) or getattr(d.bearing_friction, key)]


FEATURES: dict[str, Callable[[Robot], list[str]]] = {
    "coupling": lambda robot: [row for row, entries in robot.config.coupling.items() if any(entries.values())],
    "rotors": lambda robot: list(robot.config.rotors),
    "gearing": lambda robot: list(robot.config.gearing),
    "linkages": lambda robot: list(robot.config.linkages),
    "stiffness_table": lambda robot: [drive.name for drive in robot.drives if drive.stiffness_table],
    UNKNOWN: lambda robot: [drive.name for drive in robot.drives if drive.elastic and not drive.stiffness_known],
    "backlash": lambda robot: [drive.name for drive in robot.drives if drive.backlash.half_gap],
    "hysteresis": lambda robot: [drive.name for drive in robot.drives if drive.hysteresis],
    "ripple": lambda robot: [drive.name for drive in robot.drives if drive.ripple],
    "passive": lambda robot: [drive.name for drive in robot.drives if drive.passive],
    "efficiency": lambda robot: [drive.name for drive in robot.drives if drive.efficiency != Efficiency()],
    "load": lambda robot: _frictions(robot, "load"),
    "asymmetry": lambda robot: _frictions(robot, "asymmetry"),
    "wrenches": lambda robot: [one.name for one in robot.config.wrenches],
    VARYING: lambda robot: [one.name for one in robot.varying_wrenches],
    **{key: _late("accelerometers", key) for key in LATE},
    **{f"link_encoder.{key}": _late("link_encoder", key) for key in LATE},
    **{f"joint_torque.{key}": _late("joint_torque", key) for key in LATE},
}
"""By key of robot.yaml, of a section where it is a dotted one: the joints or sensors that have it."""

JOINT_SIDE = tuple(f"{carrier}.{key}" for carrier in ("link_encoder", "joint_torque") for key in LATE)
"""What is inside sensors behind the gears."""

BY_LOAD = ("efficiency", "load")
"""Friction that grows with the torque transmitted."""

BY_ACCELERATION = (
    UNKNOWN,
    "rotors",
    "gearing",
    "linkages",
    "backlash",
    "hysteresis",
    "ripple",
    *BY_LOAD,
    "passive",
    VARYING,
)
"""What an observer that integrates measured accelerations does not account for."""

BY_MOMENTUM = ("rotors", "gearing", *BY_LOAD, "passive", VARYING)
"""The same of one that integrates the equations of motion of rigid links."""

OF_CONTROL = (UNKNOWN, "rotors", "gearing", "hysteresis", "passive", VARYING)
"""The same of control laws."""

WHY = {"passive": "no motor moves it, so no encoder shows where its link is"}
"""Reasons that a key does not give by itself."""

UNSUPPORTED: dict[str, tuple[str, ...]] = {
    "the acceleration-driven observer": (*BY_ACCELERATION, *LATE),
    "the acceleration-driven observer on joint accelerations": BY_ACCELERATION,
    "a filter on the jerk-driven model": (UNKNOWN, "coupling", "rotors"),
    "a filter on the elastic-joint model": (UNKNOWN,),
    "a filter on motors moved by jerk": (UNKNOWN,),
    "a simulation": (UNKNOWN,),
    "a velocity observer": BY_MOMENTUM,
    "a velocity observer on the links": (*BY_MOMENTUM, *JOINT_SIDE),
    "the momentum residual": BY_MOMENTUM,
    "the momentum residual on the links": (*BY_MOMENTUM, *JOINT_SIDE),
    "a particle filter": ("hysteresis", VARYING),
    "inverse dynamics along a motion": OF_CONTROL,
    "state feedback": OF_CONTROL,
    "calibration": ("rotors", "gearing", "linkages", *BY_LOAD, "asymmetry", "passive", "wrenches"),
}
"""Keys that each method does not account for."""


def refuse_unsupported(robot: Robot, method: str) -> None:
    """Raise `EstimatorError` about the first thing that a robot declares and a method does not account for."""
    for key in UNSUPPORTED[method]:
        if owners := FEATURES[key](robot):
            remedy = "calibrate first" if key == UNKNOWN else "use another method, or take it out"
            reason = f": {WHY[key]}" if key in WHY else ""
            raise EstimatorError(
                f"robot.yaml gives {', '.join(map(repr, owners))} {key.rpartition('.')[2]}, which {method} does not "
                f"account for{reason}; {remedy}"
            )
