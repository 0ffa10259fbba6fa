"""The section `wrenches` of robot.yaml: forces and moments that something outside gives a link."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt
from pydantic import model_validator

from linkside.arrays import FloatArray
from linkside.files.yaml_source import refusal

from .section import Name, Section
from .sensors import FrameConfig
from .values import NonNegative, Positive, Vector3

AXES = ("fx", "fy", "fz", "mx", "my", "mz")
"""Numbers of a wrench: force along x, y and z [N], moment about them [N m]."""

UNKNOWN_STD, UNKNOWN_WALK = (1e3, 1e2), (1e4, 1e3)
"""What a measured wrench may be before its first reading, and by how much it may wander in a second [N, N m]."""


class WrenchNoise(Section):
    """Standard deviations of one reading."""

    force: Positive = 1.0  # N
    moment: Positive = 0.1  # N m


class WrenchSize(Section):
    """How large a wrench may be, or by how much it wanders in a second, along each axis."""

    force: NonNegative  # N, or N/√s
    moment: NonNegative  # N m, or N m/√s


class WrenchConfig(FrameConfig):
    """Force and moment on a link, about the origin and in the axes of a frame that the link carries."""

    name: Name
    kind: Literal["constant", "measured", "random-walk"]
    force: Vector3 = (0.0, 0.0, 0.0)  # N; of a constant one
    moment: Vector3 = (0.0, 0.0, 0.0)  # N m, likewise
    noise_std: WrenchNoise = WrenchNoise()  # of a measured one
    std: WrenchSize | None = None  # at the first sample, of one that varies
    walk: WrenchSize | None = None  # in a second, of one that varies; 0: it stays what it is

    @model_validator(mode="after")
    def _keys_fit(self) -> WrenchConfig:
        given = self.model_fields_set
        foreign = {
            "constant": ("noise_std", "std", "walk"),
            "measured": ("force", "moment"),
            "random-walk": ("force", "moment", "noise_std"),
        }
        for key in foreign[self.kind]:
            if key in given:
                raise refusal(f"expected none: the wrench is {self.kind}", key)
        if self.kind == "random-walk":
            for key in ("std", "walk"):
                if getattr(self, key) is None:
                    raise refusal(f"missing key '{key}': {{force: …, moment: …}} of a wrench that nothing measures")
        return self

    @property
    def columns(self) -> tuple[str, ...]:
        """Columns of its numbers, ``<name>_fx`` to ``<name>_mz``."""
        return tuple(f"{self.name}_{axis}" for axis in AXES)

    @property
    def constant(self) -> list[float] | None:
        """Its numbers where they are known beforehand."""
        return [*self.force, *self.moment] if self.kind == "constant" else None


def law(varying: Sequence[WrenchConfig]) -> dict[str, FloatArray]:
    """Standard deviations of their numbers at the first sample, and how far each wanders in a second, (6k,) each."""
    return {
        "initial": _numbers([(one.std, UNKNOWN_STD) for one in varying]),
        "walk": _numbers([(one.walk, UNKNOWN_WALK) for one in varying]),
    }


def reading_noise(varying: Sequence[WrenchConfig]) -> FloatArray:
    """Noise of the channels that measure wrenches [N, N m]."""
    each = [(one.noise_std.force, one.noise_std.moment) for one in varying if one.kind == "measured"]
    return _numbers([(None, sizes) for sizes in each])


def is_measured(varying: Sequence[WrenchConfig]) -> npt.NDArray[np.bool_]:
    """Which of their numbers have channels, (6k,)."""
    return np.repeat([one.kind == "measured" for one in varying], len(AXES)).astype(bool)


def _numbers(sizes: list[tuple[WrenchSize | None, tuple[float, float]]]) -> FloatArray:
    each = [default if size is None else (size.force, size.moment) for size, default in sizes]
    return np.repeat(np.array(each, float).reshape(-1), 3)
