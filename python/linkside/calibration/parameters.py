"""Parameters that can be freed: unit, value in robot.yaml, tolerance and bounds of each."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.files.yaml_source import suggest
from linkside.robot import Robot
from linkside.robot.config import TolerancesConfig
from linkside.robot.considered import brakes
from linkside.robot.joints import JointConfig
from linkside.robot.sensors import AccelerometerConfig, Lateness, LinkEncoderConfig

CoreName = tuple[str, int, int]
Bounds = Mapping[str, tuple[float, float]]
Owner = Literal[
    "joint",
    "element",
    "coupling",
    "payload",
    "payload axis",
    "sensor",
    "sensor axis",
    "link encoders",
    "motor torques",
]

AXES = "xyz"
SHORTEST_FILTER = 1e-5
"""A filter with a shorter time constant is not there, for any reading that a log can hold [s]."""


@dataclass(frozen=True)
class Kind:
    """What parameters of a kind have in common.

    Attributes
    ----------
    owner
        What has one of these each.
    unit : str
        Its unit.
    relative : bool
        Whether its tolerance is a share of its value; it is then positive and varied by its logarithm.
    least : float
        Lower bound.
    """

    owner: Owner
    unit: str
    relative: bool = False
    least: float = -np.inf


KINDS = {
    "stiffness": Kind("joint", "N m/rad", relative=True),
    "cubic_stiffness": Kind("joint", "N m/rad³", least=0.0),
    "damping": Kind("joint", "N m s/rad", relative=True),
    "hysteresis_stiffness": Kind("element", "N m/rad", relative=True),
    "hysteresis_limit": Kind("element", "N m", relative=True),
    "motor_inertia": Kind("joint", "kg m²", relative=True),
    "viscous": Kind("joint", "N m s/rad", relative=True),
    "coulomb": Kind("joint", "N m", relative=True),
    "mass_scale": Kind("joint", "", relative=True),
    "link_friction": Kind("joint", "", relative=True),
    "link_coulomb": Kind("joint", "N m", least=0.0),
    "half_gap": Kind("joint", "rad", least=0.0),
    "torque_constant": Kind("joint", "", relative=True),
    "torque_delay": Kind("motor torques", "s"),
    "coupling": Kind("coupling", "kg m²"),
    "payload_mass": Kind("payload", "kg", least=0.0),
    "payload_xyz": Kind("payload axis", "m"),
    "translation": Kind("sensor axis", "m"),
    "rotation": Kind("sensor axis", "rad"),
    "bias": Kind("sensor axis", "m/s²"),
    "scale": Kind("sensor axis", "", relative=True),
    "time_constant": Kind("sensor", "s", least=SHORTEST_FILTER),
    "delay": Kind("sensor", "s", least=0.0),
    "link_time_constant": Kind("link encoders", "s", least=SHORTEST_FILTER),
    "link_delay": Kind("link encoders", "s", least=0.0),
    "sensor_noise": Kind("sensor", "", relative=True),
}
"""All kinds of parameters, by name."""

LITTLE = 0.1
"""Tolerance of a damping that robot.yaml does not state, as a share of what is critical, where that of others is 1."""

UNKNOWN = float(np.log(3))
"""Tolerance of a stiffness that robot.yaml does not know."""

NOISE = ("sensor_noise",)
"""Kinds that say how uncertain readings are; factors on what robot.yaml says."""

TOLERANCES = {
    **{"link_time_constant": "time_constant", "link_delay": "delay", "torque_delay": "delay"},
    **{"link_coulomb": "lost_motion", "half_gap": "lost_motion"},
}
"""Keys of robot.yaml's `tolerances`, of kinds that do not have one by their own name."""

OF_LINK_ENCODERS = ("link_time_constant", "link_delay")
"""Kinds of the encoders behind the gears, all of them alike: their first-order filter."""

NOISE_RANGE = (0.03, 1e3)
"""Factors on noise: below, an encoder would be better than its steps."""


OF_ELEMENTS = ("hysteresis_stiffness", "hysteresis_limit")
"""Kinds of friction elements beside a spring."""

TORQUE_ONLY = ("motor_inertia", "viscous", "coulomb", "coupling", "torque_constant", "torque_delay")
"""Kinds that are identifiable only from motor torques."""

