"""Units of a log's columns: the table of those that are known, and the section `units` of robot.yaml."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, TypeAlias

from pydantic import BeforeValidator

from linkside.files.yaml_source import refusal

SI = {
    "time": "s",
    "angle": "rad",
    "angular velocity": "rad/s",
    "angular acceleration": "rad/s²",
    "length": "m",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "torque": "N m",
    "force": "N",
    "current": "A",
}
"""The unit of each dimension that all else is converted to."""

TURN = 2 * math.pi
GRAVITY = 9.80665
POUND = 0.45359237 * GRAVITY
INCH = 0.0254

TABLE: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "angle": {
        "rad": 1.0,
        "mrad": 1e-3,
        "urad": 1e-6,
        "deg": TURN / 360,
        "mdeg": TURN / 360e3,
        "arcmin": TURN / 360 / 60,
        "arcsec": TURN / 360 / 3600,
        "rev": TURN,
    },
    "angular velocity": {
        "rad/s": 1.0,
        "mrad/s": 1e-3,
        "deg/s": TURN / 360,
        "rev/s": TURN,
        "rpm": TURN / 60,
        "krpm": TURN / 0.06,
    },
    "angular acceleration": {"rad/s2": 1.0, "deg/s2": TURN / 360, "rev/s2": TURN},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": INCH},
    "velocity": {"m/s": 1.0, "mm/s": 1e-3, "m/min": 1 / 60, "mm/min": 1e-3 / 60},
    "acceleration": {"m/s2": 1.0, "mm/s2": 1e-3, "g": GRAVITY, "mg": 1e-3 * GRAVITY},
    "torque": {
        "Nm": 1.0,
        "mNm": 1e-3,
        "Nmm": 1e-3,
        "Ncm": 1e-2,
        "kNm": 1e3,
        "kgfm": GRAVITY,
        "kgfcm": 1e-2 * GRAVITY,
        "lbfin": POUND * INCH,
        "lbfft": POUND * 12 * INCH,
    },
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": GRAVITY, "lbf": POUND},
    "current": {"A": 1.0, "mA": 1e-3},
}
"""How large each unit is in SI units, by dimension. Standard gravity, inch and pound are exact by definition."""

DIMENSIONS: dict[str, tuple[str, str]] = {
    "t": ("time", "time"),
    "theta": ("angle", "length"),
    "dtheta": ("angular velocity", "velocity"),
    "tau": ("torque", "force"),
    "q": ("angle", "length"),
    "dq": ("angular velocity", "velocity"),
    "ddq": ("angular acceleration", "acceleration"),
    "torque": ("torque", "force"),
    "qref": ("angle", "length"),
    "dqref": ("angular velocity", "velocity"),
    "ddqref": ("angular acceleration", "acceleration"),
    "current": ("current", "current"),
    "acceleration": ("acceleration", "acceleration"),
    "rate": ("angular velocity", "angular velocity"),
    "wrench": ("torque", "force"),
    "position": ("length", "length"),
}
"""What each kind of channel measures, of a joint that turns and of one that slides; of a moment and of a force."""

_SPELLINGS = str.maketrans({**dict.fromkeys(" ·*^", ""), **dict.fromkeys("µμ", "u"), "²": "2", "°": "deg"})


@dataclass(frozen=True)
class Unit:
    """A unit of a column.

    Attributes
    ----------
    name : str
        As robot.yaml spells it.
    dimension : str or None
        One of `SI`; None of a unit that is given as a number, which fits any.
    size : float
        How large it is in the SI unit.
    """

    name: str
    dimension: str | None
    size: float

    @property
    def si(self) -> str:
        """The SI unit."""
        return "SI units" if self.dimension is None else SI[self.dimension]


def _unit(value: Any) -> Unit:
    """Read a unit: one of the table, or how large it is in the SI unit, as of an encoder's counts."""
    if isinstance(value, Unit):
        return value
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf:
        return Unit(f"{value:g}", None, float(value))
    name = value.translate(_SPELLINGS) if isinstance(value, str) else None
    for dimension, units in TABLE.items():
        if name in units:
            return Unit(str(value), dimension, units[name])
    raise refusal(f"unknown unit {value!r}; there is {', '.join(name for units in TABLE.values() for name in units)}")


UnitsConfig: TypeAlias = dict[str, Annotated[Unit, BeforeValidator(_unit)]]
"""Units by kind of channel (a key of `DIMENSIONS`) or by column, which goes first."""


def refuse_unfit(units: Mapping[str, Unit], columns: Mapping[str, Sequence[str]]) -> None:
    """Refuse a key that is neither a kind nor a column, and a unit that fits neither kind of joint."""
    kinds = {column: kind for kind, own in columns.items() for column in own}
    for key, unit in units.items():
        kind = key if key in DIMENSIONS else kinds.get(key)
        if kind is None:
            raise refusal(f"expected a kind of channel, {', '.join(DIMENSIONS)}, or a column of the log", "units", key)
        if unit.dimension is not None and unit.dimension not in DIMENSIONS[kind]:
            raise refusal(misfit(unit, DIMENSIONS[kind]), "units", key)


def misfit(unit: Unit, dimensions: Iterable[str]) -> str:
    """Say that a unit is of another dimension, and which would fit."""
    fitting = dict.fromkeys(dimensions)
    names = ", ".join(name for dimension in fitting for name in TABLE[dimension])
    return f"expected a unit of {' or '.join(fitting)} ({names}), got '{unit.name}', of {unit.dimension}"


def column_units(
    units: Mapping[str, Unit], columns: Mapping[str, Sequence[str]], turning: Mapping[str, bool]
) -> tuple[dict[str, Unit], dict[str, str]]:
    """The unit of each column that is not in SI units, and by key why one fits nothing.

    Parameters
    ----------
    units
        By kind or column.
    columns
        Of each kind.
    turning
        By column, whether what it measures turns; those of no joint are left out.
    """
    found: dict[str, Unit] = {}
    faults: dict[str, str] = {}
    for kind, own in columns.items():
        for key, candidates in [(kind, own), *((column, [column]) for column in own)]:
            if (unit := units.get(key)) is None:
                continue
            dimension = {column: DIMENSIONS[kind][not turning.get(column, True)] for column in candidates}
            fitting = [column for column in candidates if unit.dimension in (None, dimension[column])]
            if candidates and not fitting:
                faults[key] = misfit(unit, dimension.values())
            found |= {column: Unit(unit.name, dimension[column], unit.size) for column in fitting}
    return {column: unit for column, unit in found.items() if unit.size != 1}, faults
