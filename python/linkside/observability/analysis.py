"""Which link accelerations the sensors see, how well, and in which postures they lose sight of them.

An accelerometer reads T_A(q) q̈ + W_A (De Luca, Schröder, Thümmel 2007, eq. (10)). Each row of T_A over its noise,
the smallest singular value σ of what is left says how well the worst combination of link accelerations is known:
its standard deviation is 1/σ. Where that grows without bound the posture is singular.

>>> import linkside
>>> from linkside.observability import check
>>> report = check(linkside.Robot.load(linkside.demo.ROBOT))
>>> [posture.words for posture in report.singular]
['a1 alone', 'a2 against a3']
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from linkside.recording.log import Log, LogStream
from linkside.robot import Robot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = npt.NDArray[np.float64]

SAMPLES = 2**15
"""Postures over the workspace."""

LOG_ROWS = 500_000
"""A log with more rows than this is looked at every so many rows."""

LIMIT = 10.0
"""Standard deviation from which an acceleration counts as lost [rad/s²]; the observer damps it from there on."""

NEVER = 1e4
"""Standard deviation from which a posture counts as singular [rad/s²]."""


@dataclass(frozen=True, eq=False)
class Sight:
    """How well link accelerations are seen in each of T postures.

    Attributes
    ----------
    values : (T, e)
        Singular values of the whitened map, falling, 0 where a direction is not seen [1/(rad/s²)].
    directions : (T, e, e)
        Their combinations of the e elastic joints' accelerations, unit rows.
    """

    values: Array
    directions: Array

    @classmethod
    def of(cls, robot: Robot, q: Array) -> Sight:
        """Look at postures q (T, n), all at once."""
        noise = np.array([sensor.noise_std for sensor in robot.accelerometers for _ in sensor.axes])
        matrix = robot.acceleration_map(q, np.zeros_like(q))[0][:, :, robot.elastic] / noise[:, None]
        rows, columns = matrix.shape[1:]
        # Rows of zeros make up for axes that are not there, so that there is a direction for every joint.
        padded = np.pad(matrix, ((0, 0), (0, max(columns - rows, 0)), (0, 0)))
        _, values, directions = np.linalg.svd(padded, full_matrices=False)
        rounding = max(rows, columns) * np.finfo(float).eps * values[:, :1]
        return cls(np.where(values > rounding, values, 0.0), directions)

    @cached_property
    def worst(self) -> Array:
        """Standard deviation of the worst combination of accelerations, (T,) [rad/s²]; inf where not seen."""
        return _reciprocal(self.values.min(axis=1, initial=np.inf))  # of no joints at all, nothing is unknown

    @cached_property
    def joints(self) -> Array:
        """Standard deviation of each elastic joint's acceleration, (T, e) [rad/s²]; inf where not seen."""
        share = self.directions**2
        share[share < np.finfo(float).eps] = 0.0
        with np.errstate(invalid="ignore"):
            parts = share * _reciprocal(self.values)[:, :, None] ** 2
        return np.asarray(np.sqrt(np.where(share > 0, parts, 0.0).sum(axis=1)))

    @cached_property
    def condition(self) -> Array:
        """Largest over smallest singular value, (T,)."""
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

    q: Array
    worst: float
    condition: float
    direction: Array
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
        As those of `Sight`.
    """

    source: str
    t: Array
    q: Array
    worst: Array
    joints: Array


@dataclass(frozen=True, eq=False)
class CheckReport:
    """What a robot's accelerometers see of its elastic joints.

    Attributes
    ----------
    robot : Robot
        The robot.
    limits : (2, n)
        The workspace: lowest and highest position of each joint [rad, m].
    home : (n,)
        The middle of the log, or of the workspace.
    sight : Sight
        Over the workspace.
    influence : (n,)
        How much each joint's position matters: its total-effect index on log10 of σ (Jansen 1999).
    postures : tuple of Posture
        The worst of each kind, the kind with fewest joints first; none where nothing can be told apart.
    path : Path or None
        Along the log.
    """

    robot: Robot
    limits: Array
    home: Array
    sight: Sight
    influence: Array
    postures: tuple[Posture, ...]
    path: Path | None

    @property
    def joints(self) -> tuple[str, ...]:
        """The e elastic joints."""
        return tuple(name for name, elastic in zip(self.robot.names, self.robot.elastic, strict=True) if elastic)

    @property
    def observable(self) -> bool:
        """Whether every link acceleration is seen in some posture."""
        return bool(np.isfinite(self.sight.worst).any())

    @property
    def singular(self) -> tuple[Posture, ...]:
        """Postures in which some acceleration is not seen at all."""
        return tuple(posture for posture in self.postures if posture.singular)

    @property
    def influential(self) -> npt.NDArray[np.intp]:
        """Joints whose position matters, the most important first."""
        order = np.argsort(-self.influence, kind="stable")
        return np.asarray(order[self.influence[order] > 1e-12])

    def to_text(self, width: int = 100) -> str:
        """Report in words and tables, without colours."""
        from linkside.cli.progress import as_text, check_tables

        return as_text(check_tables(self), width)

    def figure(self) -> Figure:
        """Draw where accelerations are lost: over the two joints that matter most, and along the log."""
        from linkside.figures.plots import check_figure

        return check_figure(self)


def check(robot: Robot, log: Log | LogStream | None = None) -> CheckReport:
    """Find out which link accelerations the sensors see, how well, and where they are lost.

    Postures are drawn within the URDF's limits, over a whole turn where there are none, by a Sobol sequence: the
    same on every call.

    Parameters
    ----------
    robot
        With any number of accelerometers, none included.
    log
        A recording, whole or streamed, along which to look as well.
    """
    limits = joint_limits(robot)
    unit = _sobol(2 * robot.n)
    q = limits[0] + unit[:, : robot.n] * (limits[1] - limits[0])
    other = limits[0] + unit[:, robot.n :] * (limits[1] - limits[0])
    sight = Sight.of(robot, q)
    path = None if log is None else _path(robot, log)
    home = limits.mean(axis=0) if path is None else np.median(path.q, axis=0)
    influence = _influence(robot, q[:4096], other[:4096])
    report = CheckReport(robot, limits, home, sight, influence, (), path)
    if not (report.observable and robot.elastic.any()):
        return report
    return CheckReport(robot, limits, home, sight, influence, _worst_postures(report, q), path)


def workspace(robot: Robot) -> Array:
    """Postures over the workspace, evenly spread, (SAMPLES, n) [rad, m]; those of `check`."""
    low, high = joint_limits(robot)
    return np.asarray(low + _sobol(2 * robot.n)[:, : robot.n] * (high - low))


def prismatic(robot: Robot) -> list[bool]:
    """Which joints slide instead of turning."""
    return [_model(robot, name).shortname().startswith("JointModelP") for name in robot.names]


def describe(joints: tuple[str, ...], direction: Array) -> str:
    """Put a combination of joints into words: ``"a2 against a3"``, those that move most named first."""
    involved = [i for i in np.argsort(-np.abs(direction), kind="stable") if _involved(direction)[i]]
    first = sorted(i for i in involved if direction[i] * direction[involved[0]] > 0)
    second = sorted(i for i in involved if direction[i] * direction[involved[0]] < 0)
    sides = sorted((side for side in (first, second) if side), key=min)
    words = " against ".join(" and ".join(joints[i] for i in side) for side in sides)
    return f"{words} alone" if len(involved) == 1 else words if second else f"{words} together"


def _involved(direction: Array) -> npt.NDArray[np.bool_]:
    """Joints with more than a trace of a part in each of some directions, (…, e)."""
    size = np.abs(direction)
    return np.asarray(size > 0.25 * size.max(axis=-1, keepdims=True))


def joint_limits(robot: Robot) -> Array:
    """Least and largest position of each joint, (2, n); a turn, or 2 m, of one without limits."""
    rows = [_range(robot, name, slides) for name, slides in zip(robot.names, prismatic(robot), strict=True)]
    return np.array(list(zip(*rows, strict=True)))


def _range(robot: Robot, name: str, slides: bool) -> tuple[float, float]:
    """Limits of a joint; where there are none, or they leave more than a turn, one turn (or 1 m either way)."""
    joint, model = _model(robot, name), robot.model
    low, high = float(model.lowerPositionLimit[joint.idx_q]), float(model.upperPositionLimit[joint.idx_q])
    turn = 1.0 if slides else np.pi
    bounded = joint.nq == 1 and 0 < high - low < (np.inf if slides else 2 * np.pi)
    return (low, high) if bounded else (-turn, turn)


def _model(robot: Robot, name: str) -> Any:
    return robot.model.joints[robot.model.getJointId(name)]


def _sobol(dimensions: int) -> Array:
    from scipy.stats import qmc

    return np.asarray(qmc.Sobol(dimensions, scramble=False).random(SAMPLES))


def _reciprocal(values: Array) -> Array:
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / values)


def _path(robot: Robot, log: Log | LogStream) -> Path | None:
    rows = len(log) if isinstance(log, Log) else log.count or 0
    step = 1 + rows // LOG_ROWS
    times, postures, worst, joints = [], [], [], []
    for piece in (log[i : i + 65_536] for i in range(0, rows, 65_536)) if isinstance(log, Log) else log:
        known = np.flatnonzero(np.isfinite(piece.theta).all(axis=1))[::step]
        sight = Sight.of(robot, np.ascontiguousarray(piece.theta[known]))
        times.append(piece.t[known])
        postures.append(piece.theta[known])
        worst.append(sight.worst)
        joints.append(sight.joints)
    path = Path(log.source, *map(np.concatenate, (times, postures, worst, joints)))
    return path if len(path.t) else None


def _influence(robot: Robot, q: Array, other: Array) -> Array:
    """Total-effect index of each joint: half the mean square change of log10 σ when it alone moves elsewhere."""

    def decades(q: Array) -> Array:
        return np.asarray(np.log10(np.clip(Sight.of(robot, q).worst, 1e-12, 1e12)))

    base, index = decades(q), np.zeros(robot.n)
    for joint in range(robot.n):
        moved = q.copy()
        moved[:, joint] = other[:, joint]
        index[joint] = 0.5 * np.mean((decades(moved) - base) ** 2)
    return index


def _worst_postures(report: CheckReport, q: Array) -> tuple[Posture, ...]:
    """Refine the worst samples of each kind, and keep of each kind of singularity the one nearest to home."""
    found = [_refine(report, start) for start in _starts(report.sight, q)]
    kinds: dict[frozenset[int], list[Posture]] = {}
    for posture in (posture for posture in found if posture.singular):
        kinds.setdefault(frozenset(np.flatnonzero(_involved(posture.direction))), []).append(posture)
    if not kinds:
        return (max(found, key=lambda posture: posture.worst),)

    def distance(posture: Posture) -> float:
        return float(np.linalg.norm(posture.q - report.home))

    return tuple(min(kinds[kind], key=distance) for kind in sorted(_distinct(kinds), key=lambda k: (len(k), min(k))))


def _distinct(kinds: dict[frozenset[int], list[Posture]]) -> list[frozenset[int]]:
    """Kinds but those that contain, or are part of, a more frequent one: a singular surface has no one direction."""
    kept: list[frozenset[int]] = []
    for kind in sorted(kinds, key=lambda kind: -len(kinds[kind])):
        if not any(kind <= other or kind >= other for other in kept):
            kept.append(kind)
    return kept


def _starts(sight: Sight, q: Array, kinds: int = 8, each: int = 8) -> Array:
    """Pick the worst samples of each kind, by the joints that take part in what is seen worst."""
    order = np.argsort(-sight.worst, kind="stable")[: len(q) // 16]
    involved = _involved(sight.directions[order, -1])
    kind = involved @ (1 << np.arange(involved.shape[1]))
    first = np.unique(kind, return_index=True)[1]
    chosen = [order[kind == kind[i]][:each] for i in np.sort(first)[:kinds]]
    return np.asarray(q[np.concatenate(chosen)])


def _refine(report: CheckReport, start: Array) -> Posture:
    """Descend to the nearest minimum of σ², which unlike σ is smooth where it vanishes."""
    from scipy.optimize import minimize

    free = report.influential
    base = report.home.copy()
    base[free] = start[free]
    steps = 1e-6 * np.vstack([np.zeros(len(free)), np.eye(len(free)), -np.eye(len(free))])

    def square(x: Array) -> tuple[float, Array]:
        q = np.tile(base, (len(steps), 1))
        q[:, free] = x + steps
        value = Sight.of(report.robot, q).values[:, -1] ** 2
        up, down = value[1:].reshape(2, -1)
        return float(value[0]), (up - down) / 2e-6

    if len(free):
        bounds = report.limits[:, free].T
        options = {"ftol": 0.0, "gtol": 1e-12, "maxiter": 200}
        base[free] = minimize(square, base[free], jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    sight = Sight.of(report.robot, base[None])
    direction = sight.directions[0, -1]
    words = describe(report.joints, direction)
    return Posture(base, float(sight.worst[0]), float(sight.condition[0]), direction, words)