OF_RESPONSE = (*OF_LINK_ENCODERS, "link_friction", "link_coulomb", "half_gap", *OF_ELEMENTS, *TORQUE_ONLY)
"""Kinds that the Kalman filter that judges an outcome takes as robot.yaml has them, or does not depend on."""

BY_MASS = (
    *("stiffness", "cubic_stiffness", "damping", "mass_scale", "payload_mass"),
    *("link_friction", "link_coulomb", *OF_ELEMENTS),
)
"""Kinds that a motion shows in proportion to masses only."""

BESIDE = ("half_gap", "mass_scale", "link_friction", "translation", "rotation", "scale")
"""Kinds of which little is sought, but robot.yaml is hardly right: held, they would make springs wrong."""

BY_LINK_ENCODERS = (*OF_LINK_ENCODERS, "link_coulomb")
"""Kinds that are freed only where encoders show what links do, unless they are asked for."""

DEFAULT = (
    *("stiffness", "cubic_stiffness", "damping", *OF_ELEMENTS),
    *("motor_inertia", "viscous", "coulomb", "torque_constant"),
    *("torque_delay", "payload_mass", "bias", "time_constant", "delay", *BY_LINK_ENCODERS, *BESIDE, *NOISE),
)
"""Kinds that are freed by default, as far as the recordings distinguish them."""


@dataclass(frozen=True)
class Parameter:
    """One number that may be free.

    It is varied as a number z that is 0 at the value of robot.yaml and ±1 at the ends of its tolerance, so that all
    parameters are of one size and the prior is N(0, 1): value = start·exp(tolerance·z) for positive ones, start +
    tolerance·z for others.

    Attributes
    ----------
    name : str
        As users type it, such as ``stiffness_axis2``.
    kind : str
        Key of `KINDS`.
    core : tuple
        What the core calls it: kind, then indices.
    start : float
        Value in robot.yaml, or what stands for it where that is zero.
    tolerance : float
        One standard deviation of the prior: relative for positive parameters.
    low, high : float
        Bounds of its value.
    stated : bool
        Whether robot.yaml says anything of it.
    """

    name: str
    kind: str
    core: CoreName
    start: float
    tolerance: float
    low: float
    high: float
    stated: bool = True

    @property
    def unit(self) -> str:
        """Its unit."""
        return KINDS[self.kind].unit

    @property
    def relative(self) -> bool:
        """Whether it is varied by its logarithm; what robot.yaml does not state may be zero."""
        return KINDS[self.kind].relative and self.stated

    def value(self, z: float) -> float:
        """Give the physical value."""
        if self.relative:
            return float(self.start * np.exp(self.tolerance * z))
        return self.start + self.tolerance * z

    def slope(self, z: float) -> float:
        """Give the derivative of the value by z."""
        return self.tolerance * (self.value(z) if self.relative else 1.0)

    def z(self, value: float) -> float:
        """Give the number that a value stands for; infinite for a bound that is."""
        if self.relative:
            with np.errstate(divide="ignore"):
                return float(np.log(np.maximum(value, 0.0) / self.start) / self.tolerance)
        return (value - self.start) / self.tolerance

    def exceeds(self, z: float) -> bool:
        """Whether a value is at a bound, to within a thousandth of its tolerance."""
        return bool(min(z - self.z(self.low), self.z(self.high) - z) < 1e-3)


def catalogue(robot: Robot, torque: bool) -> list[Parameter]:
    """All parameters of a robot; with ``torque``, also those that are identifiable only from motor torques."""
    tolerances = robot.config.tolerances
    kinds = [kind for kind in KINDS if torque or kind not in TORQUE_ONLY]
    return [parameter for kind in kinds for parameter in _of_kind(robot, kind, tolerances)]


