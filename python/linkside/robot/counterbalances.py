"""The section `counterbalances` of robot.yaml: springs that carry part of a robot's weight."""

from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from linkside.files.yaml_source import refusal

from .section import Name, Section
from .values import NonNegative, Number, Positive, Vector3

PIECES = ("spring", "gas", "series")
"""Of these a counterbalance has one."""


class Anchor(Section):
    """A point that a link carries: one that moves, or one of the base."""

    link: Name
    xyz: Vector3 = (0.0, 0.0, 0.0)  # m, in the link's frame


class CoilSpring(Section):
    """A mechanical spring between two points: it pulls with stiffness · (distance − length)."""

    stiffness: Positive  # N/m
    length: Number  # m; where it is slack, below zero where it pulls at any distance


class GasSpring(Section):
    """A cylinder with gas between two points: pressure · volumeⁿ is constant, its excess over ambient pushes.

    One that pushes has its gas in the cylinder; one that pulls presses oil into an accumulator as it is drawn out.
    """

    pressure: Positive  # Pa, absolute
    volume: Positive  # m³, of the gas
    length: Positive  # m; the distance of the points at which pressure and volume are given
    area: Positive  # m²; of the rod where it pushes, of the piston around the rod where it pulls
    acts: Literal["push", "pull"] = "push"
    exponent: Annotated[Number, Field(ge=1, le=2)] = 1.2  # 1 where heat has time to leave; 1.4 where it has none
    ambient: NonNegative = 101325.0  # Pa


class TorqueHarmonic(Section):
    """One harmonic of a torque over an angle: cosine · cos(order · angle) + sine · sin(order · angle)."""

    order: Annotated[int, Field(strict=True, ge=0, le=100)]  # cycles a turn; 0 for a torque that is always there
    cosine: Number = 0.0  # N m
    sine: Number = 0.0  # N m


class Counterbalance(Section):
    """A spring or a gas spring between two `ends`, or a Fourier `series` of torque over angles of `joints`."""

    ends: tuple[Anchor, ...] = ()
    spring: CoilSpring | None = None
    gas: GasSpring | None = None
    joints: tuple[Name, ...] = ()
    series: tuple[TorqueHarmonic, ...] = ()

    @model_validator(mode="after")
    def _one_piece(self) -> "Counterbalance":
        if sum(bool(getattr(self, piece)) for piece in PIECES) != 1:
            raise refusal("expected one of 'spring', 'gas' and 'series'")
        needed, other = ("joints", "ends") if self.series else ("ends", "joints")
        if getattr(self, other):
            raise refusal(f"expected none: a {self.piece} has {needed}", other)
        if not getattr(self, needed):
            raise refusal(f"missing key '{needed}': a {self.piece} needs them")
        if self.ends and len(self.ends) != 2:
            raise refusal(f"expected 2 points, got {len(self.ends)}", "ends")
        for index, joint in enumerate(self.joints):
            if joint in self.joints[:index]:
                raise refusal("expected each joint once", "joints", index)
        return self

    @property
    def piece(self) -> str:
        """Which of `PIECES` it is."""
        return next(piece for piece in PIECES if getattr(self, piece))

    def compiled(self, ends: list[tuple[int, Any]], joints: list[int]) -> dict[str, Any]:
        """As the core has it, with bodies and points of `ends`, and indices of `joints`."""
        spring, gas = self.spring, self.gas
        return {
            "ends": ends,
            "spring": spring and [spring.stiffness, spring.length],
            "gas": gas and [gas.pressure, gas.volume, gas.length, gas.area, gas.exponent, gas.ambient],
            "pulls": gas is not None and gas.acts == "pull",
            "joints": joints,
            "series": [(each.order, each.cosine, each.sine) for each in self.series],
        }
