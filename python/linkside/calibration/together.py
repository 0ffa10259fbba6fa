"""Calibration of one robot from many logs: what all share, what belongs to a load or a log, and drift.

Each log is evaluated by itself and gives a gradient and an information matrix of a few numbers. These are summed, what
belongs to one log alone is eliminated (Schur complement), and the most probable parameters are found in rounds of
Gauss-Newton steps. A round needs one log in memory at a time, and its evaluations can run anywhere.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.mapping import Map, here
from linkside.recording.log import Log
from linkside.robot import Robot

from .parameters import NOISE, Parameter, beside, choose
from .response import OF_TIME
from .response_run import CORNERS
from .rounds import Rounds, SharedColumns, scope
from .search import GAIN, ROUGH

FREE = ("stiffness", "damping", "payload_mass", "bias")
"""Kinds that are free by default."""


@dataclass(frozen=True)
class Shared:
    """An estimate in ``unit``: value, standard error and prior standard deviation.

    ``common`` is the part of the standard error that more logs do not reduce: by what robot.yaml holds at values that
    are uncertain, such as masses.
    """

    name: str
    unit: str
    value: float
    std: float
    prior_std: float
    common: float


@dataclass(frozen=True, eq=False)
class Together:
    """Parameters of one robot from many logs.

    Attributes
    ----------
    robot : dict of str to Shared
        What all logs share, at the mean time of the logs where it drifts.
    drift : dict of str to Shared
        Change per unit of time, for kinds that drift; of positive parameters relative to the value.
    groups : dict of label to dict
        What logs of one group share.
    logs : list of dict
        What each log has for itself, in their order.
    log_likelihood : float
        Of all logs.
    rounds : int
        Evaluations of all logs.
    seconds : float
        Time that it took [s].
    """

    robot: dict[str, Shared]
    drift: dict[str, Shared]
    groups: dict[Hashable, dict[str, Shared]]
    logs: list[dict[str, Shared]]
    log_likelihood: float
    rounds: int
    seconds: float


def calibrate_together(
    robot: Robot,
    logs: Sequence[str | Path | Log],
    groups: Sequence[Hashable] | None = None,
    *,
    free: Iterable[str] = FREE,
    times: Sequence[float] | None = None,
    drift: Iterable[str] = (),
    run: Map = here,
) -> Together:
    """Find a robot's parameters from many logs, some with other loads, and sensors whose biases change.

    The posterior probability is that of `calibrate` without motor torques, with a prior for each parameter, around the
    value of robot.yaml with its tolerance: one for what all logs share, for each group's payload, and for each log's
    biases. Standard errors contain how much logs differ, by a variance between logs (restricted maximum likelihood),
    and the tolerances of what is held: masses, mountings, scales and delays that are not in ``free``.

    Parameters
    ----------
    robot
        The robot as robot.yaml has it.
    logs
        Its logs: paths, which are read when they are evaluated, or logs.
    groups
        A label for each log; logs with the same label carry the same payload. By default all do.
    free
        Kinds or names of free parameters, as in `calibrate`. Nothing is refused: a parameter that the logs do not
        determine keeps its tolerance as standard error.
    times
        When each log was recorded, in any unit, for ``drift``.
    drift
        Of ``free``, kinds that also change linearly over ``times``; the prior of the change over their whole span is
        the tolerance.
    run
        Evaluates the logs: ``map`` of an executor or of a cluster, see `linkside.fleet.mapped`.

    Raises
    ------
    EstimatorError
        A name that is not a free parameter, or a number of labels or times that is not the number of logs.
    LogError
        A log that cannot be used, see `calibrate`.
    NumericalError
        The links diverge at the values of robot.yaml.
    """
    began = time.perf_counter()
    if not len(logs):
        raise EstimatorError("there is no log to calibrate with")
    layout = _layout(robot, len(logs), groups, tuple(free), times, tuple(drift))
    paths = [log if isinstance(log, Log) else str(log) for log in logs]
    rounds = Rounds(layout, paths, robot, beside(robot, layout.free), run)
    for corner in (*CORNERS, np.inf):
        rounds.climb(corner, GAIN if corner == np.inf else ROUGH)
    return _outcome(
        layout, rounds, float(np.ptp(times)) if drift and times is not None else 1.0, time.perf_counter() - began
    )


def _layout(
    robot: Robot,
    count: int,
    groups: Sequence[Hashable] | None,
    free: tuple[str, ...],
    times: Sequence[float] | None,
    drift: tuple[str, ...],
) -> SharedColumns:
    chosen = choose(robot, free, False, {})
    for p in chosen:
        if p.kind in (*NOISE, *OF_TIME):
            raise EstimatorError(f"free: {p.name!r} is found by calibrate, not from many logs together; leave it out")
    for kind in drift:
        if kind not in {p.kind for p in chosen if scope(p) == "robot"}:
            raise EstimatorError(f"drift: {kind!r} is no free kind that all logs share; free are {', '.join(free)}")
    labels = [0] * count if groups is None else list(groups)
    if len(labels) != count:
        raise EstimatorError(f"groups has {len(labels)} labels for {count} logs")
    at = _spanned(times, count) if drift else np.zeros(count)
    return SharedColumns.of(chosen, labels, at, drift)


def _spanned(times: Sequence[float] | None, count: int) -> FloatArray:
    """Times about their mean, as shares of their span."""
    if times is None:
        raise EstimatorError("drift needs times, one for each log")
    at = np.asarray(times, float)
    if at.shape != (count,) or not np.isfinite(at).all():
        raise EstimatorError(f"times are {at.shape}, expected a finite time for each of {count} logs")
    if not np.ptp(at) > 0:
        raise EstimatorError("drift needs logs of different times")
    return np.asarray((at - at.mean()) / np.ptp(at))


def _outcome(layout: SharedColumns, rounds: Rounds, span: float, seconds: float) -> Together:
    known = rounds.uncertainty()
    found: dict[Hashable, dict[str, Shared]] = {"robot": {}, "drift": {}}
    rows = zip(layout.columns, rounds.here.a.tolist(), known.std.tolist(), known.common.tolist(), strict=True)
    for (owner, p), z, s, common in rows:
        made = _drift(p, z, s, common, span) if owner == "drift" else _shared(p, z, s, common)
        found.setdefault(owner, {})[p.name] = made
    own = [layout.free[k] for k in layout.own]
    logs = [
        {p.name: _shared(p, z, s) for p, z, s in zip(own, at.tolist(), sizes.tolist(), strict=True)}
        for at, sizes in zip(rounds.here.own, known.of_logs, strict=True)
    ]
    groups = {label: found.get(("group", label), {}) for label in layout.labels}
    value = sum(one.value for one in rounds.here.found)
    return Together(found["robot"], found["drift"], groups, logs, value, rounds.count, seconds)


def _shared(p: Parameter, z: float, std: float, common: float = 0.0) -> Shared:
    return Shared(p.name, p.unit, p.value(z), std * p.slope(z), p.slope(z), common * p.slope(z))


def _drift(p: Parameter, z: float, std: float, common: float, span: float) -> Shared:
    """Change per unit of time: relative for parameters that are varied by their logarithm."""
    scale = p.tolerance / span
    return Shared(p.name, "" if p.relative else p.unit, scale * z, scale * std, scale, scale * common)
