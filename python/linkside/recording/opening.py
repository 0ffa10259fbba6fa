"""Opening of recordings: files of columns, and bags by the `sources` of a robot."""

from __future__ import annotations

from pathlib import Path

from linkside.files.bags import PACKED, STORAGES, Bag, is_bag
from linkside.files.clocked import ClockedTable
from linkside.files.opening import FORMATS, open_table
from linkside.files.tables import Table

from .layout import COMMANDS, RobotColumns, signal_columns, time_unit
from .sources import robot_table


def open_recording(path: str | Path, robot: RobotColumns) -> Table:
    """Open a file by its suffix, or a bag by the robot's ``sources``; `LogError` when that cannot be."""
    if is_bag(path):
        return robot_table(Bag(path), robot)
    table = open_table(path)
    if not isinstance(table, ClockedTable):
        return table
    columns = signal_columns(robot)
    return table.for_log(columns["t"][0], time_unit(robot), {c for signal in COMMANDS for c in columns[signal]})


def log_rows(path: str | Path) -> int | None:
    """Rows of a recording where the file says so (Parquet), None where only reading it would tell."""
    return None if is_bag(path) else open_table(path).count


def stem(path: str | Path) -> str:
    """Name of a recording without folder and suffix; of one with another suffix, the whole name."""
    name = Path(path).name
    suffixes = [*FORMATS, *STORAGES, *(storage + PACKED for storage in STORAGES)]
    suffix = max((own for own in suffixes if name.lower().endswith(own)), key=len, default="")
    return name.removesuffix(name[len(name) - len(suffix) :])
