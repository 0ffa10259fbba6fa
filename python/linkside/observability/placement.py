"""Choice of accelerometers: the set that observes link accelerations best in the postures of the robot's work.

Accelerometers read T_A(q) q̈ + W_A (De Luca, Schröder, Thümmel 2007, eq. (10)). A set is good if its T_A, with rows
divided by their noise, is well conditioned in the postures that matter.

>>> import linkside
>>> from linkside.observability import candidates, place
>>> robot = linkside.Robot.load(linkside.demo.ROBOT)
>>> log = linkside.Log.read(linkside.demo.LOG, robot)
>>> found = place(robot, candidates(robot, ["link3", "link4"], reach=0.2), log)
>>> [sensor.link for sensor in found.chosen], found.score < found.before
(['link4'], True)
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from math import comb
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.files.yaml_source import Source, write_yaml
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.sensors import AccelerometerConfig
from linkside.robot.workspace import workspace

from .analysis import check
from .report import CheckReport
from .result import Observability

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Criterion = Literal["condition", "covariance"]

POSTURES = 256
"""Postures that sets are compared in."""

EVERY_SET = 2000
"""Up to this many sets are searched exhaustively; beyond that, one set is improved sensor by sensor."""

WORKSPACE_SHARE = 0.9
"""Share of the workspace's postures that the worst is taken of: some are singular for every set."""


@dataclass(frozen=True, eq=False)
class Placement:
    """The set that was found.

    Attributes
    ----------
    robot : Robot
        The robot with the chosen accelerometers in place of its own.
    chosen : tuple of AccelerometerConfig
        The set.
    criterion : str
        ``"condition"`` or ``"covariance"``.
    score : float
        Worst condition number, or root of the expected variance of link accelerations [rad/s²].
    before : float
        The same of the robot's own accelerometers; inf if they do not observe all joints.
    q : (T, n)
        Postures that were used [rad].
    log : Log or None
        The first recording that they are from.
    alone : tuple of float
        Score of every candidate alone; inf if it does not observe all joints.
    links : tuple of str
        The link of every candidate.
    """

    robot: Robot
    chosen: tuple[AccelerometerConfig, ...]
    criterion: Criterion
    score: float
    before: float
    q: FloatArray
    log: Log | None
    alone: tuple[float, ...]
    links: tuple[str, ...]

    @cached_property
    def report(self) -> CheckReport:
        """What the chosen set sees over the workspace, and where it is singular."""
        return check(self.robot, self.log)

    def to_text(self) -> str:
        """Report in words."""
        what, unit = _NAMES[self.criterion]
        lines = [f"{what}: {_number(self.score)}{unit}; the robot's own sensors: {_number(self.before)}{unit}"]
        for s in self.chosen:
            place, turn = (" ".join(f"{x:.4g}" for x in vector) for vector in (s.xyz, s.rpy))
            lines.append(f"{s.name}: link {s.link}, axes {s.axes}, xyz {place} m, rpy {turn} rad")
        for posture in self.report.singular:
            at = ", ".join(
                f"{name} {np.degrees(value):.0f}°"
                for name, value, elastic in zip(self.robot.names, posture.q, self.robot.elastic, strict=True)
                if elastic
            )
            lines.append(f"singular for {posture.words}, for one at {at}")
        return "\n".join(lines) + "\n"

    def figure(self) -> Figure:
        """Draw where the set is singular, its singular postures marked, and the score of each candidate alone."""
        from .placement_figure import Scores, placement_figure

        label = "worst condition number" if self.criterion == "condition" else "standard deviation [rad/s²]"
        scores = Scores(self.alone, self.links, self.score, self.before, label)
        return placement_figure(self.report, [sensor.name for sensor in self.chosen], scores)

    def write(self, path: str | Path) -> None:
        """Write the chosen ``accelerometers`` as robot.yaml has them."""
        sensors = [sensor.model_dump(mode="json", exclude_defaults=True) for sensor in self.chosen]
        write_yaml(path, {"accelerometers": sensors})


_NAMES: dict[Criterion, tuple[str, str]] = {
    "condition": ("worst condition number", ""),
    "covariance": ("expected standard deviation of link accelerations", " rad/s²"),
}