def choose(robot: Robot, free: Iterable[str] | None, torque: bool, bounds: Bounds) -> list[Parameter]:
    """Parameters to try: by kind or by name, `DEFAULT` where nothing is said.

    Raises
    ------
    EstimatorError
        A name that is none, or bounds that contradict each other or the value they start from.
    """
    everything = catalogue(robot, torque)
    names = [p.name for p in everything]
    wanted = DEFAULT if free is None else tuple(free)
    for name in () if free is None else wanted:
        if name not in names and name not in {p.kind for p in everything}:
            _refuse_unknown(name, [*KINDS, *names], torque)
    chosen = [p for p in everything if p.kind in wanted or p.name in wanted]
    if free is None and not torque:
        chosen = [p for p in chosen if p.name != f"mass_scale_{_heaviest(robot)}"]
    for name in bounds:
        if name not in [p.name for p in chosen]:
            raise EstimatorError(f"bounds: {name!r} is not free; {suggest(name, [p.name for p in chosen])}")
    return [_bounded(p, bounds[p.name]) if p.name in bounds else p for p in chosen]


def beside(robot: Robot, free: Iterable[Parameter]) -> list[Parameter]:
    """Parameters that are held while ``free`` are found, and of which robot.yaml is hardly right.

    Their tolerances are those of a calibration where robot.yaml has one.
    """
    taken = {*(p.name for p in free), f"mass_scale_{_heaviest(robot)}"}
    known = robot.config.tolerances.calibrated
    kinds = (*BESIDE, "time_constant", "delay", *OF_LINK_ENCODERS)
    held = (p for p in catalogue(robot, False) if p.kind in kinds and p.name not in taken)
    return [replace(p, tolerance=known.get(p.name, p.tolerance)) for p in held]


def _heaviest(robot: Robot) -> str:
    """The joint that moves the heaviest link: forces and masses that all grow alike show in no motion, so that its mass
    is what others are measured by."""
    masses = [robot.tree.joint(name).body.mass for name in robot.names]
    return robot.names[int(np.argmax(masses))]


def by_unit(robot: Robot, free: Sequence[Parameter], z: FloatArray) -> FloatArray:
    """By how much values change that are measured by the mass of the heaviest link if that is one tolerance off, (p,).

    Their prior is wider by that, all of them together: robot.yaml's values are not by that mass.
    """
    if any(p.name == f"mass_scale_{_heaviest(robot)}" for p in free):
        return np.zeros(len(free))
    share = robot.config.tolerances.mass_scale
    pairs = zip(free, z.tolist(), strict=True)
    return np.array([share * p.value(x) / p.slope(x) if p.kind in BY_MASS else 0.0 for p, x in pairs])


def _refuse_unknown(name: str, known: Sequence[str], torque: bool) -> None:
    if not torque and any(name.startswith(kind) for kind in TORQUE_ONLY):
        raise EstimatorError(f"free: {name!r} shows in motor torque only, and a log has none (columns tau_<joint>)")
    raise EstimatorError(f"free: {name!r} is no parameter of this robot; {suggest(name, known)}")


def _bounded(parameter: Parameter, bounds: tuple[float, float]) -> Parameter:
    low, high = bounds
    least = KINDS[parameter.kind].least if not parameter.relative else 0.0
    if not (low < high and high > least):
        raise EstimatorError(f"bounds: {parameter.name} from {low:g} to {high:g} leave no value")
    if not low <= parameter.start <= high:
        raise EstimatorError(
            f"bounds: {parameter.name} from {low:g} to {high:g} leave out {parameter.start:g}, its value in robot.yaml"
        )
    return replace(parameter, low=max(low, least), high=high)


def _of_kind(robot: Robot, kind: str, tolerances: TolerancesConfig) -> list[Parameter]:
    owner, tolerance = KINDS[kind].owner, getattr(tolerances, TOLERANCES.get(kind, kind))
    sensors = list(enumerate(robot.accelerometers))
    if owner == "joint":
        inertia = robot.mass_matrix(np.zeros((1, robot.n)))[0].diagonal().tolist()
        return [_of_joint(kind, j, d, tolerance, inertia[j]) for j, d in enumerate(robot.drives) if _has(d, kind)]
    if owner == "element":
        return [
            _made(kind, f"{kind}_{_of_element(d, i)}", (j, i), getattr(element, kind.partition("_")[2]), tolerance)
            for j, d in enumerate(robot.drives)
            for i, element in enumerate(d.hysteresis)
        ]
    if owner == "coupling":
        pairs = [(i, j) for i in range(robot.n) for j in range(i + 1, robot.n) if robot.elastic[[i, j]].all()]
        names = robot.names
        values = robot.coupling
        return [_made(kind, f"coupling_{names[i]}_{names[j]}", (i, j), values[i, j], tolerance) for i, j in pairs]
    if owner == "link encoders":
        stated = robot.config.link_encoder or LinkEncoderConfig()
        return [_made(kind, kind, (0, 0), _of_sensor(stated, kind.removeprefix("link_")), tolerance)]
    if owner == "motor torques":
        return [_made(kind, kind, (0, 0), 0.0, tolerance)]
    if owner in ("payload", "payload axis"):
        return _of_payload(robot, kind, tolerance)
    if owner == "sensor":
        return [_made(kind, f"{kind}_{s.name}", (i, 0), _of_sensor(s, kind), tolerance) for i, s in sensors]
    axes = [(i, s, a) for i, s in sensors for a in range(3) if AXES[a] in s.axes or kind in ("translation", "rotation")]
    return [_made(kind, f"{kind}_{s.name}_{AXES[a]}", (i, a), _of_axis(s, kind, a), tolerance) for i, s, a in axes]


