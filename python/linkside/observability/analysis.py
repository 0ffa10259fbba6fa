"""Which link accelerations the sensors observe, how well, and in which postures they do not.

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

import numpy as np

from linkside.arrays import FloatArray
from linkside.recording.log import Log, LogStream
from linkside.robot import Robot
from linkside.robot.workspace import joint_limits, sobol

from .report import CheckReport
from .result import Observability, Path, Posture, describe, involved

LOG_ROWS = 500_000
"""A log with more rows than this is thinned out."""


def check(robot: Robot, log: Log | LogStream | None = None) -> CheckReport:
    """Analyse which link accelerations the sensors observe, how well, and where they are not observable.

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
    unit = sobol(2 * robot.n)
    q = limits[0] + unit[:, : robot.n] * (limits[1] - limits[0])
    other = limits[0] + unit[:, robot.n :] * (limits[1] - limits[0])
    observability = Observability.of(robot, q)
    path = None if log is None else _path(robot, log)
    home = limits.mean(axis=0) if path is None else np.median(path.q, axis=0)
    influence = _influence(robot, q[:4096], other[:4096])
    report = CheckReport(robot, limits, home, observability, influence, (), path)
    if not (report.observable and robot.elastic.any()):
        return report
    return CheckReport(robot, limits, home, observability, influence, _worst_postures(report, q), path)


def _path(robot: Robot, log: Log | LogStream) -> Path | None:
    rows = len(log) if isinstance(log, Log) else log.count or 0
    step = 1 + rows // LOG_ROWS
    times, postures, worst, joints = [], [], [], []
    for piece in (log[i : i + 65_536] for i in range(0, rows, 65_536)) if isinstance(log, Log) else log:
        known = np.flatnonzero(np.isfinite(piece.theta).all(axis=1))[::step]
        observability = Observability.of(robot, np.ascontiguousarray(piece.theta[known]))
        times.append(piece.t[known])
        postures.append(piece.theta[known])
        worst.append(observability.worst)
        joints.append(observability.joints)
    path = Path(log.source, *map(np.concatenate, (times, postures, worst, joints)))
    return path if len(path.t) else None


def _influence(robot: Robot, q: FloatArray, other: FloatArray) -> FloatArray:
    """Total-effect index of each joint: half the mean square change of log10 σ when it alone moves elsewhere."""

    def decades(q: FloatArray) -> FloatArray:
        return np.asarray(np.log10(np.clip(Observability.of(robot, q).worst, 1e-12, 1e12)))

    base, index = decades(q), np.zeros(robot.n)
    for joint in range(robot.n):
        moved = q.copy()
        moved[:, joint] = other[:, joint]
        index[joint] = 0.5 * np.mean((decades(moved) - base) ** 2)
    return index


def _worst_postures(report: CheckReport, q: FloatArray) -> tuple[Posture, ...]:
    """Refine the worst samples of each kind, and keep of each kind of singularity the one nearest to home."""
    found = [_refine(report, start) for start in _starts(report.observability, q)]
    kinds: dict[frozenset[int], list[Posture]] = {}
    for posture in (posture for posture in found if posture.singular):
        kinds.setdefault(frozenset(np.flatnonzero(involved(posture.direction))), []).append(posture)
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


def _starts(observability: Observability, q: FloatArray, kinds: int = 8, each: int = 8) -> FloatArray:
    """Pick the worst samples of each kind, by the joints that take part in what is seen worst."""
    order = np.argsort(-observability.worst, kind="stable")[: len(q) // 16]
    parts = involved(observability.directions[order, -1])
    kind = parts @ (1 << np.arange(parts.shape[1]))
    first = np.unique(kind, return_index=True)[1]
    chosen = [order[kind == kind[i]][:each] for i in np.sort(first)[:kinds]]
    return np.asarray(q[np.concatenate(chosen)])


def _refine(report: CheckReport, start: FloatArray) -> Posture:
    """Descend to the nearest minimum of σ², which unlike σ is smooth where it vanishes."""
    from scipy.optimize import minimize

    free = report.influential
    base = report.home.copy()
    base[free] = start[free]
    steps = 1e-6 * np.vstack([np.zeros(len(free)), np.eye(len(free)), -np.eye(len(free))])

    def square(x: FloatArray) -> tuple[float, FloatArray]:
        q = np.tile(base, (len(steps), 1))
        q[:, free] = x + steps
        value = Observability.of(report.robot, q).values[:, -1] ** 2
        up, down = value[1:].reshape(2, -1)
        return float(value[0]), (up - down) / 2e-6

    if len(free):
        bounds = report.limits[:, free].T
        options = {"ftol": 0.0, "gtol": 1e-12, "maxiter": 200}
        base[free] = minimize(square, base[free], jac=True, method="L-BFGS-B", bounds=bounds, options=options).x
    observability = Observability.of(report.robot, base[None])
    direction = observability.directions[0, -1]
    words = describe(report.joints, direction)
    return Posture(base, float(observability.worst[0]), float(observability.condition[0]), direction, words)
