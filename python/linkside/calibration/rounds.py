"""Rounds of Gauss-Newton steps on many logs: each is evaluated by itself, and gives a few numbers that are summed."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import NumericalError
from linkside.mapping import Map
from linkside.recording.log import Log
from linkside.robot import Robot

from .between import variances, widened
from .parameters import Parameter
from .prepared import recordings
from .recordings import refuse
from .response import ResponseProblem
from .response_run import WIDER
from .search import BOX
from .uncertainty import MEMORY, long_run

OF_GROUPS = ("payload_mass", "payload_xyz")
"""Kinds that logs of one group share."""

OF_LOGS = ("bias",)
"""Kinds that each log has for itself."""

STEPS = 12
"""Most steps in one band."""

SHORTEST = 1 / 16
"""A shorter share of a step is not tried."""


@dataclass(frozen=True, eq=False)
class Task:
    """One log to evaluate: the parameters' z, the band [Hz], and the smoothing of motors; None chooses that."""

    log: str | Log
    z: FloatArray
    corner: float
    wider: float | None


@dataclass(frozen=True, eq=False)
class LogEvidence:
    """What one log says at one point: a few numbers, whatever its length.

    Attributes
    ----------
    value : float
        Log-likelihood.
    gradient : (p,)
        Its gradient in z.
    information : (p, p)
        Fisher's information.
    lasting : (p, p)
        Long-run variance of the gradient, larger than the information where errors last.
    wider : float
        Factor on the corner frequencies that smooth the motors.
    """

    value: float
    gradient: FloatArray
    information: FloatArray
    lasting: FloatArray
    wider: float


def evaluate(robot: Robot, free: Sequence[Parameter], task: Task) -> LogEvidence:
    """Evaluate one log at one point, with noise levels and the links' start as its residuals have them there."""
    log = task.log if isinstance(task.log, Log) else Log.read(task.log, robot)
    refuse(robot, [log])
    problem = ResponseProblem(robot, recordings(robot, [log]), free)
    tried = WIDER if task.wider is None else (task.wider,)
    smoothed = (problem if wider == 1.0 else problem.smoothed(wider) for wider in tried)
    problems = [one.settled(task.z, task.corner) for one in smoothed]
    best = int(np.argmax([one.log_likelihood(task.z) for one in problems])) if len(tried) > 1 else 0
    found = problems[best].evidence(task.z, detail=True)
    lasting = long_run(found.scores[0], round(MEMORY / log.period))
    return LogEvidence(found.log_likelihood, found.gradient, found.information, lasting, tried[best])


def scope(p: Parameter) -> str:
    """What has a parameter: the robot, a group of logs, or a log."""
    return "group" if p.kind in OF_GROUPS else "log" if p.kind in OF_LOGS else "robot"


@dataclass(frozen=True, eq=False)
class SharedColumns:
    """Where the parameters of each log are among all that is estimated.

    Attributes
    ----------
    free : tuple of Parameter
        The parameters of a log, p of them.
    labels : list
        The groups.
    columns : list of (owner, Parameter)
        What logs share, d columns; an owner is ``"robot"``, ``"drift"`` or ``("group", label)``.
    own : (o,)
        Indices in ``free`` of what each log has for itself.
    common : (s,)
        Indices of the others.
    by : list of (s, d)
        Each log's share of the columns.
    """

    free: tuple[Parameter, ...]
    labels: list[Hashable]
    columns: list[tuple[Hashable, Parameter]]
    own: list[int]
    common: list[int]
    by: list[FloatArray]

    @classmethod
    def of(
        cls, free: Sequence[Parameter], labels: Sequence[Hashable], at: FloatArray, drift: Sequence[str]
    ) -> SharedColumns:
        """Lay out parameters of logs with group ``labels``, recorded ``at`` times about their mean, (logs,)."""
        groups = list(dict.fromkeys(labels))
        columns: list[tuple[Hashable, Parameter]] = [("robot", p) for p in free if scope(p) == "robot"]
        columns += [("drift", p) for p in free if p.kind in drift]
        columns += [(("group", label), p) for label in groups for p in free if scope(p) == "group"]
        common = [k for k, p in enumerate(free) if scope(p) != "log"]
        by = []
        for label, time in zip(labels, at, strict=True):
            share: dict[Hashable, float] = {"robot": 1.0, "drift": float(time), ("group", label): 1.0}
            by.append(np.array([[share.get(o, 0.0) * (p is free[k]) for o, p in columns] for k in common]))
        own = [k for k, p in enumerate(free) if scope(p) == "log"]
        return cls(tuple(free), groups, columns, own, common, [b.reshape(len(common), len(columns)) for b in by])

    def z(self, i: int, a: FloatArray, own: FloatArray) -> FloatArray:
        """The parameters of log ``i``, (p,)."""
        z = np.empty(len(self.free))
        z[self.common], z[self.own] = self.by[i] @ a, own
        return z