def candidates(
    robot: Robot,
    links: Iterable[str],
    *,
    reach: float = 0.3,
    steps: int = 3,
    axes: Sequence[str] = ("xyz",),
    rpy: Sequence[Sequence[float]] = ((0.0, 0.0, 0.0),),
    noise_std: float | None = None,
) -> tuple[AccelerometerConfig, ...]:
    """Sensors on a grid around the frame of each link.

    Parameters
    ----------
    links
        Names of links that can carry a sensor.
    reach
        How far the grid goes from the link's frame along x, y and z, either way [m].
    steps
        Points of the grid along each direction.
    axes
        Kinds of sensor: ``("xyz",)`` are three-axis ones, ``("x", "y", "z")`` a choice of single axes.
    rpy
        Orientations to choose from [rad]. For a three-axis sensor with equal noise on all axes it does not matter.
    noise_std
        Of each axis [m/s²]; by default that of the robot's first accelerometer, or 0.05.
    """
    own = robot.accelerometers[0].noise_std if robot.accelerometers else 0.05
    offsets = np.linspace(-reach, reach, steps) if steps > 1 else np.zeros(1)
    grid = product(links, product(offsets, repeat=3), rpy, axes)
    return tuple(
        AccelerometerConfig.model_validate(
            {
                "name": f"{link}_{index}",
                "link": link,
                "xyz": [float(x) for x in xyz],
                "rpy": list(turn),
                "axes": kind,
                "noise_std": noise_std or own,
            }
        )
        for index, (link, xyz, turn, kind) in enumerate(grid)
    )


class _CandidatesFile(BaseModel):
    model_config = ConfigDict(extra="forbid")

    accelerometers: tuple[AccelerometerConfig, ...]


def read_candidates(path: str | Path) -> tuple[AccelerometerConfig, ...]:
    """Read ``accelerometers`` from a YAML file, as robot.yaml has them; `ConfigError` names file, line and key."""
    return Source.read(path).validate(_CandidatesFile).accelerometers


def place(
    robot: Robot,
    sensors: Sequence[AccelerometerConfig | dict[str, Any]],
    postures: Log | Sequence[Log] | npt.ArrayLike | None = None,
    *,
    count: int | None = None,
    limit: float | None = None,
    criterion: Criterion = "condition",
) -> Placement:
    """Choose the best set of accelerometers, or the smallest that is good enough.

    Parameters
    ----------
    robot
        The robot; its own accelerometers only serve for comparison.
    sensors
        Candidates: as ``accelerometers`` of robot.yaml, or from `candidates`.
    postures
        Where it must work: recordings (their motor positions), positions (T, n), or by default the whole workspace
        without the worst tenth of its postures.
    count
        Sensors in the set; by default the fewest whose axes distinguish the elastic joints.
    limit
        Take the smallest set whose score is at most this, of up to `count` sensors if that is given.
    criterion
        ``"condition"``: the largest condition number over the postures. ``"covariance"``: root of the mean, over
        postures, of the summed variance of the elastic joints' accelerations.

    Raises
    ------
    EstimatorError
        Candidates none of which observes some joint, or which together do not distinguish the joints; a limit that no
        set meets.
    """
    search = _PlacementSearch(robot, _candidates(robot, sensors), *_postures(robot, postures), criterion)
    if limit is not None:
        return search.result(search.smallest(limit, count))
    return search.result(search.best(search.fewest if count is None else count))


