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
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from .placement_search import NAMES, Criterion, PlacementSearch, mounted, number
from .report import CheckReport

if TYPE_CHECKING:
    from matplotlib.figure import Figure

POSTURES = 256
"""Postures that sets are compared in."""

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
    spares : int
        How many sensors may fail.
    left : float
        The score when those have failed that the set needs most; `score` without spares.
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
    spares: int
    left: float
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
        what, unit = NAMES[self.criterion]
        lines = [f"{what}: {number(self.score)}{unit}; the robot's own sensors: {number(self.before)}{unit}"]
        if self.spares:
            lines.append(
                f"after the worst loss of {self.spares} of {len(self.chosen)} sensors: {number(self.left)}{unit}"
            )
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
    spares: int = 0,
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
    spares
        How many sensors may fail, whichever they are: sets are compared, and held to the limit, without those that they
        need most.

    Raises
    ------
    EstimatorError
        Candidates none of which observes some joint, or which together do not distinguish the joints; a limit that no
        set meets.
    """
    offered = _candidates(robot, sensors)
    q, logs, share = _postures(robot, postures)
    search = PlacementSearch(robot, offered, q, share, criterion, spares)
    best = search.best(search.fewest if count is None else count) if limit is None else search.smallest(limit, count)
    chosen = tuple(offered[index] for index in best)
    return Placement(
        robot=mounted(robot, chosen),
        chosen=chosen,
        criterion=criterion,
        score=search.whole(best),
        spares=spares,
        left=search.score(best),
        before=search.of(robot),
        q=q,
        log=logs[0] if logs else None,
        alone=tuple(search.whole((index,)) for index in range(len(offered))),
        links=tuple(sensor.link for sensor in offered),
    )


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
