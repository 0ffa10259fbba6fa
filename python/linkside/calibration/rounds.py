"""Rounds of Gauss-Newton steps on many logs: each is evaluated by itself, and gives a few numbers that are summed."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import NumericalError
from linkside.mapping import Map
from linkside.recording.log import Log
from linkside.robot import Robot

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

COMMON = 1.0
"""Errors that all logs have in common, as of motors' smoothing, in standard errors of one log: they stay in a mean."""

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

    @property
    def counts(self) -> FloatArray:
        """How many logs have a column in common, (d,); none of a drift, which is a difference between logs."""
        shared = np.sum([np.any(share != 0, axis=0) for share in self.by], axis=0)
        return np.where([owner == "drift" for owner, _ in self.columns], 0.0, shared)

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
class _Reduced:
    """What is left of all logs' evidence when what each has for itself is eliminated.

    ``lasting`` and ``between`` are variances of the gradient, by its course within logs and by its sums over logs.
    ``within`` is the covariance of a log's own parameters where all else is known, ``pull`` how these follow what logs
    share.
    """

    gradient: FloatArray
    curvature: FloatArray
    lasting: FloatArray
    between: FloatArray
    within: list[FloatArray]
    pull: list[FloatArray]


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
    run
        Evaluates tasks, in their order.
    """

    def __init__(self, layout: SharedColumns, logs: Sequence[str | Log], robot: Robot, run: Map) -> None:
        self.layout, self.logs, self.run = layout, list(logs), run
        self.count = 0
        self._evaluate = partial(evaluate, robot, layout.free)
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

    def uncertainty(self) -> tuple[FloatArray, list[FloatArray]]:
        """Standard errors, in tolerances: of what logs share (d,), and of what each has (o,).

        As in `linkside.calibration.uncertainty`, the larger of those by the information and by the variance of the
        gradient: its long-run variance within logs, and its variance between logs (K.-Y. Liang and S. L. Zeger,
        Biometrika 73, 1986), whose errors of the model differ with the motion. To what logs share, errors are added
        that all of them have in common, which no scatter shows.
        """
        reduced = self._reduced(self.here)
        plain = np.linalg.inv(reduced.curvature)
        larger = [plain @ (slow + np.eye(len(plain))) @ plain for slow in (reduced.lasting, reduced.between)]
        wider = np.sqrt(np.maximum(1.0, np.max([np.diag(one) for one in larger], axis=0) / np.diag(plain)))
        covariance = plain * np.outer(wider, wider)
        of_logs = []
        for found, within, pull in zip(self.here.found, reduced.within, reduced.pull, strict=True):
            own = np.ix_(self.layout.own, self.layout.own)
            lasting = within @ (found.lasting[own] + np.eye(len(within))) @ within
            alone = np.maximum(np.diag(within), np.diag(lasting))
            of_logs.append(np.sqrt(alone + np.einsum("ij,jk,ik->i", pull, covariance, pull)))
        std = np.sqrt(np.diag(covariance))
        # No more than the prior leaves: a parameter that no log shows keeps its tolerance.
        return np.minimum(std * np.sqrt(1.0 + COMMON**2 * self.layout.counts), np.maximum(std, 1.0)), of_logs

    def _at(self, a: FloatArray, own: list[FloatArray], corner: float) -> _Everywhere:
        tasks = [Task(log, self.layout.z(i, a, own[i]), corner, self._wider[i]) for i, log in enumerate(self.logs)]
        found = list(self.run(self._evaluate, tasks))
        self.count += 1
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
        reduced = self._reduced(here)
        low, high = self._bounds
        held = ((here.a <= low) & (reduced.gradient < 0)) | ((here.a >= high) & (reduced.gradient > 0))
        moves = np.flatnonzero(~held)
        step = np.zeros(len(here.a))
        step[moves] = np.linalg.solve(reduced.curvature[np.ix_(moves, moves)], reduced.gradient[moves])
        own, gain = [], 0.5 * float(step @ reduced.gradient)
        for found, x, within, pull in zip(here.found, here.own, reduced.within, reduced.pull, strict=True):
            slope = found.gradient[self.layout.own] - x
            own.append(within @ slope - pull @ step)
            gain += 0.5 * float(slope @ within @ slope)
        longest = max(np.abs(step).max(initial=0.0), *(np.abs(x).max(initial=0.0) for x in own))
        share = min(1.0, BOX / longest) if longest else 1.0
        return share * step, [share * x for x in own], gain

    def _reduced(self, here: _Everywhere) -> _Reduced:
        own, common, d = self.layout.own, self.layout.common, len(here.a)
        gradient, curvature, lasting, between = -here.a, np.eye(d), np.zeros((d, d)), np.zeros((d, d))
        all_within: list[FloatArray] = []
        all_pull: list[FloatArray] = []
        for found, x, by in zip(here.found, here.own, self.layout.by, strict=True):
            cross = found.information[np.ix_(own, common)]
            within = np.asarray(np.linalg.inv(found.information[np.ix_(own, own)] + np.eye(len(own))), np.float64)
            follow = within @ cross
            pulled = by.T @ (found.gradient[common] - follow.T @ (found.gradient[own] - x))
            gradient = gradient + pulled
            between += np.outer(pulled, pulled)
            curvature += by.T @ (found.information[np.ix_(common, common)] - cross.T @ follow) @ by
            effective = np.zeros((len(common), len(self.layout.free)))
            effective[:, common], effective[:, own] = np.eye(len(common)), -follow.T
            lasting += by.T @ effective @ found.lasting @ effective.T @ by
            all_within.append(within)
            all_pull.append(follow @ by)
        return _Reduced(gradient, curvature, lasting, between, all_within, all_pull)

    @property
    def _bounds(self) -> tuple[FloatArray, FloatArray]:
        """Bounds of what logs share, (d,) each; a drift has none."""
        columns = self.layout.columns
        low = np.array([-np.inf if owner == "drift" else p.z(p.low) for owner, p in columns])
        return low, np.array([np.inf if owner == "drift" else p.z(p.high) for owner, p in columns])
