"""Motions from files: estimates, truths, and what a log was commanded to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import LogError
from linkside.files.opening import open_table
from linkside.files.tables import numbers
from linkside.recording import Estimate
from linkside.robot import Robot


def read_motion(path: str | Path, robot: Robot | None = None) -> Estimate:
    """Read a file with ``q_<joint>``, or a log's command, ``qref_<joint>``, as a motion.

    Parameters
    ----------
    path
        Parquet or CSV.
    robot
        Gives the path of the tool where the file has none.

    Raises
    ------
    LogError
        The file cannot be read, or has neither.
    """
    names = open_table(path).names
    motion = Estimate.read(path) if any(name.startswith("q_") for name in names) else _commanded(path, robot)
    if robot is None or motion.tool_position is not None or robot.tool is None:
        return motion
    missing = sorted(set(robot.names) - set(motion.names))
    if missing:
        raise LogError(f"{path}: column 'q_{missing[0]}' is missing, without which the tool's path is not known")
    columns = [motion.names.index(name) for name in robot.names]
    return replace(motion, tool_position=robot.tool_position(motion.q[:, columns]))


def _commanded(path: str | Path, robot: Robot | None) -> Estimate:
    """The command in a log, by the names and units of columns that a robot's logs have."""
    file = open_table(path)
    theirs = {} if robot is None else robot.columns.names
    ours = {theirs: ours for ours, theirs in theirs.items()}
    names = {ours.get(name, name): name for name in file.names}
    joints = tuple(name.removeprefix("qref_") for name in names if name.startswith("qref_"))
    if not joints or "t" not in names:
        raise LogError(f"{path}: a motion is expected, columns 't' and 'q_<joint>' or 'qref_<joint>'")
    columns = {kind: [f"{kind}_{joint}" for joint in joints] for kind in ("qref", "dqref", "ddqref")}
    there = {kind: own for kind, own in columns.items() if set(own) <= set(names)}
    table = file.read([names[name] for name in ("t", *(column for own in there.values() for column in own))])

    def values(column: str) -> FloatArray:
        unit = None if robot is None else robot.column_units.get(column)
        recorded = numbers(table, names[column], file.source)
        return recorded if unit is None else unit.size * recorded

    t = values("t")
    if not (np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise LogError(f"{path}: column {names['t']!r} does not increase from row to row")
    unknown = np.full((len(t), len(joints)), np.nan)
    motion = {kind: np.stack([values(column) for column in own], axis=1) for kind, own in there.items()}
    return Estimate(
        t=t,
        q=motion["qref"],
        dq=motion.get("dqref", unknown),
        theta=unknown,
        dtheta=unknown,
        status=np.zeros(len(t), np.uint8),
        names=joints,
        ddq=motion.get("ddqref"),
    )
