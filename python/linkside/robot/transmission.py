"""The transmission of a joint in robot.yaml: its spring, play, hysteresis, kinematic error, friction and efficiency."""

from itertools import accumulate, pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from linkside.files.yaml_source import refusal

from .section import Section
from .values import Listed, NonNegative, Number, Positive


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