@dataclass(frozen=True, eq=False)
class _Everywhere:
    """Where all logs were evaluated: what they share, what each has, and what each says."""

    a: FloatArray
    own: list[FloatArray]
    found: list[LogEvidence]
    value: float


@dataclass(frozen=True, eq=False)
class _Rest:
    """What a log says of what logs share, when what it has for itself is eliminated.

    ``gradient`` and ``information`` are (s,) and (s, s). ``within`` is the covariance of its own parameters where all
    else is known, (o, o), ``follow`` how these follow its share of the others, (o, s).
    """

    gradient: FloatArray
    information: FloatArray
    within: FloatArray
    follow: FloatArray


@dataclass(frozen=True, eq=False)
class SharedUncertainty:
    """Standard errors in tolerances.

    Attributes
    ----------
    std : (d,)
        Of what logs share.
    common : (d,)
        The part of it that does not become smaller with more logs.
    of_logs : list of (o,)
        Of what each log has for itself.
    """

    std: FloatArray
    common: FloatArray
    of_logs: list[FloatArray]


class Rounds:
    """The search for the most probable parameters of many logs.

    Parameters
    ----------
    layout
        Where parameters are.
    logs
        Paths or logs.
    robot
        Theirs.
    held
        Parameters that are uncertain by their tolerances, but not estimated.
    run
        Evaluates tasks, in their order.
    """

    def __init__(
        self,
        layout: SharedColumns,
        logs: Sequence[str | Log],
        robot: Robot,
        held: Sequence[Parameter],
        run: Map,
    ) -> None:
        self.layout, self.logs, self.robot, self.held, self.run = layout, list(logs), robot, tuple(held), run
        self.count = 0
        self._a = np.zeros(len(layout.columns))
        self._own = [np.zeros(len(layout.own)) for _ in self.logs]
        self._wider: list[float | None] = [1.0] * len(self.logs)
        self._here: _Everywhere | None = None

    @property
    def here(self) -> _Everywhere:
        """The best point so far."""
        assert self._here is not None  # after the first climb
        return self._here

    def climb(self, corner: float, gain: float) -> None:
        """Search in one band until a step would gain less than ``gain`` of log-likelihood."""
        if not np.isfinite(corner):
            self._wider = [None] * len(self.logs)
        here = self._at(self._a, self._own, corner)
        self._wider = [found.wider for found in here.found]
        for _ in range(STEPS):
            step, own, foretold = self._step(here)
            if foretold < gain:
                break
            there = self._towards(here, step, own, corner)
            if there is None:
                break
            here = there
        self._here, self._a, self._own = here, here.a, here.own

    def uncertainty(self) -> SharedUncertainty:
        """Say how far to trust the estimates.

        What is independent from log to log is the largest of the information, the long-run variance of the gradient
        within logs (as in `linkside.calibration.uncertainty`), and the scatter of logs about what they share, see
        `between`. What all logs have in common no scatter shows: parameters that are held at robot.yaml's values are
        uncertain by their tolerances, and estimates follow them (S. F. Schmidt 1966: consider covariance).
        """
        rests = [self._rest(found, own) for found, own in zip(self.here.found, self.here.own, strict=True)]
        plain = np.asarray(np.linalg.inv(self._curvature(rests)), np.float64)
        with_held = self._with_held()
        held, own_held = self._of_held(plain, rests, with_held)
        spreads = self._lasting(rests), self._between(rests, with_held)
        larger = [plain @ (spread + np.eye(len(plain))) @ plain for spread in spreads]
        variance = np.max([np.diag(plain), *(np.diag(one) for one in larger)], axis=0)
        wider = np.sqrt(variance / np.diag(plain))
        covariance = plain * np.outer(wider, wider)
        of_logs = []
        for found, rest, by, of_held in zip(self.here.found, rests, self.layout.by, own_held, strict=True):
            own = np.ix_(self.layout.own, self.layout.own)
            lasting = rest.within @ (found.lasting[own] + np.eye(len(rest.within))) @ rest.within
            alone = np.maximum(np.diag(rest.within), np.diag(lasting))
            pull = rest.follow @ by
            variance_of_own = alone + np.einsum("ij,jk,ik->i", pull, covariance, pull) + np.sum(of_held**2, axis=1)
            of_logs.append(np.sqrt(np.minimum(variance_of_own, np.maximum(alone, 1.0))))
        # No more than the prior leaves: a parameter that no log shows keeps its tolerance.
        single, common = np.sqrt(variance), np.sqrt(np.sum(held**2, axis=1))
        std = np.minimum(np.hypot(single, common), np.maximum(single, 1.0))
        return SharedUncertainty(std, np.minimum(common, std), of_logs)

    def _lasting(self, rests: Sequence[_Rest]) -> FloatArray:
        """Variance of the gradient in what logs share, by its course within logs, (d, d)."""
        own, common, d = self.layout.own, self.layout.common, len(self.here.a)
        lasting = np.zeros((d, d))
        for evidence, rest, by in zip(self.here.found, rests, self.layout.by, strict=True):
            effective = np.zeros((len(common), len(self.layout.free)))
            effective[:, common], effective[:, own] = np.eye(len(common)), -rest.follow.T
            lasting += by.T @ effective @ evidence.lasting @ effective.T @ by
        return lasting

    def _between(self, rests: Sequence[_Rest], with_held: Sequence[LogEvidence]) -> FloatArray:
        """The same by how much logs differ, beyond what held parameters make of their motions, (d, d)."""
        own, common, d = self.layout.own, self.layout.common, len(self.here.a)
        held = list(range(len(self.layout.free), len(self.layout.free) + len(self.held)))
        size = d + len(held)
        gradient, curvature, slopes = np.zeros(size), np.eye(size), []
        gradient[:d] = -self.here.a
        for found, rest, x, by in zip(with_held, rests, self.here.own, self.layout.by, strict=True):
            cross = found.information[np.ix_(own, held)]
            of_held = found.information[np.ix_(common, held)] - rest.follow.T @ cross
            slope = found.gradient[held] - cross.T @ rest.within @ (found.gradient[own] - x)
            gradient += np.concatenate([by.T @ rest.gradient, slope])
            slopes.append(np.concatenate([rest.information @ by, of_held], axis=1))
            curvature[:d, :d] += by.T @ rest.information @ by
            curvature[:d, d:] += by.T @ of_held
            curvature[d:, :d] += of_held.T @ by
            curvature[d:, d:] += found.information[np.ix_(held, held)] - cross.T @ rest.within @ cross
        each = [np.array(values) for values in zip(*((r.gradient, r.information) for r in rests), strict=True)]
        effects = widened(*variances(each[0], each[1], np.array(slopes), gradient, curvature))
        parts = [r.information + r.information * effects @ r.information for r in rests]
        return np.asarray(np.sum([by.T @ part @ by for part, by in zip(parts, self.layout.by, strict=True)], axis=0))

    def _with_held(self) -> list[LogEvidence]:
        """What logs say where what is held were free."""
        zeros = np.zeros(len(self.held))
        at = [np.append(self.layout.z(i, self.here.a, x), zeros) for i, x in enumerate(self.here.own)]
        return self._found(partial(evaluate, self.robot, (*self.layout.free, *self.held)), at, np.inf)

    def _of_held(
        self, plain: FloatArray, rests: Sequence[_Rest], with_held: Sequence[LogEvidence]
    ) -> tuple[FloatArray, list[FloatArray]]:
        """How estimates follow the parameters that are held, in tolerances: (d, h), and (o, h) of each log."""
        own, common, p = self.layout.own, self.layout.common, len(self.layout.free)
        crosses = [found.information[:, p:] for found in with_held]
        slope = np.zeros((len(self.here.a), len(self.held)))
        for cross, rest, by in zip(crosses, rests, self.layout.by, strict=True):
            slope += by.T @ (cross[common] - rest.follow.T @ cross[own])
        shared = -plain @ slope
        return shared, [
            -rest.within @ cross[own] - rest.follow @ by @ shared
            for cross, rest, by in zip(crosses, rests, self.layout.by, strict=True)
        ]

    def _found(
        self, function: Callable[[Task], LogEvidence], at: Sequence[FloatArray], corner: float
    ) -> list[LogEvidence]:
        """Evaluate each log at its point."""
        tasks = [Task(log, z, corner, wider) for log, z, wider in zip(self.logs, at, self._wider, strict=True)]
        self.count += 1
        return list(self.run(function, tasks))

    def _at(self, a: FloatArray, own: list[FloatArray], corner: float) -> _Everywhere:
        at = [self.layout.z(i, a, own[i]) for i in range(len(self.logs))]
        found = self._found(partial(evaluate, self.robot, self.layout.free), at, corner)
        prior = a @ a + sum(x @ x for x in own)
        return _Everywhere(a, own, found, float(sum(one.value for one in found) - 0.5 * prior))

    def _towards(self, here: _Everywhere, step: FloatArray, own: list[FloatArray], corner: float) -> _Everywhere | None:
        """The point at the end of a step, or of a part of it; None if none is better."""
        share = 1.0
        low, high = self._bounds
        while share >= SHORTEST:
            a = np.clip(here.a + share * step, low, high)
            moved = [x + share * change for x, change in zip(here.own, own, strict=True)]
            try:
                there = self._at(a, moved, corner)
            except NumericalError:  # links fly away
                there = None
            if there is not None and there.value > here.value:
                return there
            share /= 4
        return None

    def _step(self, here: _Everywhere) -> tuple[FloatArray, list[FloatArray], float]:
        """The step of what logs share and of what each has, and the gain that it promises."""
        rests = [self._rest(found, own) for found, own in zip(here.found, here.own, strict=True)]
        curvature, gradient = self._curvature(rests), -here.a
        for rest, by in zip(rests, self.layout.by, strict=True):
            gradient = gradient + by.T @ rest.gradient
        low, high = self._bounds
        held = ((here.a <= low) & (gradient < 0)) | ((here.a >= high) & (gradient > 0))
        moves = np.flatnonzero(~held)
        step = np.zeros(len(here.a))
        step[moves] = np.linalg.solve(curvature[np.ix_(moves, moves)], gradient[moves])
        own, gain = [], 0.5 * float(step @ gradient)
        for found, x, rest, by in zip(here.found, here.own, rests, self.layout.by, strict=True):
            slope = found.gradient[self.layout.own] - x
            own.append(rest.within @ slope - rest.follow @ by @ step)
            gain += 0.5 * float(slope @ rest.within @ slope)
        longest = max(np.abs(step).max(initial=0.0), *(np.abs(x).max(initial=0.0) for x in own))
        share = min(1.0, BOX / longest) if longest else 1.0
        return share * step, [share * x for x in own], gain

    def _rest(self, found: LogEvidence, x: FloatArray) -> _Rest:
        own, common = self.layout.own, self.layout.common
        cross = found.information[np.ix_(own, common)]
        within = np.asarray(np.linalg.inv(found.information[np.ix_(own, own)] + np.eye(len(own))), np.float64)
        follow = within @ cross
        gradient = found.gradient[common] - follow.T @ (found.gradient[own] - x)
        return _Rest(gradient, found.information[np.ix_(common, common)] - cross.T @ follow, within, follow)

    def _curvature(self, rests: Sequence[_Rest]) -> FloatArray:
        """Of the posterior in what logs share, (d, d)."""
        parts = [by.T @ rest.information @ by for rest, by in zip(rests, self.layout.by, strict=True)]
        return np.asarray(np.eye(len(self.layout.columns)) + np.sum(parts, axis=0))

    @property
    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of what logs share, (d,) each; a drift has none."""
        columns = self.layout.columns
        low = np.array([-np.inf if owner == "drift" else p.z(p.low) for owner, p in columns])
        return low, np.array([np.inf if owner == "drift" else p.z(p.high) for owner, p in columns])
