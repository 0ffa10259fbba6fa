"""Bags as tables of a log's columns: what to take from which messages, sorted by their stamps and merged."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa

from linkside.arrays import FloatArray
from linkside.errors import RecordingWarning
from linkside.files.bags import Bag, Series, Stamps, Wanted
from linkside.files.joining import Part, join
from linkside.files.tables import ArrowTable, failure
from linkside.robot.sources import JointsSource, SourcesConfig

from .layout import COMMANDS, RobotColumns, currents, signal_columns, time_unit

AXES = ("x", "y", "z")


@dataclass(frozen=True)
class _Taking:
    """What to take from a topic, and what its columns are called.

    ``absent`` says by column which path is −1 where the message does not measure it (definition of sensor_msgs/Imu).
    """

    wanted: Wanted
    columns: Callable[[list[str]], list[str]]
    absent: dict[str, str] = field(default_factory=dict)


def bag_table(
    bag: Bag, sources: SourcesConfig, columns: Collection[str] | None, commands: Collection[str]
) -> ArrowTable:
    """Make a table of a bag: time from its first stamp [s] and what ``sources`` say, NaN where nothing was read.

    Parameters
    ----------
    bag
        The bag.
    sources
        What to take.
    columns
        The columns that are wanted; all by default.
    commands
        Columns of commanded signals, which are interpolated linearly.

    Raises
    ------
    LogError
        A topic or a field that is not there, a source of which nothing is wanted, a column that two have, stamps
        that have nothing in common.
    """
    takings = list(_takings(bag, sources, columns))
    found = bag.read([taking.wanted for taking in takings])
    for note in bag.notes:
        _warn(note)
    stamped = [_in_order(bag, taking, series) for taking, series in zip(takings, found, strict=True)]
    origin = min(int(stamps[0]) for stamps, _ in stamped)
    parts = [
        Part(f"{bag.source}: {taking.wanted.topic}", (stamps - origin) / 1e9, channels)
        for taking, (stamps, channels) in zip(takings, stamped, strict=True)
    ]
    return ArrowTable(pa.table(join(parts, "t", commands)), bag.source, {"linkside.origin_ns": str(origin)})


def robot_table(bag: Bag, robot: RobotColumns) -> ArrowTable:
    """Make a table of a bag by a robot's ``sources``, of the columns that the robot has; time in the robot's unit.

    Raises
    ------
    LogError
        As `bag_table`; a robot without ``sources``.
    """
    sources = getattr(getattr(robot, "config", None), "sources", None)
    if sources is None or not sources.some:
        raise failure(bag.source, f"the robot does not say what to take from a bag: {suggestion(bag)}")
    columns = signal_columns(robot)
    wanted = {column for own in columns.values() for column in own} | {c for c, _ in currents(robot).values()}
    table = bag_table(bag, sources, wanted, {column for signal in COMMANDS for column in columns[signal]})
    return table.timed(columns["t"][0], time_unit(robot))


def suggestion(bag: Bag) -> str:
    """Say what robot.yaml might say, by the types of a bag's topics."""
    topics = [topic for topic in bag.topics() if topic.count]
    of = {
        kind: [topic.name for topic in topics if topic.message.endswith(f"/{kind}")] for kind in ("JointState", "Imu")
    }
    joints = of["JointState"][0] if of["JointState"] else "TOPIC"
    imu = f", imu: {{SENSOR: {of['Imu'][0]}}}" if of["Imu"] else ""
    there = ", ".join(f"{topic.name} ({topic.message})" for topic in topics) or "no topic"
    return f"add `sources: {{joints: {joints}{imu}}}` to robot.yaml; there is {there}"


def _takings(bag: Bag, sources: SourcesConfig, columns: Collection[str] | None) -> Iterator[_Taking]:
    """What is to be taken for each source."""
    for joints in sources.joints:
        yield _joints(bag, joints, columns)
    for name, topic in sources.imu.items():
        paths = {f"{name}_{a}": f"linear_acceleration.{a}" for a in AXES}
        paths |= {f"{name}_w{a}": f"angular_velocity.{a}" for a in AXES}
        absent = {column: f"{path.partition('.')[0]}_covariance[0]" for column, path in paths.items()}
        yield _numbers(bag, topic, paths, columns, absent)
    for name, topic in sources.wrench.items():
        paths = {f"{name}_f{a}": f"wrench.force.{a}" for a in AXES}
        paths |= {f"{name}_t{a}": f"wrench.torque.{a}" for a in AXES}
        yield _numbers(bag, topic, paths, columns, {})
    fields: dict[str, dict[str, str]] = {}
    for column, place in sources.fields.items():
        topic, _, path = place.rpartition(":")
        fields.setdefault(topic, {})[column] = path
    for topic, paths in fields.items():
        yield _numbers(bag, topic, paths, columns, {})


