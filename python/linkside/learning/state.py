"""The state of an iteration in one file, between repeats of which a real robot makes some in a day."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from linkside.arrays import FloatArray
from linkside.channels import joint_columns
from linkside.errors import EstimatorError, LogError
from linkside.files.opening import open_table
from linkside.files.tables import failure, numbers, reading
from linkside.recording.writer import EstimateWriter
from linkside.robot import Robot
from linkside.robot.limits import Limits

from .belief import Belief
from .learning import Margin, PathLearning
from .loop import Motion
from .trial import Trial

KEY = "linkside.learning"
"""Of the file's metadata: settings and trials, as JSON."""

SIGNALS = ("q", "dq", "ddq", "v", "e", "e_std")
"""What the iteration goes on from: the motion, the correction's second derivative, and what is known of errors."""


@dataclass(frozen=True)
class _Rows:
    """Columns as they are written."""

    columns: dict[str, FloatArray]

    def to_arrow(self) -> pa.Table:
        return pa.table(self.columns)


def write(learning: PathLearning, path: str | PathLike[str]) -> None:
    """Write the state of an iteration, whole or not at all.

    Columns are ``t``, the wanted motion ``q_``, ``dq_``, ``ddq_<joint>``, the correction ``u_<joint>`` and its second
    derivative ``v_<joint>``, the error to expect of the next repeat and its standard deviation, ``e_<joint>`` and
    ``e_std_<joint>``, and what motors are to follow in the next repeat, ``ref_<joint>`` = q + u.

    Raises
    ------
    OutputError
        When that cannot be.
    """
    motion, names = learning.motion, learning.robot.names
    signals = {
        "q": motion.q,
        "dq": motion.dq,
        "ddq": motion.ddq,
        "v": learning.curvature,
        "e": learning.belief.error,
        "e_std": np.sqrt(learning.belief.variance),
        "u": learning.correction,
        "ref": motion.q + learning.correction,
    }
    columns = {"t": motion.t}
    for signal, values in signals.items():
        columns |= {c: np.ascontiguousarray(v) for c, v in zip(joint_columns(signal, names), values.T, strict=True)}
    settings = {
        "kp": learning.kp.tolist(),
        "kd": learning.kd.tolist(),
        "bandwidth": learning.bandwidth,
        "rate": learning.rate,
        "margin": asdict(learning.margin),
        "limits": _listed(learning.limits),
        "trials": [asdict(trial) for trial in learning.trials],
    }
    with EstimateWriter(str(path), {KEY: json.dumps(settings)}) as file:
        file.write(_Rows(columns))


def read(path: str | PathLike[str], robot: Robot) -> PathLearning:
    """Resume from a file that `write` has written.

    Raises
    ------
    LogError
        A file that is none, or of another robot.
    EstimatorError
        Settings with which the robot as it is now would not converge.
    """
    source = str(path)
    settings = _settings(source)
    table = open_table(source)
    wanted = {signal: joint_columns(signal, robot.names) for signal in SIGNALS}
    missing = [c for columns in wanted.values() for c in columns if c not in table.names]
    if missing or "t" not in table.names:
        raise failure(source, f"no column {(missing or ['t'])[0]!r}: this is a state of learning of another robot")
    rows = table.read(["t", *(c for columns in wanted.values() for c in columns)])
    q, dq, ddq, v, e, std = (
        np.stack([numbers(rows, c, source) for c in columns], axis=1) for columns in wanted.values()
    )
    try:
        motion, trials = Motion(numbers(rows, "t", source), q, dq, ddq), settings.pop("trials")
        margin, limits = Margin(**settings.pop("margin")), _limits(settings.pop("limits"))
        learning = PathLearning(robot, motion, **settings, margin=margin, limits=limits)
        return learning.resumed(v, tuple(Trial(**_tupled(trial)) for trial in trials), Belief(e, std**2))
    except (TypeError, KeyError) as error:
        raise failure(source, f"its settings are not those of a state of learning: {error}") from None
    except EstimatorError as error:
        raise EstimatorError(f"{source}: {error}") from None


def wanted_motion(path: str | PathLike[str], robot: Robot) -> Motion:
    """Read how links are to move: columns ``t`` and ``qref_<joint>``, or ``q_<joint>`` where those are not there.

    Raises
    ------
    LogError
        A column is missing.
    EstimatorError
        Times that are not evenly spaced, or values that are missing.
    """
    table = open_table(str(path))
    for signal in ("qref", "q"):
        columns = joint_columns(signal, robot.names)
        if set(columns) <= set(table.names):
            break
    else:
        raise failure(table.source, f"no columns qref_<joint> or q_<joint> of {', '.join(robot.names)}")
    if "t" not in table.names:
        raise failure(table.source, "no column 't'")
    rows = table.read(["t", *columns])
    q = np.stack([numbers(rows, column, table.source) for column in columns], axis=1)
    return Motion.through(numbers(rows, "t", table.source), q)


def _settings(source: str) -> dict[str, Any]:
    """What the file's metadata say."""
    if not source.lower().endswith(".parquet"):
        raise failure(source, "a state of learning is a .parquet file, as `linkside learn` writes it")
    with reading(source):
        metadata = pq.read_schema(source).metadata or {}
    try:
        settings: dict[str, Any] = json.loads(metadata[KEY.encode()])
    except (KeyError, ValueError):
        raise LogError(f"{source}: this is no state of learning; `linkside learn start` begins one") from None
    return settings


def _listed(limits: Limits | None) -> dict[str, Any] | None:
    """Limits for JSON, which has no infinity: its numbers as texts."""
    return None if limits is None else {name: values.astype(str).tolist() for name, values in vars(limits).items()}


def _limits(listed: dict[str, Any] | None) -> Limits | None:
    return None if listed is None else Limits(**{name: np.array(values, float) for name, values in listed.items()})


def _tupled(trial: dict[str, Any]) -> dict[str, Any]:
    return {name: tuple(value) if isinstance(value, list) else value for name, value in trial.items()}
