"""Checks of positions: jumps, limits, unit and side of the gear."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.robot import Robot

from .finding import Finding
from .view import View

CLEAN = 8.0
"""A jump is at least this many times the change of speed around it."""

SPEED = 100.0
"""Largest plausible speed of a joint between two samples [rad/s]; a fifth of it in m/s."""

UNLIMITED = 1e6
"""A limit above this is none: Pinocchio has the largest number there is in its place."""

MATCH = 0.03
"""A wrap is a turn to within this share."""


@dataclass(frozen=True)
class Jumps:
    """Steps of a position that its speed before and after does not explain.

    Attributes
    ----------
    row : (k,)
        Rows after the jumps.
    size : (k,)
        How far [rad or m].
    step : (k,)
        Time since the row before [s].
    """

    row: npt.NDArray[np.intp]
    size: FloatArray
    step: FloatArray


def turns(robot: Robot) -> list[tuple[float, ...]]:
    """Angle after which the encoder of each joint may wrap: a turn of the link, or of the motor's shaft [rad or m]."""
    out = []
    for slides, ratio in zip(sliding(robot), np.abs(robot.gear_ratio), strict=True):
        link, shaft = () if slides else (2 * np.pi,), () if ratio <= 1 else (2 * np.pi / float(ratio),)
        out.append((*link, *shaft))
    return out


def sliding(robot: Robot) -> list[bool]:
    """Which joints are prismatic."""
    return [robot.tree.joint(name).slides for name in robot.names]


def jumps(view: View, signal: str, index: int, least: float) -> Jumps:
    """Find the jumps of at least ``least`` of a channel, rows missing left out."""
    values, t = getattr(view.log, signal)[:, index], view.log.t
    rows, earlier = np.arange(len(values)), 0
    if view.before is not None:
        held = getattr(view.before, signal)[:, index]
        values, t = np.concatenate((held, values)), np.concatenate((view.before.t, t))
        earlier = len(held)
        rows = np.arange(-earlier, len(values) - earlier)
    if np.isnan(values).any():
        there = ~np.isnan(values)
        values, t, rows = values[there], t[there], rows[there]
    steps = np.diff(values)
    big = np.flatnonzero(np.abs(steps) > least)
    if not len(big) or len(steps) < 3:
        return Jumps(np.empty(0, np.intp), np.empty(0), np.empty(0))
    dt = np.diff(t)
    speed = steps / dt
    left, right = np.where(big > 0, big - 1, big + 1), np.where(big < len(steps) - 1, big + 1, big - 1)
    size = steps[big] - 0.5 * (speed[left] + speed[right]) * dt[big]
    around = np.abs(speed[right] - speed[left]) * dt[big] + 4 * np.median(np.abs(np.diff(steps)))
    clean = (np.abs(size) > CLEAN * around) & (np.abs(size) > least)
    clean &= (dt[big] < 3 * view.log.period) & (rows[big + 1] >= 0)
    return Jumps(rows[big + 1][clean], size[clean], dt[big][clean])


def wraps(view: View) -> Iterator[tuple[Finding, str, int, FloatArray]]:
    """Find encoders that wrap: with each the offset (T,) that puts it right."""
    for joint, periods in enumerate(turns(view.robot)):
        for signal, _, column, _ in (c for c in view.channels("theta", "q") if c[1] == joint):
            for turn in periods:
                found = jumps(view, signal, joint, 0.5 * turn)
                match = np.abs(np.abs(found.size) - turn) < MATCH * turn
                if not match.any() or match.mean() < 0.9 or len(found.row) > 0.035 * len(view.log) + 1:
                    continue
                offset = np.zeros(len(view.log))
                np.add.at(offset, found.row[match], -np.sign(found.size[match]) * turn)
                first, count = int(found.row[match][0]), int(match.sum())
                what = f"wraps by {turn:.6g}, a turn of the {'link' if turn == 2 * np.pi else 'motor shaft'},"
                remedy = "corrected here; record an unwrapped position to be sure"
                size = float(found.size[match][0])
                one = view.finding("wrap", "mended", column, what, remedy, at=first, size=size, count=count)
                yield one, signal, joint, np.cumsum(offset)
                break


def impossible(view: View) -> Iterator[Finding]:
    """Find positions that jump as no joint does."""
    slides = sliding(view.robot)
    for signal, joint, column, values in view.channels("theta", "q"):
        fastest = SPEED / 5 if slides[joint] else SPEED
        found = jumps(view, signal, joint, max(fastest * view.log.period, 0.05 * fastest / SPEED))
        fast = np.abs(found.size) > fastest * found.step
        if not fast.any() or len(found.row) > 0.01 * len(values) + 2:
            continue
        at, size = int(found.row[fast][0]), float(found.size[fast][0])
        what = f"jumps by {size:.6g}, more than a joint moves in {found.step[fast][0]:.3g} s,"
        remedy = "if two recordings were joined there, run them apart; set what is wrong to NaN"
        yield view.finding("jump", "refused", column, what, remedy, at=at, size=size, count=int(fast.sum()))


def limits(view: View) -> Iterator[Finding]:
    """Find positions beyond the limits of the URDF."""
    lower, upper = joint_limits(view.robot)
    slack = 0.05 * (upper - lower)
    least, most = np.fmin.reduce(view.log.theta), np.fmax.reduce(view.log.theta)
    with np.errstate(invalid="ignore"):
        beyond = (least < lower - slack) | (most > upper + slack)
    for joint in np.flatnonzero(beyond):
        column, values = view.log.columns("theta")[joint], view.log.theta[:, joint]
        at = int(np.argmax((values < lower[joint] - slack[joint]) | (values > upper[joint] + slack[joint])))
        what = f"is {values[at]:.6g}, beyond its joint's limits {lower[joint]:.6g} to {upper[joint]:.6g},"
        remedy = "check its unit, its zero and the side of the gear, or the limits in the URDF"
        yield view.finding("limits", "suspicious", column, what, remedy, at=at, size=float(values[at]))


def joint_limits(robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Least and largest position of each joint, infinite where the URDF gives none, two of (n,)."""
    lower, upper = np.full(robot.n, -np.inf), np.full(robot.n, np.inf)
    for index, name in enumerate(robot.names):
        low, high = robot.tree.joint(name).limits
        if low < high < UNLIMITED:
            lower[index], upper[index] = low, high
    return lower, upper
