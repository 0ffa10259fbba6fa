"""Joints in robot.yaml: the spring between motor and link, the motor, the gear and their friction."""

import math
from itertools import accumulate, pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from linkside.files.yaml_source import refusal

from .section import Name, Section
from .values import NonNegative, Number, Positive, Vector3, Vector6, listed, nonzero


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

    torque: Annotated[tuple[Number, ...], BeforeValidator(listed)]  # N m
    stiffness: Annotated[tuple[Positive, ...], BeforeValidator(listed)] | None = None  # N m/rad
    torsion: Annotated[tuple[Number, ...], BeforeValidator(listed)] | None = None  # rad
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


class MotorFriction(Section):
    """Friction between motor and ground."""

    viscous: NonNegative = 0.0  # N m s/rad
    coulomb: NonNegative = 0.0  # N m
    stribeck: NonNegative = 0.0  # N m; by how much breaking away takes more than coulomb
    stribeck_velocity: Positive = 0.01  # rad/s; at which that has fallen to 1/e


class JointConfig(Section):
    """One joint and its drive; with `elastic: false` the link follows its motor."""

    name: Name
    elastic: bool = True
    stiffness: Positive | None = None  # K, N m/rad; an elastic joint has it or a table; `unknown`: see below
    stiffness_known: bool = True  # else `stiffness` is where a calibration begins, to within a factor of 3
    stiffness_table: StiffnessTable | None = None
    backlash: Backlash = Backlash()
    hysteresis: tuple[FrictionElement, ...] = ()  # friction beside the spring, side by side
    ripple: tuple[Harmonic, ...] = ()  # the gear's output stands at θ + their sum
    damping: NonNegative = 0.0  # D, N m s/rad
    motor_inertia: Positive | None = None  # B, kg m²; required when elastic
    torque_constant: Positive | None = None  # N m/A; torque of a motor's current, on the side of the gear of the log's
    gear_ratio: Annotated[Number, AfterValidator(nonzero)] = 1.0  # negative: the motor turns the other way
    cubic_stiffness: NonNegative = 0.0  # N m/rad³
    soft_windup: SoftWindup = SoftWindup()
    motor_friction: MotorFriction = MotorFriction()
    link_friction: Vector6 = (0.0,) * 6  # γ₁ … γ₆ of Ulrich, Sasiadek 2011, eq. (14)
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
        for key in ("stiffness", "motor_inertia"):
            if self.elastic and getattr(self, key) is None:
                raise refusal(f"missing key '{key}': an elastic joint needs a number greater than 0")
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