def _of_element(drive: JointConfig, index: int) -> str:
    """What an element is called: as its joint, with a number if that has several."""
    return f"{drive.name}_{index + 1}" if len(drive.hysteresis) > 1 else drive.name


def _has(drive: JointConfig, kind: str) -> bool:
    """Whether a drive has a parameter of a kind."""
    if kind == "mass_scale":
        return True
    friction = {"link_friction": brakes(drive), "link_coulomb": not brakes(drive)}
    springs = dict.fromkeys(("stiffness", "cubic_stiffness"), drive.stiffness_table is None)
    return drive.elastic and {**friction, **springs, "half_gap": bool(drive.backlash.half_gap)}.get(kind, True)


def _made(kind: str, name: str, index: tuple[int, int], start: float, tolerance: float) -> Parameter:
    low, high = KINDS[kind].least, np.inf
    if kind in NOISE:
        low, high = NOISE_RANGE
    elif KINDS[kind].relative:
        low, high = start / 100, start * 100
    return Parameter(name, kind, (kind, *index), max(start, KINDS[kind].least), tolerance, low, high)


def _of_joint(kind: str, index: int, drive: JointConfig, tolerance: float, inertia: float) -> Parameter:
    """Damping that robot.yaml does not state is none, up to what is critical with the link's ``inertia`` at q = 0."""
    stiffness = drive.stiffness or 0.0
    values = {
        "stiffness": stiffness,
        "cubic_stiffness": drive.cubic_stiffness,
        "damping": drive.damping,
        "motor_inertia": drive.motor_inertia or 0.0,
        "viscous": drive.motor_friction.viscous or 1e-3 * (drive.motor_inertia or 0.0),
        "coulomb": drive.motor_friction.coulomb or 1e-5 * stiffness,
        "mass_scale": drive.mass_scale,
        "link_coulomb": 0.0,
        "half_gap": drive.backlash.half_gap,
    }
    if kind == "stiffness" and not drive.stiffness_known:
        tolerance = UNKNOWN
    if kind in ("cubic_stiffness", "link_coulomb"):  # a friction that twists the spring by so much
        tolerance *= stiffness
    made = _made(kind, f"{kind}_{drive.name}", (index, 0), values.get(kind, 1.0), tolerance)
    if kind == "damping" and not drive.damping:
        critical = float(2 * np.sqrt(stiffness * inertia))
        return replace(made, tolerance=tolerance * LITTLE * critical, low=0.0, high=critical, stated=False)
    return made


def _of_payload(robot: Robot, kind: str, tolerance: float) -> list[Parameter]:
    if robot.tool is None:
        return []
    payload = robot.config.payload
    if kind == "payload_mass":
        return [_made(kind, kind, (0, 0), payload.mass, tolerance)]
    return [_made(kind, f"payload_{AXES[a]}", (0, a), payload.xyz[a], tolerance) for a in range(3)]


def _of_sensor(sensor: Lateness, kind: str) -> float:
    if kind == "time_constant":
        return 1 / (2 * np.pi * sensor.corner_frequency) if sensor.corner_frequency else SHORTEST_FILTER
    return sensor.delay if kind == "delay" else 1.0


def _of_axis(sensor: AccelerometerConfig, kind: str, axis: int) -> float:
    return {"bias": sensor.bias[axis], "scale": sensor.scale[axis]}.get(kind, 0.0)
