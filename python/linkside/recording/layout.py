"""Which columns of a recording hold which signal of a robot."""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.channels import CHANNELS, joint_columns
from linkside.errors import EstimatorError, LogError
from linkside.files.tables import failure

COMMANDS = ("qref", "dqref", "ddqref")
"""Signals that nobody measures: they are known at any time, on straight lines."""

UNMEASURED = ("tau", "ddq", *COMMANDS)
"""Signals with one column a joint, ``<signal>_<joint>``, beside the channels that filters correct with."""


OF_MOTORS = ("theta", "dtheta", "tau")
"""Those that a joint without motor has not."""


class ColumnNames(Protocol):
    """How a log's columns differ from ours: on the motor shaft, or by name."""

    @property
    def motor_side(self) -> bool:
        """Whether theta, dtheta and tau are those of the motor shaft, before the gear."""

    @property
    def names(self) -> Mapping[str, str]:
        """Our name of a column to the log's."""


class RobotColumns(Protocol):
    """What a log needs to know of a robot."""

    @property
    def names(self) -> tuple[str, ...]:
        """Joints in log order."""

    @property
    def elastic(self) -> npt.NDArray[np.bool_]:
        """Joints with a spring between motor and link, (n,)."""

    @property
    def passive(self) -> npt.NDArray[np.bool_]:
        """Joints without motor, and so without columns of one, (n,)."""

    @property
    def acceleration_channels(self) -> tuple[str, ...]:
        """Accelerometer columns, such as ``tool_acc_x``."""

    @property
    def acceleration_errors(self) -> tuple[FloatArray, FloatArray]:
        """Bias [m/s²] and scale of each accelerometer column."""

    @property
    def gyroscope_channels(self) -> tuple[str, ...]:
        """Gyroscope columns, such as ``gyro_wx``."""

    @property
    def gear_ratio(self) -> FloatArray:
        """Turns of the motor for one of the link, (n,)."""

    @property
    def columns(self) -> ColumnNames:
        """How the log's columns differ from ours."""


@dataclass(frozen=True)
class Layout:
    """Which columns of a log hold which signal of a robot."""

    wanted: dict[str, tuple[str, ...]]
    found: tuple[str, ...]
    elastic: tuple[bool, ...]
    passive: tuple[bool, ...]
    shaft_ratio: FloatArray | None
    acceleration_errors: tuple[FloatArray, FloatArray] | None

    @classmethod
    def of(cls, robot: RobotColumns, found: list[str], source: str) -> Layout:
        """Find a robot's signals among a log's columns; time and motor positions must be there."""
        wanted = signal_columns(robot)
        ratio = np.asarray(robot.gear_ratio, float) if robot.columns.motor_side else None
        bias, scale = robot.acceleration_errors
        errors = (bias, scale) if np.any(bias) or np.any(scale != 1) else None
        layout = cls(
            wanted, tuple(found), tuple(map(bool, robot.elastic)), tuple(map(bool, robot.passive)), ratio, errors
        )
        layout._check(source)
        return layout

    @property
    def present(self) -> list[str]:
        """The columns to read: wanted and found, each once."""
        wanted = (column for columns in self.wanted.values() for column in columns)
        return [column for column in dict.fromkeys(wanted) if column in self.found]

    def needed(self, signal: str, source: str, purpose: str) -> list[str]:
        """Columns without which a signal is of no use."""
        if signal not in self.wanted:
            raise EstimatorError(f"{signal!r} is no signal of a log; there are {', '.join(self.wanted)}")
        columns = self.wanted[signal]
        if signal in ("acceleration", "rate") and not columns:
            sensor = "accelerometer" if signal == "acceleration" else "gyroscope"
            raise failure(source, f"the robot has no {sensor} to read a column of (needed for {purpose})")
        kept = [True] * len(columns)
        if signal in ("tau", "ddq"):
            kept = list(self.elastic)
        if signal in OF_MOTORS:
            kept = [one and not passive for one, passive in zip(kept, self.passive, strict=True)]
        return [column for column, one in zip(columns, kept, strict=True) if one]

    def without_motor(self, arrays: dict[str, Any]) -> dict[str, Any]:
        """Signals with zeros for motors that are not there, where passive joints' springs are fixed."""
        for signal in _there(arrays, *OF_MOTORS) if any(self.passive) else ():
            arrays[signal][:, list(self.passive)] = 0.0
        return arrays

    def missing(self, column: str, source: str, why: str = "") -> LogError:
        """Say that a column is missing, and what it might be called instead."""
        close = difflib.get_close_matches(column, set(self.found) - set(self.present), n=1, cutoff=0.75)
        hint = f"; did you mean {close[0]!r}?" if close else "; if another file has it, see `linkside merge`"
        return failure(source, f"column {column!r} is missing{why}{hint}")

    def on_link_side(self, arrays: dict[str, Any]) -> dict[str, Any]:
        """Signals of a recording without the gear and the sensors' errors."""
        changes: dict[str, Any] = {}
        if self.shaft_ratio is not None:
            changes = {signal: arrays[signal] / self.shaft_ratio for signal in _there(arrays, "theta", "dtheta")}
            changes |= {signal: arrays[signal] * self.shaft_ratio for signal in _there(arrays, "tau")}
        if self.acceleration_errors is not None:
            bias, scale = self.acceleration_errors
            changes |= {signal: (arrays[signal] - bias) / scale for signal in _there(arrays, "acceleration")}
        return arrays | changes

    def as_recorded(self, arrays: dict[str, Any]) -> dict[str, Any]:
        """The inverse of `on_link_side`, to rounding."""
        changes: dict[str, Any] = {}
        if self.shaft_ratio is not None:
            changes = {signal: arrays[signal] * self.shaft_ratio for signal in _there(arrays, "theta", "dtheta")}
            changes |= {signal: arrays[signal] / self.shaft_ratio for signal in _there(arrays, "tau")}
        if self.acceleration_errors is not None:
            bias, scale = self.acceleration_errors
            changes |= {signal: arrays[signal] * scale + bias for signal in _there(arrays, "acceleration")}
        return arrays | changes

    def _check(self, source: str) -> None:
        for column in [*self.wanted["t"], *self.needed("theta", source, "all")]:
            if column not in self.found:
                raise self.missing(column, source)
        for column in self.present:
            if self.found.count(column) > 1:
                raise failure(source, f"column {column!r} is there {self.found.count(column)} times")


def signal_columns(robot: RobotColumns) -> dict[str, tuple[str, ...]]:
    """The columns of each signal of a robot, as its recordings call them."""
    measured = {channel.signal: channel.columns(robot) for channel in CHANNELS.values()}
    others = {signal: joint_columns(signal, robot.names) for signal in UNMEASURED}
    inertial = {signal: measured.pop(signal) for signal in ("acceleration", "rate")}
    ours = {"t": ("t",)} | measured | others | inertial
    renamed = robot.columns.names
    return {signal: tuple(renamed.get(c, c) for c in columns) for signal, columns in ours.items()}


def _there(arrays: dict[str, Any], *signals: str) -> list[str]:
    return [signal for signal in signals if arrays[signal] is not None]
