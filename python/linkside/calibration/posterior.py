"""What a search needs of a posterior."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from linkside.arrays import FloatArray
from linkside.recording.log import Log
from linkside.robot import Robot

from .parameters import Parameter
from .problem import Evidence


class Posterior(Protocol):
    """Recordings of one robot and the parameters that are free."""

    robot: Robot
    logs: list[Log]
    free: tuple[Parameter, ...]
    held: tuple[tuple[Parameter, float], ...]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels, in the order of `Evidence.innovations`."""

    def evidence(self, z: FloatArray, detail: bool = False) -> Evidence:
        """Evaluate at one point; raises NumericalError where there is no solution."""

    def log_likelihood(self, z: FloatArray) -> float:
        """Log-likelihood alone."""

    def restricted(self, free: Sequence[Parameter]) -> Posterior:
        """Give the same problem with other parameters free."""

    def holding(self, at: Mapping[str, float], free: Sequence[Parameter]) -> Posterior:
        """Give the same problem with only some of its parameters free, the others held at ``at``."""

    def without(self, stretches: Sequence[Sequence[slice]]) -> Posterior:
        """Give the same problem where stretches of each recording were not read, but for the motors' positions."""

    def alone(self, index: int, z: FloatArray) -> Posterior:
        """Give the same problem on one of its recordings."""