def _joints(bag: Bag, source: JointsSource, columns: Collection[str] | None) -> _Taking:
    """Arrays by the names of joints, those of which a column is wanted."""
    if columns is None:
        paths, only = source.paths, None
    else:
        mine = {
            signal: [c.removeprefix(f"{signal}_") for c in columns if c.startswith(f"{signal}_")]
            for signal in source.paths
        }
        paths = {signal: path for signal, path in source.paths.items() if mine[signal]}
        only = sorted({name for names in mine.values() for name in names})
        _refuse_useless(bag, source.topic, paths)
    wanted = Wanted(source.topic, list(paths.values()), source.names, only)
    return _Taking(wanted, lambda names: [f"{signal}_{name}" for signal in paths for name in names])


def _numbers(
    bag: Bag, topic: str, paths: dict[str, str], columns: Collection[str] | None, absent: dict[str, str]
) -> _Taking:
    """A number a column."""
    kept = {column: path for column, path in paths.items() if columns is None or column in columns}
    _refuse_useless(bag, topic, kept)
    absent = {column: absent[column] for column in kept if column in absent}
    return _Taking(Wanted(topic, [*kept.values(), *absent.values()]), lambda _: list(kept), absent)


def _refuse_useless(bag: Bag, topic: str, paths: dict[str, Any]) -> None:
    if not paths:
        raise failure(bag.source, f"nothing of topic {topic!r} is a column of the robot's: see `sources` of robot.yaml")


def _in_order(bag: Bag, taking: _Taking, series: Series) -> tuple[Stamps, dict[str, FloatArray]]:
    """Stamps (T,) that increase, and the columns that have readings; messages of the same stamp are one row."""
    source = f"{bag.source}: {taking.wanted.topic}"
    stamps = series.stamps
    if not len(stamps) or not stamps.any():
        why = "have no stamp" if not len(stamps) else "have stamps of zero"
        _warn(f"{source}: messages {why}: the times when they were recorded are taken")
        stamps = series.received
    channels = dict(zip(taking.columns(series.names), series.columns, strict=False))
    signs = dict(zip(taking.absent, series.columns[len(channels) :], strict=True))
    channels = {c: np.where(signs[c] == -1, np.nan, values) if c in signs else values for c, values in channels.items()}
    channels = {column: values for column, values in channels.items() if not np.isnan(values).all()}
    if not channels:
        names = f" of {', '.join(taking.wanted.only)}" if taking.wanted.only else ""
        raise failure(source, f"not a single reading{names} is in its messages")
    return _increasing(source, stamps, channels)


def _increasing(source: str, stamps: Stamps, channels: dict[str, FloatArray]) -> tuple[Stamps, dict[str, FloatArray]]:
    steps = np.diff(stamps)
    if (steps > 0).all():
        return stamps, channels
    order = np.argsort(stamps, kind="stable")
    ordered = stamps[order]
    first = np.flatnonzero(np.append(True, np.diff(ordered) > 0))
    joined = {column: _first_reading(values[order], first) for column, values in channels.items()}
    lost = sum(np.count_nonzero(~np.isnan(channels[c])) - np.count_nonzero(~np.isnan(joined[c])) for c in channels)
    if (steps < 0).any():
        _warn(f"{source}: {np.count_nonzero(steps < 0)} messages are older than the one before: sorted by their stamps")
    if lost:
        _warn(f"{source}: {lost} readings repeat a stamp: the first of each is taken")
    return ordered[first], joined


def _first_reading(values: FloatArray, first: Any) -> FloatArray:
    """The first reading of each group of rows, which begin at ``first``; NaN where it has none."""
    row = np.where(np.isnan(values), len(values), np.arange(len(values)))
    return np.append(values, np.nan)[np.minimum.reduceat(row, first)]


def _warn(text: str) -> None:
    warnings.warn(text, RecordingWarning, stacklevel=2)


def origin_of(table: ArrowTable) -> int:
    """When a table of a bag begins, since 1970 [ns]."""
    return int(table.metadata["linkside.origin_ns"])
