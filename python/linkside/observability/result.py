"""What accelerometers see of a robot's links: singular values of their map, posture by posture."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.robot import Robot

LIMIT = 10.0
"""Standard deviation from which an acceleration counts as lost [rad/s²]; the observer damps it from there on."""


NEVER = 1e4
"""Standard deviation from which a posture counts as singular [rad/s²]."""


@dataclass(frozen=True, eq=False)
class Observability:
    """How well link accelerations are seen in each of T postures.

    Attributes
    ----------
    values : (T, e)
        Singular values of the whitened map, falling, 0 where a direction is not seen [1/(rad/s²)].
    directions : (T, e, e)
        Their combinations of the e elastic joints' accelerations, unit rows.
    """

    values: FloatArray
    directions: FloatArray

    @classmethod
    def of(cls, robot: Robot, q: FloatArray) -> Observability:
        """Look at postures q (T, n), all at once."""
        noise = np.array([sensor.noise_std for sensor in robot.accelerometers for _ in sensor.axes])
        return cls.of_maps(robot.acceleration_map(q, np.zeros_like(q))[0][:, :, robot.elastic] / noise[:, None])

    @classmethod
    def of_maps(cls, whitened: FloatArray) -> Observability:
        """Look at maps (T, M, e) from accelerations to M readings, each row over its noise."""
        rows, columns = whitened.shape[1:]
        # Rows of zeros make up for axes that are not there, so that there is a direction for every joint.
        padded = np.pad(whitened, ((0, 0), (0, max(columns - rows, 0)), (0, 0)))
        _, values, directions = np.linalg.svd(padded, full_matrices=False)
        rounding = max(rows, columns) * np.finfo(float).eps * values[:, :1]
        return cls(np.where(values > rounding, values, 0.0), directions)

    @cached_property
    def worst(self) -> FloatArray:
        """Standard deviation of the worst combination of accelerations, (T,) [rad/s²]; inf where not seen."""
        return _reciprocal(self.values.min(axis=1, initial=np.inf))  # of no joints at all, nothing is unknown

    @cached_property
    def joints(self) -> FloatArray:
        """Standard deviation of each elastic joint's acceleration, (T, e) [rad/s²]; inf where not seen."""
        share = self.directions**2
        share[share < np.finfo(float).eps] = 0.0
        with np.errstate(invalid="ignore"):
            parts = share * _reciprocal(self.values)[:, :, None] ** 2
        return np.asarray(np.sqrt(np.where(share > 0, parts, 0.0).sum(axis=1)))

    @cached_property
    def condition(self) -> FloatArray:
        """Largest over smallest singular value, (T,); 1 of no joints, inf where a combination leaves no trace."""
        if not self.values.shape[1]:
            return np.ones(len(self.values))
        largest = self.values.max(axis=1, initial=0.0)
        return np.where(np.isinf(self.worst), np.inf, largest * np.where(np.isinf(self.worst), 0.0, self.worst))


@dataclass(frozen=True, eq=False)
class Posture:
    """The worst posture of a kind.

    Attributes
    ----------
    q : (n,)
        Joint positions [rad, m].
    worst : float
        Standard deviation of the acceleration that is seen worst [rad/s²].
    condition : float
        Largest over smallest singular value.
    direction : (e,)
        The combination of accelerations that is seen worst, a unit vector.
    words : str
        That combination in words: ``"a1 alone"``, ``"a2 against a3"``.
    """

    q: FloatArray
    worst: float
    condition: float
    direction: FloatArray
    words: str

    @property
    def singular(self) -> bool:
        """Whether the sensors see nothing of it at all."""
        return self.worst > NEVER


@dataclass(frozen=True, eq=False)
class Path:
    """The postures of a log: its motor positions.

    Attributes
    ----------
    source : str
        The log.
    t : (T,)
        Time [s].
    q : (T, n)
        Positions [rad, m].
    worst, joints : (T,) and (T, e)
        As those of `Observability`.
    """

    source: str
    t: FloatArray
    q: FloatArray
    worst: FloatArray
    joints: FloatArray


def describe(joints: tuple[str, ...], direction: FloatArray) -> str:
    """Put a combination of joints into words: ``"a2 against a3"``, those that move most named first."""
    parts = [i for i in np.argsort(-np.abs(direction), kind="stable") if involved(direction)[i]]
    first = sorted(i for i in parts if direction[i] * direction[parts[0]] > 0)
    second = sorted(i for i in parts if direction[i] * direction[parts[0]] < 0)
    sides = sorted((side for side in (first, second) if side), key=min)
    words = " against ".join(" and ".join(joints[i] for i in side) for side in sides)
    return f"{words} alone" if len(parts) == 1 else words if second else f"{words} together"


def involved(direction: FloatArray) -> npt.NDArray[np.bool_]:
    """Joints with more than a trace of a part in each of some directions, (…, e)."""
    size = np.abs(direction)
    return np.asarray(size > 0.25 * size.max(axis=-1, keepdims=True))


def _reciprocal(values: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / values)


@dataclass(frozen=True, eq=False)
class CheckResult:
    """What a robot's accelerometers see of its elastic joints.

    Attributes
    ----------
    robot : Robot
        The robot.
    limits : (2, n)
        The workspace: lowest and highest position of each joint [rad, m].
    home : (n,)
        The middle of the log, or of the workspace.
    observability : Observability
        Over the workspace.
    influence : (n,)
        How much each joint's position matters: its total-effect index on log10 of σ (Jansen 1999).
    postures : tuple of Posture
        The worst of each kind, the kind with fewest joints first; none if the joints cannot be distinguished anywhere.
    path : Path or None
        Along the log.
    """

    robot: Robot
    limits: FloatArray
    home: FloatArray
    observability: Observability
    influence: FloatArray
    postures: tuple[Posture, ...]
    path: Path | None

    @property
    def joints(self) -> tuple[str, ...]:
        """The e elastic joints."""
        return tuple(name for name, elastic in zip(self.robot.names, self.robot.elastic, strict=True) if elastic)

    @property
    def observable(self) -> bool:
        """Whether every link acceleration is seen in some posture."""
        return bool(np.isfinite(self.observability.worst).any())

    @property
    def singular(self) -> tuple[Posture, ...]:
        """Postures in which some acceleration is not seen at all."""
        return tuple(posture for posture in self.postures if posture.singular)

    @property
    def influential(self) -> npt.NDArray[np.intp]:
        """Joints whose position matters, the most important first."""
        order = np.argsort(-self.influence, kind="stable")
        return np.asarray(order[self.influence[order] > 1e-12])
