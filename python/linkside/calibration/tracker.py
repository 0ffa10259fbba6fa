"""Where a tracker stands: its axes, its origin and the age of its readings, by a recording of both robot and tracker.

Positions that two frames see of the same points determine one in the other (W. Kabsch, Acta Crystallographica A34,
1978); from there all unknowns are fitted together by least squares.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.kalman import RauchTungStriebelSmoother
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.rigid import roll_pitch_yaw
from linkside.robot.sensors import FrameConfig, PlaceConfig, TrackerConfig

from .output import copied, dump

FREE = ("place", "delay", "xyz")
"""What can be found: where the tracker stands, by how much its readings are late, where on the link its target is."""

LONGEST, STEPS = 0.25, 101
"""Delays that are tried before the best is refined: up to this, either way [s]; and how many."""

TOLD = 10.0
"""A target must move in two directions by more than this many standard deviations of a reading."""

FEWEST = 8
"""Rows with readings that all unknowns take at least."""

FAR = 0.1
"""Readings that are further from the target than this share of its motion are not of it, RMS."""

MIRRORED = 10.0
"""Of the mean square that is left, to that with left-handed axes: from here on the axes are left-handed."""

ALIKE = 1e-6
"""Singular values below this share of the largest are rounding: what belongs to them is not determined."""


@dataclass(frozen=True, eq=False)
class Alignment:
    """A tracker as a recording has it.

    Attributes
    ----------
    robot : Robot
        With the tracker as it was found.
    tracker : TrackerConfig
        The tracker.
    delay : float
        By how much its readings are late [s]; below zero, early.
    std : dict
        Standard errors of ``origin`` (3,) [m], ``turn`` (3,) about the base frame's axes [rad], and if they were free
        of ``delay`` [s] and ``xyz`` (3,) [m]; by the residuals, as if those of all readings were independent.
    residual : float
        Root mean square of what is left, of all axes together [m].
    """

    robot: Robot
    tracker: TrackerConfig
    delay: float
    std: dict[str, FloatArray]
    residual: float

    def to_text(self) -> str:
        """Report in words."""
        place = self.tracker.place
        lines = [
            f"{self.tracker.name}: {1e3 * self.residual:.3g} mm RMS between its readings and the estimate",
            _line("origin [m]", place.xyz, self.std["origin"]),
            _line("roll, pitch, yaw [rad]", place.rpy, self.std["turn"]),
        ]
        if "delay" in self.std:
            lines.append(_line("delay [ms]", [1e3 * self.delay], 1e3 * self.std["delay"]))
        if "xyz" in self.std:
            lines.append(_line("target [m]", self.tracker.xyz, self.std["xyz"]))
        return "\n".join(lines) + "\n"

    def write(self, source: str | Path, out: str | Path) -> None:
        """Write robot.yaml with this tracker; comments and order of ``source`` are kept."""
        tree = copied(source, out)
        names = [sensor["name"] for sensor in tree["trackers"]]
        section = tree["trackers"][names.index(self.tracker.name)]
        section["place"] = {key: [round(x, 9) for x in getattr(self.tracker.place, key)] for key in ("xyz", "rpy")}
        if "delay" in self.std:
            section["delay"] = round(self.tracker.delay, 7)
        if "xyz" in self.std:
            section["xyz"] = [round(x, 7) for x in self.tracker.xyz]
        dump(tree, out)


def _line(what: str, values: Sequence[float], std: FloatArray) -> str:
    each = zip(values, np.broadcast_to(std, len(values)), strict=True)
    return f"{what}: " + ", ".join(f"{value:.6g} ± {error:.1g}" for value, error in each)


def align_tracker(
    robot: Robot, log: Log, name: str | None = None, free: Sequence[str] = ("place", "delay")
) -> Alignment:
    """Find where a tracker stands, and how late it is.

    The links are where the smoother puts them without the tracker; errors of springs are errors of the place, so align
    again after a calibration.

    Parameters
    ----------
    robot, log
        The robot, and a recording with the tracker's columns, in which its target moves in more than one direction.
    name
        The tracker; not needed where the robot has one only.
    free
        ``"place"``, always; ``"delay"``; and ``"xyz"``, the target on its link, if it is not known better.

    Raises
    ------
    EstimatorError
        No such tracker, one that records fewer than three axes, a motion that does not determine what is asked for,
        readings that do not follow the target, or that are early: their clock is to be shifted first.
    LogError
        The log lacks a column.
    """
    tracker = _named(robot, name)
    if unknown := set(free) - set(FREE):
        raise EstimatorError(f"free: {min(unknown)!r} is not one of {', '.join(map(repr, FREE))}")
    seen = _readings(robot, log, tracker)
    search = _Search(_without(robot), log, tracker, seen, {"place", *free})
    return search.result(robot)


def _named(robot: Robot, name: str | None) -> TrackerConfig:
    trackers = {tracker.name: tracker for tracker in robot.trackers}
    if not trackers:
        raise EstimatorError("robot.yaml has no tracker: name it in `trackers`, with the link that it sees")
    if name is None and len(trackers) > 1:
        raise EstimatorError(f"the robot has several trackers; choose one of {', '.join(trackers)}")
    tracker = trackers.get(name or next(iter(trackers)))
    if tracker is None:
        raise EstimatorError(f"no tracker {name!r}; the robot has {', '.join(trackers)}")
    if tracker.axes != "xyz":
        raise EstimatorError(f"tracker {tracker.name!r} records {tracker.axes}; its place takes all three axes")
    return tracker


def _readings(robot: Robot, log: Log, tracker: TrackerConfig) -> FloatArray:
    (position,) = log.require("position", purpose="aligning a tracker")
    first = robot.position_channels.index(f"{tracker.name}_px")
    seen = np.asarray(position[:, first : first + 3])
    if not np.isfinite(seen).all(axis=1).any():
        raise EstimatorError(f"tracker {tracker.name!r}: no row has readings of all three axes")
    return seen


def _without(robot: Robot) -> Robot:
    return Robot(robot.config.model_copy(update={"trackers": ()}), robot.tree)


class _Search:
    """Least squares in (turn from where Kabsch puts it, origin, delay, target on its link)."""

    def __init__(self, robot: Robot, log: Log, tracker: TrackerConfig, seen: FloatArray, free: set[str]) -> None:
        self.robot, self.tracker, self.seen, self.t = robot, tracker, seen, log.t
        self.rows = np.flatnonzero(np.isfinite(seen).all(axis=1))
        self.delayed, self.moved = "delay" in free, "xyz" in free
        # No more than a quarter of the recording is without a counterpart at any delay.
        self.longest = min(LONGEST, 0.25 * float(log.t[-1] - log.t[0]))
        self.q = RauchTungStriebelSmoother(robot, tolerances=False).run(log).q
        self.path = CubicSpline(self.t, self._at(tracker.xyz))
        self._refuse_lines()

    def _at(self, xyz: Sequence[float]) -> FloatArray:
        """The target in the base frame if it is at ``xyz`` on its link (T, 3)."""
        target = FrameConfig(link=self.tracker.link, xyz=tuple(map(float, xyz)))
        return Robot(self.robot.config.model_copy(update={"tool": target}), self.robot.tree).tool_position(self.q)

    @cached_property
    def shifts(self) -> list[CubicSpline]:
        """What a metre along each axis of the link moves the target by."""
        here = self._at(self.tracker.xyz)
        steps = np.array(self.tracker.xyz) + np.eye(3)
        return [CubicSpline(self.t, self._at(step) - here) for step in steps]

    def _refuse_lines(self) -> None:
        points = self.path(self.t[self.rows]) if len(self.rows) else np.zeros((0, 3))
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False) if len(points) >= FEWEST else np.zeros(3)
        if spread[1] <= TOLD * self.tracker.noise_std * np.sqrt(max(len(points), 1)):
            raise EstimatorError(
                f"tracker {self.tracker.name!r}: its target moves along a line at most, about which its axes may turn; "
                "take a recording in which several joints move"
            )

    def _seen_at(self, delay: float) -> tuple[FloatArray, FloatArray]:
        """Times at which rows were really read, and which rows are within the recording."""
        times = self.t[self.rows] - delay
        return times, (times >= self.t[0]) & (times <= self.t[-1])

    def _kabsch(self, delay: float, sign: float = 1.0) -> tuple[Rotation, FloatArray, float]:
        """Axes and origin of the tracker for a delay, and the mean square of what is left; -1: of left-handed axes."""
        times, there = self._seen_at(delay)
        if np.count_nonzero(there) < FEWEST:
            return Rotation.identity(), np.zeros(3), np.inf
        points, seen = self.path(times[there]), sign * self.seen[self.rows][there]
        middle, own = points.mean(axis=0), seen.mean(axis=0)
        turn, left = Rotation.align_vectors(points - middle, seen - own)
        return turn, middle - turn.apply(own), left**2 / len(seen)

    def result(self, robot: Robot) -> Alignment:
        """Fit, and put together what was found."""
        given = self.tracker.delay
        tried = np.linspace(-self.longest, self.longest, STEPS) if self.delayed else [given]
        begin = float(min(tried, key=lambda delay: self._kabsch(delay)[2]))
        turn, origin, _ = self._kabsch(begin)
        start = np.concatenate([np.zeros(3), origin, [begin] * self.delayed, np.zeros(3 * self.moved)])
        found = least_squares(self._residuals(turn), start, x_scale="jac", method="lm")
        std, rms = self._uncertainty(found.jac, found.fun)
        delay = float(found.x[6]) if self.delayed else given
        self._refuse_others(rms, delay)
        if delay < -3 * float(std[6] if self.delayed else 0.0):
            raise EstimatorError(
                f"tracker {self.tracker.name!r} is {-1e3 * delay:.3g} ms early: its clock is ahead; shift its columns, "
                "`linkside merge --shift`"
            )
        axes = (Rotation.from_rotvec(found.x[:3]) * turn).as_matrix()
        place = PlaceConfig(xyz=tuple(found.x[3:6].tolist()), rpy=tuple(map(float, roll_pitch_yaw(axes))))
        changes = {"place": place, "delay": max(delay, 0.0)}
        errors = {"turn": std[:3], "origin": std[3:6]} | ({"delay": std[6:7]} if self.delayed else {})
        if self.moved:
            changes["xyz"] = tuple((np.array(self.tracker.xyz) + found.x[-3:]).tolist())
            errors["xyz"] = std[-3:]
        tracker = self.tracker.model_copy(update=changes)
        trackers = tuple(tracker if one.name == tracker.name else one for one in robot.trackers)
        aligned = Robot(robot.config.model_copy(update={"trackers": trackers}), robot.tree)
        return Alignment(aligned, tracker, delay, errors, rms)

    def _refuse_others(self, rms: float, delay: float) -> None:
        """Refuse readings that are of something else than the target, or at another time than any that was tried."""
        within = min(max(delay, -self.longest), self.longest)
        if self._kabsch(within)[2] > MIRRORED * self._kabsch(within, -1.0)[2]:
            raise EstimatorError(
                f"tracker {self.tracker.name!r}: its readings follow the target in left-handed axes; turn one sign"
            )
        moved = float(np.sqrt(self.path(self.t).var(axis=0).sum() / 3))
        if rms > FAR * moved or abs(delay) > 2 * max(self.longest, self.tracker.delay):
            raise EstimatorError(
                f"tracker {self.tracker.name!r}: its readings do not follow the target: {1e3 * rms:.3g} mm off, RMS, "
                f"where that moves by {1e3 * moved:.3g} mm; look at their unit (`units`), signs, link and xyz, and at "
                f"clocks that differ by more than {self.longest:.2g} s"
            )

    def _residuals(self, turn: Rotation) -> Callable[[FloatArray], FloatArray]:
        """What readings differ by, of those rows that any delay leaves within the recording, (3k,) [m]."""
        margin = self.longest if self.delayed else self.tracker.delay
        rows = self.rows[(self.t[self.rows] >= self.t[0] + margin) & (self.t[self.rows] <= self.t[-1] - margin)]
        if len(rows) < FEWEST:
            raise EstimatorError(
                f"tracker {self.tracker.name!r}: fewer than {FEWEST} rows have readings that are not within "
                f"{margin:.2g} s of an end of the recording"
            )

        def residuals(x: FloatArray) -> FloatArray:
            times = self.t[rows] - (x[6] if self.delayed else self.tracker.delay)
            points = self.path(times)
            if self.moved:
                points = points + sum(step * shift(times) for step, shift in zip(x[-3:], self.shifts, strict=True))
            axes = Rotation.from_rotvec(x[:3]) * turn
            return np.asarray(axes.inv().apply(points - x[3:6]) - self.seen[rows]).ravel()

        return residuals

    def _uncertainty(self, jacobian: FloatArray, left: FloatArray) -> tuple[FloatArray, float]:
        """Standard errors of what was fitted, and what is left, RMS."""
        size = np.linalg.norm(jacobian, axis=0)
        values = np.linalg.svd(jacobian / np.where(size > 0, size, 1.0), compute_uv=False)
        if values[-1] <= ALIKE * values[0]:
            raise EstimatorError(
                f"tracker {self.tracker.name!r}: the motion does not determine its place"
                + (" together with its target: fix xyz, or let more joints move" if self.moved else "")
            )
        square = float(left @ left) / max(len(left) - len(size), 1)
        return np.sqrt(square * np.diag(np.linalg.inv(jacobian.T @ jacobian))), float(np.sqrt(np.mean(left**2)))
