"""Motions from files: estimates, truths, and what a log was commanded to do."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

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
    motion = Estimate.read(path) if any(name.startswith("q_") for name in names) else _commanded(path)
    if robot is None or motion.tool_position is not None or robot.tool is None:
        return motion
    missing = sorted(set(robot.names) - set(motion.names))
    if missing:
        raise LogError(f"{path}: column 'q_{missing[0]}' is missing, without which the tool's path is not known")
    columns = [motion.names.index(name) for name in robot.names]
    return replace(motion, tool_position=robot.tool_position(motion.q[:, columns]))


def _commanded(path: str | Path) -> Estimate:
    file = open_table(path)
    joints = tuple(name.removeprefix("qref_") for name in file.names if name.startswith("qref_"))
    if not joints or "t" not in file.names:
        raise LogError(f"{path}: a motion is expected, columns 't' and 'q_<joint>' or 'qref_<joint>'")
    columns = {kind: [f"{kind}_{joint}" for joint in joints] for kind in ("qref", "dqref", "ddqref")}
    there = {kind: names for kind, names in columns.items() if set(names) <= set(file.names)}
    table = file.read(["t", *(name for names in there.values() for name in names)])
    t = numbers(table, "t", file.source)
    if not (np.isfinite(t).all() and (np.diff(t) > 0).all()):
        raise LogError(f"{path}: column 't' does not increase from row to row")
    unknown = np.full((len(t), len(joints)), np.nan)
    values = {k: np.stack([numbers(table, n, file.source) for n in names], axis=1) for k, names in there.items()}
    return Estimate(
        t=t,
        q=values["qref"],
        dq=values.get("dqref", unknown),
        theta=unknown,
        dtheta=unknown,
        status=np.zeros(len(t), np.uint8),
        names=joints,
        ddq=values.get("ddqref"),
    )
