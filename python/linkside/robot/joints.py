"""Joints in robot.yaml: the transmission between motor and link, and the motor."""

import math
from typing import Annotated, Any

from pydantic import AfterValidator, model_validator

from linkside.files.yaml_source import refusal

from .encoders import STEEPEST, EncoderError
from .section import Name, Section
from .transmission import (
    Backlash,
    BearingFriction,
    Efficiency,
    FrictionElement,
    Harmonic,
    MotorFriction,
    SoftWindup,
    StiffnessTable,
)
from .values import NonNegative, Number, Positive, Vector3, Vector6, nonzero


def _direction(value: tuple[float, ...]) -> tuple[float, ...]:
    if not any(value):
        raise refusal("expected a direction, got three zeros")
    return value


USUAL_FREQUENCY = 80.0
"""√(K/B) of a robot's joint [rad/s], to within a factor of 2: a motor on its spring swings at 6 to 25 Hz."""


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
    encoder_error: EncoderError = EncoderError()  # of the motor's encoder, `theta` and `dtheta`
    link_encoder_error: EncoderError = EncoderError()  # of the link's, `q`
    damping: NonNegative = 0.0  # D, N m s/rad
    motor_inertia: Positive | None = None  # B, kg m²; required when elastic
    torque_constant: Positive | None = None  # N m/A; torque of a motor's current, on the side of the gear of the log's
    gear_ratio: Annotated[Number, AfterValidator(nonzero)] = 1.0  # negative: the motor turns the other way
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
        """A table replaces the other stiffness values; `stiffness` is then its nominal value."""
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
        for key in (
            "motor_inertia",
            "torque_constant",
            "gear_ratio",
            "motor_friction",
            "efficiency",
            "ripple",
            "encoder_error",
        ):
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
    def _encoders_rise(self) -> "JointConfig":
        for key in ("encoder_error", "link_encoder_error"):
            error = getattr(self, key)
            for index, harmonic in enumerate(error.harmonics):
                where = (key, "harmonics", index, "of")
                if harmonic.of == "motor" and key == "link_encoder_error":
                    raise refusal("expected 'output': the link's encoder turns with the link", *where)
                if harmonic.of == "motor" and "gear_ratio" not in self.model_fields_set:
                    raise refusal("missing key 'gear_ratio': the motor's turns are counted by it", *where)
            steepness = error.steepness(self.gear_ratio)
            if steepness > STEEPEST:
                raise refusal(
                    f"expected to change a reading's rate by at most {STEEPEST:g} of it, got {steepness:.3g}", key
                )
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


class LinkageConfig(Section):
    """A joint of the URDF that another one moves, by rods or belts: it stands at ratio·position + offset.

    Parallel linkages are trees so: an arm's rods keep a carrier upright that its shoulder turns, by a ratio of -1.
    """

    follows: Name
    ratio: Annotated[Number, AfterValidator(nonzero)] = 1.0
    offset: Number = 0.0  # rad, or m


class RotorConfig(Section):
    """The link that carries a motor's rotor, and the axis of its spin in that link's frame.

    The coupling S(q) of that motor follows from both and from the joint's `gear_ratio` and `motor_inertia`. The link's
    inertia in the URDF has the rotor's mass, but not its spin inertia.
    """

    link: Name
    axis: Annotated[Vector3, AfterValidator(_direction)]