class _PlacementSearch:
    """Scores of sets; of each candidate the information matrix T_Aᵀ R⁻¹ T_A in each posture, (C, T, e, e)."""

    def __init__(
        self,
        robot: Robot,
        sensors: tuple[AccelerometerConfig, ...],
        q: FloatArray,
        logs: Sequence[Log],
        share: float,
        criterion: Criterion,
    ) -> None:
        if criterion not in _NAMES:
            raise EstimatorError(f"criterion is {criterion!r}, expected one of {', '.join(_NAMES)}")
        self.robot, self.sensors, self.q, self.criterion = robot, sensors, q, criterion
        self.links = tuple(sensor.link for sensor in sensors)
        self.log = logs[0] if logs else None
        self.share = share
        rows = self._rows()
        self._refuse_unseen(rows)
        self.information = np.stack([np.einsum("tri,trj->tij", block, block) for block in rows])
        # Sets that see too little still compare: a trace of knowledge in all directions.
        self.trace = 1e-12 * np.trace(self.information.sum(axis=0), axis1=1, axis2=2).max() * np.eye(rows[0].shape[2])
        everything = _mounted(robot, sensors)
        if not np.isfinite(Observability.of(everything, q).worst).any():
            raise EstimatorError(
                "all candidates together do not tell the elastic joints apart; add some on other links, or more axes"
            )

    def _rows(self) -> list[FloatArray]:
        """T_A over noise of each candidate, elastic joints alone, (T, axes, e)."""
        everything = _mounted(self.robot, self.sensors)
        matrix = everything.acceleration_map(self.q, np.zeros_like(self.q))[0][:, :, self.robot.elastic]
        ends = np.cumsum([len(sensor.axes) for sensor in self.sensors])
        blocks = np.split(matrix, ends[:-1], axis=1)
        return [block / sensor.noise_std for block, sensor in zip(blocks, self.sensors, strict=True)]

    def _refuse_unseen(self, rows: list[FloatArray]) -> None:
        size = np.max([np.abs(block).max(axis=(0, 1)) for block in rows], axis=0)
        names = [name for name, elastic in zip(self.robot.names, self.robot.elastic, strict=True) if elastic]
        for name, seen in zip(names, size > 1e-9 * size.max(initial=0.0), strict=True):
            if not seen:
                carried = ", ".join(_carried(self.robot, name))
                raise EstimatorError(
                    f"no candidate sees joint '{name}'; add one on a link that it carries ({carried}), off its axis"
                )

    @property
    def fewest(self) -> int:
        """Sensors whose axes are as many as elastic joints."""
        most = max(len(sensor.axes) for sensor in self.sensors)
        return max(1, -(-int(self.robot.elastic.sum()) // most))

    def scores(self, sets: Sequence[tuple[int, ...]]) -> FloatArray:
        """Of several sets, to compare them."""
        return np.array([self._score(self._sum(chosen)) for chosen in sets])

    def _sum(self, chosen: tuple[int, ...]) -> FloatArray:
        return np.asarray(self.information[list(chosen)].sum(axis=0) + self.trace)

    def _volume(self, chosen: tuple[int, ...]) -> float:
        """What a set tells even if it is too small to have a score: its log-determinant, over all postures."""
        return float(np.linalg.slogdet(self._sum(chosen))[1].mean())

    def _score(self, information: FloatArray) -> float:
        values = np.linalg.eigvalsh(information)
        if self.criterion == "condition":
            return float(np.quantile(np.sqrt(values[:, -1] / values[:, 0]), self.share, method="lower"))
        variance = np.sort(np.sum(1 / values, axis=1))
        return float(np.sqrt(variance[: max(1, int(self.share * len(variance)))].mean()))

    def best(self, count: int) -> tuple[int, ...]:
        """The best set of ``count`` candidates."""
        total = len(self.sensors)
        if not 1 <= count <= total:
            raise EstimatorError(f"count is {count}, expected 1 to {total}, the number of candidates")
        if comb(total, count) <= EVERY_SET:
            sets = list(combinations(range(total), count))
            return sets[int(np.argmin(self.scores(sets)))]
        return self._exchange(count)

    def _exchange(self, count: int) -> tuple[int, ...]:
        """Add the sensor that tells most, one after the other; then exchange single ones as long as that helps."""
        chosen: tuple[int, ...] = ()
        while len(chosen) < count:
            chosen = max(((*chosen, other) for other in self._others(chosen)), key=self._volume)
        score = self._score(self._sum(chosen))
        while True:
            swaps = [(*chosen[:i], *chosen[i + 1 :], o) for i in range(count) for o in self._others(chosen)]
            other, better = self._improved(swaps)
            if not better < score:
                return tuple(sorted(chosen))
            chosen, score = other, better

    def _others(self, chosen: tuple[int, ...]) -> list[int]:
        return [index for index in range(len(self.sensors)) if index not in chosen]

    def _improved(self, sets: Sequence[tuple[int, ...]]) -> tuple[tuple[int, ...], float]:
        scores = self.scores(sets)
        return sets[int(np.argmin(scores))], float(scores.min())

    def smallest(self, limit: float, most: int | None) -> tuple[int, ...]:
        """The smallest set whose score is at most ``limit``."""
        most = min(most or 8, len(self.sensors))
        for count in range(1, most + 1):
            best = self.best(count)
            score = self.score(best)
            if score <= limit:
                return best
        raise EstimatorError(
            f"no set of up to {most} candidates has a {_NAMES[self.criterion][0]} of {limit:g} or less; the best of "
            f"{most} has {_number(score)}: allow more sensors, or offer better places"
        )

    def score(self, chosen: tuple[int, ...]) -> float:
        """Of one set, by singular values."""
        return self._exact(_mounted(self.robot, tuple(self.sensors[i] for i in chosen)))

    def _exact(self, robot: Robot) -> float:
        observability = Observability.of(robot, self.q)
        if self.criterion == "condition":
            return float(np.quantile(observability.condition, self.share, method="lower"))
        variance = np.sort(np.sum(observability.joints**2, axis=1))
        return float(np.sqrt(variance[: max(1, int(self.share * len(variance)))].mean()))

    def result(self, best: tuple[int, ...]) -> Placement:
        """Put together what was found."""
        chosen = tuple(self.sensors[index] for index in best)
        robot = _mounted(self.robot, chosen)
        alone = tuple(self.score((index,)) for index in range(len(self.sensors)))
        before = self._exact(self.robot)
        return Placement(robot, chosen, self.criterion, self.score(best), before, self.q, self.log, alone, self.links)


def _candidates(
    robot: Robot, sensors: Sequence[AccelerometerConfig | dict[str, Any]]
) -> tuple[AccelerometerConfig, ...]:
    checked = tuple(AccelerometerConfig.model_validate(sensor) for sensor in sensors)
    if not checked:
        raise EstimatorError("there is no candidate; name links that can carry a sensor")
    moving = robot.tree.moving_links
    for sensor in checked:
        if sensor.link not in moving:
            raise EstimatorError(
                f"candidate '{sensor.name}': no joint moves a link '{sensor.link}'; take one of {', '.join(moving)}"
            )
    return checked


def _postures(
    robot: Robot, postures: Log | Sequence[Log] | npt.ArrayLike | None
) -> tuple[FloatArray, Sequence[Log], float]:
    """Postures, evenly thinned out, the recordings that they are from, and the share of them that counts."""
    if postures is None:
        return workspace(robot)[:POSTURES], (), WORKSPACE_SHARE
    if isinstance(postures, Log):
        postures = [postures]
    if isinstance(postures, Sequence) and postures and all(isinstance(one, Log) for one in postures):
        logs = [one for one in postures if isinstance(one, Log)]
        q = np.concatenate([log.theta[np.isfinite(log.theta).all(axis=1)] for log in logs])
    else:
        logs, q = [], np.asarray(postures, float)
    if q.ndim != 2 or q.shape[1] != robot.n or not len(q) or not np.isfinite(q).all():
        raise EstimatorError(f"postures: expected finite positions (T, {robot.n}), got shape {q.shape}")
    rows = np.unique(np.linspace(0, len(q) - 1, POSTURES).astype(int))
    return np.ascontiguousarray(q[rows]), logs, 1.0


def _mounted(robot: Robot, sensors: tuple[AccelerometerConfig, ...]) -> Robot:
    return Robot(robot.config.model_copy(update={"accelerometers": sensors}), robot.tree)


def _carried(robot: Robot, joint: str) -> list[str]:
    tree = robot.tree
    return [name for name, link in tree.moving_links.items() if tree.index[joint] in tree.carriers(link.joint)]


def _number(value: float) -> str:
    return "sees too little" if np.isinf(value) else f"{value:.3g}"
