"""Estimates, their files, and their error against a truth."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from enum import IntFlag
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.csv

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, LogError
from linkside.files.opening import open_table
from linkside.files.tables import Table, numbers
from linkside.findings import Fault
from linkside.robot.wrenches import AXES
from linkside.statistics import rms

from .log import Log
from .times import counterparts
from .writer import EstimateWriter

Statuses: TypeAlias = npt.NDArray[np.uint8]

Joints: TypeAlias = tuple[tuple[str, ...], tuple[str, ...]]
"""Names of joints, and of wrenches from outside."""

NAMES = ("names", "wrenches", "channels", "findings", "left_out")
"""Fields of an estimate that are no arrays."""

OUTSIDE = ("disturbance", "disturbance_std", "wrench", "wrench_std")
"""Fields of what acts on links from outside."""

if TYPE_CHECKING:
    import pandas  # type: ignore[import-untyped]
    import polars


class Status(IntFlag):
    """Status of a row of an estimate; several flags can be set at once."""

    GOOD = 0
    """Nothing to report."""
    DAMPED = 1
    """The posture is nearly singular for the accelerometers; poorly observed accelerations are damped."""
    BRIDGED = 2
    """A reading was missing when it was due, and was bridged by the model; a slow sensor's are due at its own rate."""
    UNSEEN = 4
    """Some combination of joint accelerations is not observed by the sensors at all."""
    GATED = 8
    """A reading was left out as an outlier, or had a weight below a tenth."""
    PREDICTED = 16
    """No reading was used: the row is a prediction."""
    UNWRAPPED = 32
    """An encoder wrapped, and its jump was removed."""
    CONTRADICTED = 64
    """Readings contradict the model: do not use the row and its standard deviations; see ``findings``."""
    FAULTY = 128
    """One channel contradicts the model and all other channels; see ``findings``."""


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """Motion of links and tool. A row at time t is the state at t.

    Attributes
    ----------
    t : (T,)
        Time [s].
    q, dq : (T, n)
        Link position [rad] and velocity [rad/s].
    theta, dtheta : (T, n)
        Motor position and velocity, reflected to the link side.
    status : (T,)
        `Status` of each row, uint8.
    names : tuple of str
        The n joints.
    ddq : (T, n), optional
        Link acceleration, where the method has it [rad/s²].
    tool_position : (T, 3), optional
        Tool in the base frame [m].
    q_std, tool_std : (T, n) and (T, 3), optional
        Standard deviations, if the method has a covariance [rad, m].
    disturbance, disturbance_std : (T, n), optional
        Estimated torque on each link that the model lacks, such as a contact, and its standard deviation [N m]; columns
        ``d_<joint>`` and ``d_std_<joint>``.
    wrench, wrench_std : (T, 6k), optional
        Force [N] and moment [N m] of each of the wrenches from outside that vary, and standard deviations; columns
        ``<wrench>_fx`` to ``<wrench>_tz`` and ``<wrench>_fx_std`` to ``<wrench>_tz_std``.
    wrenches : tuple of str
        Their names.
    covariance : (T, k, k), optional
        Covariance of the method's state. It is kept in memory only: files have the standard deviations.
    nis : (T,), optional
        Normalised innovation squared, if the method has innovations; its mean should be the number of readings used.
    findings : tuple of Fault
        Contradictions between readings and model, from the recording's start on; not in files.
    left_out : tuple of str
        Fields that are not columns and are not compared, because the recording itself has better values.
    """

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    theta: FloatArray
    dtheta: FloatArray
    status: npt.NDArray[np.uint8]
    names: tuple[str, ...]
    ddq: FloatArray | None = None
    tool_position: FloatArray | None = None
    q_std: FloatArray | None = None
    tool_std: FloatArray | None = None
    covariance: FloatArray | None = None
    nis: FloatArray | None = None
    disturbance: FloatArray | None = None
    disturbance_std: FloatArray | None = None
    wrench: FloatArray | None = None
    wrench_std: FloatArray | None = None
    wrenches: tuple[str, ...] = ()
    findings: tuple[Fault, ...] = ()
    left_out: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Check shapes, once."""
        rows, joints = len(self.t), len(self.names)
        of_joints = ("q", "dq", "ddq", "theta", "dtheta", "q_std", "disturbance", "disturbance_std")
        wanted = dict.fromkeys(of_joints, (rows, joints))
        wanted |= {"tool_position": (rows, 3), "tool_std": (rows, 3)}
        wanted |= dict.fromkeys(("wrench", "wrench_std"), (rows, len(AXES) * len(self.wrenches)))
        for name, shape in wanted.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise EstimatorError(f"{name} of an estimate has shape {array.shape}, expected {shape}")
        for name in ("t", "status", "covariance", "nis"):
            array = getattr(self, name)
            if array is not None and (len(array) != rows or array.ndim != (3 if name == "covariance" else 1)):
                raise EstimatorError(f"{name} of an estimate has shape {array.shape} for {rows} rows")

    @classmethod
    def read(cls, path: str | Path) -> Estimate:
        """Read a Parquet or CSV file with the columns of `columns`; the joints are those of its ``q_<joint>``.

        A file that lacks velocities or motor positions, as a measured truth may, has NaN in their place; one
        that lacks ``status`` is good throughout.

        Raises
        ------
        LogError
            When it cannot be used: one line with the file and the column.
        """
        file = open_table(path)
        joints, groups = _present(file)
        return cls._of(file.read([c for columns in groups.values() for c in columns]), joints, groups, file.source)

    @classmethod
    def stream(cls, path: str | Path, rows: int = 65_536) -> Iterator[Estimate]:
        """Read a file piece by piece, ``rows`` rows each, in bounded memory; as `read`."""
        file = open_table(path)
        joints, groups = _present(file)
        for piece in file.batches([c for columns in groups.values() for c in columns], rows):
            yield cls._of(piece, joints, groups, file.source)

    @classmethod
    def _of(cls, table: pa.Table, joints: Joints, groups: dict[str, list[str]], source: str) -> Estimate:
        arrays = {g: np.stack([numbers(table, c, source) for c in cs], axis=1) for g, cs in groups.items()}
        names, wrenches = joints
        return cls(names=names, wrenches=wrenches, **_complete(arrays, len(names), source))

    @classmethod
    def concatenate(cls, parts: Iterable[Estimate]) -> Estimate:
        """Join estimates of the same joints and method, one after the other in time."""
        parts = list(parts)
        if not parts:
            raise EstimatorError("there is no estimate to concatenate")
        for number, part in enumerate(parts):
            if part._form() != parts[0]._form():
                raise EstimatorError(f"part {number} has other columns than the first: {part!r}, {parts[0]!r}")
        arrays: dict[str, Any] = {
            name: np.concatenate([getattr(p, name) for p in parts]) for name in parts[0]._form()[1]
        }
        return replace(parts[0], **arrays)

    def columns(self) -> dict[str, npt.NDArray[Any]]:
        """Columns by name in the order of files, each a view of shape (T,), without a copy."""
        out: dict[str, npt.NDArray[Any]] = {}
        for group, columns in _groups(self.names, self.wrenches).items():
            array = getattr(self, group)
            if array is not None and group not in self.left_out:
                out |= zip(columns, np.atleast_2d(array.T), strict=True)
        return out

    def to_arrow(self) -> pa.Table:
        """Convert to an Arrow table."""
        return pa.table({name: pa.array(column) for name, column in self.columns().items()})

    def to_pandas(self) -> pandas.DataFrame:
        """Convert to a pandas data frame; needs pandas."""
        import pandas

        return pandas.DataFrame(self.columns())

    def to_polars(self) -> polars.DataFrame:
        """Convert to a Polars data frame; needs Polars."""
        import polars

        return polars.DataFrame(self.columns())

    def write(self, path: str | Path) -> None:
        """Write a Parquet or CSV file (by suffix), whole or not at all; `OutputError` when that cannot be."""
        with EstimateWriter(path) as writer:
            writer.write(self)

    def require(self, *fields: str) -> tuple[FloatArray, ...]:
        """Return fields that not every estimate has: ``tool, std = estimate.require("tool_position", "tool_std")``.

        Raises
        ------
        EstimatorError
            Naming the first that is missing.
        """
        for name in fields:
            if not isinstance(getattr(self, name, None), np.ndarray):
                raise EstimatorError(f"the estimate has no {name}, only {', '.join(self._form()[1])}")
        return tuple(getattr(self, name) for name in fields)

    def status_summary(self) -> dict[str, int]:
        """Count rows by status, in words: ``{"good": 1990, "damped": 0, "bridged": 10, "unseen": 0}``."""
        flags = {name.lower(): flag for name, flag in Status.__members__.items() if flag}
        good = {"good": int(np.count_nonzero(self.status == Status.GOOD))}
        return good | {word: int(np.count_nonzero(self.status & flag)) for word, flag in flags.items()}

    def error_against(self, truth: Estimate | str | Path) -> EstimateError:
        """Compare with the truth, or a better estimate, of the same motion.

        Parameters
        ----------
        truth
            An estimate with a row at the time of every row of this one, to within 1 % of a period; it may have more
            rows. Rows that are NaN are not compared.

        Raises
        ------
        EstimatorError
            When a time has no counterpart, or nothing in common can be compared.
        """
        source = "the truth" if isinstance(truth, Estimate) else str(truth)
        truth = truth if isinstance(truth, Estimate) else Estimate.read(truth)
        rows = counterparts(self.t, truth.t, source)
        ours, theirs = self.columns(), truth.columns()
        signals = [f"{s}_{joint}" for s in ("q", "dq", "ddq", "theta", "dtheta") for joint in self.names]
        errors = {s: ours[s] - theirs[s][rows] for s in signals if s in ours and s in theirs}
        known = {s: e[~np.isnan(theirs[s][rows])] for s, e in errors.items()}
        tool = None
        if self.tool_position is not None and truth.tool_position is not None:
            tool = self.tool_position - truth.tool_position[rows]
            tool = tool[~np.isnan(truth.tool_position[rows]).any(axis=1)]
        return EstimateError._of({s: e for s, e in known.items() if len(e)}, tool, source)

    def __len__(self) -> int:
        """Rows."""
        return len(self.t)

    def __getitem__(self, rows: slice) -> Estimate:
        """Some rows, without a copy: ``estimate[a:b]``."""
        if not isinstance(rows, slice):
            raise EstimatorError(f"an estimate is cut by rows, as in estimate[100:200], not by {rows!r}")
        return replace(self, **{name: getattr(self, name)[rows] for name in self._form()[1]})

    def __repr__(self) -> str:
        """Size, signals and status in one line."""
        groups = " ".join(name for name in self._form()[1] if name not in ("t", "status"))
        status = ", ".join(f"{count} {word}" for word, count in self.status_summary().items() if count)
        return f"Estimate({len(self)} rows, {len(self.names)} joints, {groups}; status: {status or 'none'})"

    def _form(self) -> tuple[tuple[str, ...], list[str]]:
        arrays = (f.name for f in fields(self) if f.name not in NAMES)
        there = [name for name in arrays if getattr(self, name) is not None]
        return self.names, there


def without_waits(log: Log, result: dict[str, Any]) -> dict[str, Any]:
    """What the core found in a recording, BRIDGED only where a reading was due."""
    status: Statuses = result["status"]
    return result | {"status": where_due(status, log.pace.waiting(log))} if (status & Status.BRIDGED).any() else result


def where_due(status: Statuses, waiting: npt.NDArray[np.bool_]) -> Statuses:
    """The core's status, not BRIDGED in rows that only wait for a slow sensor.

    The core sees that a reading is missing; how often its sensor is read is for the recording to say.
    """
    return np.where(waiting, status & np.uint8(0xFF & ~Status.BRIDGED), status)


def result_of(source: str, outcome: dict[str, Any] | Exception) -> dict[str, Any]:
    """Return the arrays of a log's result, or raise its error with the log's name."""
    if isinstance(outcome, Exception):
        raise type(outcome)(f"{source}: {outcome}")
    return outcome


@dataclass(frozen=True)
class EstimateError:
    """How far an estimate is from the truth.

    Attributes
    ----------
    rms, max : dict of str to float
        Root mean square and largest absolute error by column, such as ``q_a1``, in the column's unit.
    tool_rms_mm, tool_max_mm : float or None
        Distance of the tool from where it truly is [mm].
    tool_rms_centred_mm, tool_max_centred_mm : float or None
        The same after its constant offset is taken out [mm]. All four are also there without ``_mm``, as they were
        called before.
    """

    rms: dict[str, float]
    max: dict[str, float]
    tool_rms_mm: float | None = None
    tool_max_mm: float | None = None
    tool_rms_centred_mm: float | None = None
    tool_max_centred_mm: float | None = None

    tool_rms = property(lambda self: self.tool_rms_mm)
    tool_max = property(lambda self: self.tool_max_mm)
    tool_rms_centred = property(lambda self: self.tool_rms_centred_mm)
    tool_max_centred = property(lambda self: self.tool_max_centred_mm)

    def __repr__(self) -> str:
        """Say the tool's error, and each column's, with four digits."""
        tool = ", ".join(
            f"{name}={value:.4g}" for name, value in vars(self).items() if name.startswith("tool") and value is not None
        )
        columns = ", ".join(f"{name} {value:.4g}" for name, value in self.rms.items())
        return f"EstimateError({tool}{'; ' * bool(tool)}rms: {columns})"

    @classmethod
    def _of(cls, errors: dict[str, FloatArray], tool: FloatArray | None, source: str) -> EstimateError:
        has_tool = tool is not None and len(tool) > 0
        if not errors and not has_tool:
            raise EstimatorError(f"{source} has no sample to compare the estimate with")
        sizes = {signal: rms(error) for signal, error in errors.items()}
        largest = {signal: float(np.abs(error).max()) for signal, error in errors.items()}
        if tool is None or not has_tool:
            return cls(sizes, largest)
        distance = 1e3 * np.linalg.norm(tool, axis=1)
        centred = 1e3 * np.linalg.norm(tool - tool.mean(axis=0), axis=1)
        return cls(sizes, largest, rms(distance), float(distance.max()), rms(centred), float(centred.max()))


def _groups(names: tuple[str, ...], wrenches: tuple[str, ...] = ()) -> dict[str, list[str]]:
    """Columns of a file by field of `Estimate`, in order."""
    groups = {s: [f"{s}_{joint}" for joint in names] for s in ("q", "dq", "ddq", "theta", "dtheta", "q_std")}
    groups |= {"t": ["t"], "status": ["status"], "nis": ["nis"]}
    groups |= {"disturbance": [f"d_{joint}" for joint in names]}
    groups |= {"disturbance_std": [f"d_std_{joint}" for joint in names]}
    acting = [f"{wrench}_{axis}" for wrench in wrenches for axis in AXES]
    groups |= {"wrench": acting, "wrench_std": [f"{column}_std" for column in acting]}
    groups |= {
        "tool_position": [f"tool_{axis}" for axis in "xyz"],
        "tool_std": [f"tool_std_{axis}" for axis in "xyz"],
    }
    order = ("t", "q", "dq", "ddq", "theta", "dtheta", "tool_position", "q_std", "tool_std")
    return {group: groups[group] for group in (*order, *OUTSIDE, "nis", "status") if groups[group]}


def _present(file: Table) -> tuple[Joints, dict[str, list[str]]]:
    """Joints and wrenches of a file, and its columns by field of `Estimate`."""
    names, there = _joints(file.names, file.source), set(file.names)
    starts = (column.removesuffix("_fx") for column in file.names if column.endswith("_fx"))
    wrenches = tuple(start for start in starts if {f"{start}_{axis}" for axis in AXES} <= there)
    groups = _groups(names, wrenches)
    return (names, wrenches), {group: columns for group, columns in groups.items() if set(columns) <= there}


def _joints(columns: list[str], source: str) -> tuple[str, ...]:
    """Joints of ``q_<joint>``; a deviation ``q_std_<joint>`` goes with a ``q_<joint>`` of its own."""
    names = [column.removeprefix("q_") for column in columns if column.startswith("q_")]
    deviations = {f"std_{name}" for name in names}
    joints = tuple(dict.fromkeys(name for name in names if name not in deviations))
    if not joints:
        raise LogError(f"{source}: no column 'q_<joint>' is there, this is not an estimate")
    if "t" not in columns:
        raise LogError(f"{source}: column 't' is missing")
    for column in itertools.chain.from_iterable(_groups(joints).values()):
        if columns.count(column) > 1:
            raise LogError(f"{source}: column {column!r} is there {columns.count(column)} times")
    return joints


def _complete(arrays: dict[str, FloatArray], joints: int, source: str) -> dict[str, Any]:
    """Fields of an `Estimate` from the groups of columns that were there."""
    rows = len(arrays["t"])
    t = arrays["t"][:, 0]
    if not (np.isfinite(t).all() and (t[1:] > t[:-1]).all()):
        raise LogError(f"{source}: column 't' does not increase from row to row")
    status = arrays.pop("status", np.zeros((rows, 1)))
    if not np.isin(status, np.arange(256)).all():
        raise LogError(f"{source}: column 'status' has a value that is no status")
    missing = {name: np.full((rows, joints), np.nan) for name in ("dq", "theta", "dtheta") if name not in arrays}
    flat = {"t": t, "status": status.reshape(-1).astype(np.uint8)}
    if "nis" in arrays:
        flat["nis"] = arrays.pop("nis").reshape(-1)
    return arrays | missing | flat
