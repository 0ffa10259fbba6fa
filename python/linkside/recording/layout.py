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
from linkside.robot.encoders import EncoderReading
from linkside.robot.units import Unit

from .motors import encoder_angles, encoder_readings, of_joints, of_motors

COMMANDS = ("qref", "dqref", "ddqref")
"""Commanded signals, which are interpolated linearly."""

UNMEASURED = ("tau", "ddq", *COMMANDS)
"""Signals with one column a joint, ``<signal>_<joint>``, beside the channels that filters correct with."""


OF_MOTORS = ("theta", "dtheta", "tau")
"""Those that a joint without motor has not."""


class ColumnNames(Protocol):
    """How a log's columns differ from linkside's: by the side of the gear, or by name."""

    @property
    def motor_side(self) -> bool:
        """Whether theta, dtheta and tau are those of the motor shaft, before the gear."""

    @property
    def names(self) -> Mapping[str, str]:
        """Our name of a column to the log's."""


class RobotColumns(Protocol):
    """The properties of a robot that reading a log requires."""

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
    def position_channels(self) -> tuple[str, ...]:
        """Columns of trackers, such as ``laser_px``."""

    @property
    def wrench_channels(self) -> tuple[str, ...]:
        """Columns of force sensors, such as ``press_fx``."""

    @property
    def gear_ratio(self) -> FloatArray:
        """Turns of the motor for one of the link, (n,)."""

    @property
    def columns(self) -> ColumnNames:
        """How the log's columns differ from ours."""

    @property
    def column_units(self) -> Mapping[str, Unit]:
        """Units of columns that are not in SI units, by our names."""

    @property
    def gearing(self) -> FloatArray:
        """How far each motor turns each joint, (n, n)."""

    @property
    def encoder_readings(self) -> Mapping[str, Mapping[int, EncoderReading]]:
        """By signal, theta or q, and by joint: how encoders read that read wrong."""

    @property
    def torque_constant(self) -> tuple[float | None, ...]:
        """Torque of a motor's current, where it is known [N m/A]."""


@dataclass(frozen=True)
class Layout:
    """Which columns of a log hold which signal of a robot, and in which unit.

    Attributes
    ----------
    wanted : dict of str to tuple of str
        The columns of each signal, as the log calls them; a motor's current where its torque is not recorded.
    found : tuple of str
        All columns of the log.
    sizes : dict of str to (k,)
        How large a unit of each column of a signal is, of signals that are not in SI units throughout.
    conversions : tuple of str
        The same in words.
    """

    wanted: dict[str, tuple[str, ...]]
    found: tuple[str, ...]
    elastic: tuple[bool, ...]
    passive: tuple[bool, ...]
    shaft_ratio: FloatArray | None
    acceleration_errors: tuple[FloatArray, FloatArray] | None
    encoders: Mapping[str, Mapping[int, EncoderReading]]
    gearing: FloatArray | None
    sizes: dict[str, FloatArray]
    conversions: tuple[str, ...]

    @classmethod
    def of(cls, robot: RobotColumns, found: list[str], source: str) -> Layout:
        """Find a robot's signals among a log's columns; time and motor positions must be there."""
        wanted, sizes, conversions = _by_unit(robot, found)
        ratio = np.asarray(robot.gear_ratio, float) if robot.columns.motor_side else None
        bias, scale = robot.acceleration_errors
        errors = (bias, scale) if np.any(bias) or np.any(scale != 1) else None
        elastic, passive = (tuple(map(bool, joints)) for joints in (robot.elastic, robot.passive))
        gearing = None if np.array_equal(robot.gearing, np.eye(len(elastic))) else robot.gearing
        encoders = robot.encoder_readings
        layout = cls(wanted, tuple(found), elastic, passive, ratio, errors, encoders, gearing, sizes, conversions)
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
        sensors = {
            "acceleration": "accelerometer",
            "rate": "gyroscope",
            "wrench": "force sensor",
            "position": "tracker",
        }
        if signal in sensors and not columns:
            sensor = sensors[signal]
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
        """Describe a missing column, with a similar name if there is one."""
        close = difflib.get_close_matches(column, set(self.found) - set(self.present), n=1, cutoff=0.75)
        hint = f"; did you mean {close[0]!r}?" if close else "; if another file has it, see `linkside merge`"
        if column.startswith("tau_") and (current := f"current_{column[4:]}") in self.found:
            hint = f"; {current!r} is in its place if robot.yaml gives the joint a torque_constant [N m/A]"
        return failure(source, f"column {column!r} is missing{why}{hint}")

    def on_link_side(self, arrays: dict[str, Any]) -> dict[str, Any]:
        """Signals of a recording in SI units, without the gear and the sensors' errors."""
        arrays = arrays | {signal: arrays[signal] * self.sizes[signal] for signal in _there(arrays, *self.sizes)}
        changes: dict[str, Any] = {}
        if self.shaft_ratio is not None:
            changes = {signal: arrays[signal] / self.shaft_ratio for signal in _there(arrays, "theta", "dtheta")}
            changes |= {signal: arrays[signal] * self.shaft_ratio for signal in _there(arrays, "tau")}
        if self.acceleration_errors is not None:
            bias, scale = self.acceleration_errors
            changes |= {signal: (arrays[signal] - bias) / scale for signal in _there(arrays, "acceleration")}
        arrays = arrays | changes
        arrays = arrays | encoder_angles(arrays, self.encoders)
        return arrays if self.gearing is None else arrays | of_joints(arrays, self.gearing)

    def as_recorded(self, arrays: dict[str, Any]) -> dict[str, Any]:
        """The inverse of `on_link_side`, to rounding."""
        arrays = arrays if self.gearing is None else arrays | of_motors(arrays, self.gearing)
        arrays = arrays | encoder_readings(arrays, self.encoders)
        changes: dict[str, Any] = {}
        if self.shaft_ratio is not None:
            changes = {signal: arrays[signal] * self.shaft_ratio for signal in _there(arrays, "theta", "dtheta")}
            changes |= {signal: arrays[signal] / self.shaft_ratio for signal in _there(arrays, "tau")}
        if self.acceleration_errors is not None:
            bias, scale = self.acceleration_errors
            changes |= {signal: arrays[signal] * scale + bias for signal in _there(arrays, "acceleration")}
        arrays = arrays | changes
        return arrays | {signal: arrays[signal] / self.sizes[signal] for signal in _there(arrays, *self.sizes)}

    @property
    def seconds(self) -> float:
        """How many seconds a unit of time is, as robot.yaml has it."""
        return float(self.sizes["t"][0]) if "t" in self.sizes else 1.0

    def recorded_size(self, signal: str) -> FloatArray:
        """What one of a column is in the signal, (k,): its unit, and the gear."""
        size = self.sizes.get(signal, np.ones(len(self.wanted[signal])))
        if self.shaft_ratio is None or signal not in ("theta", "dtheta", "tau"):
            return size
        return np.asarray(size * self.shaft_ratio if signal == "tau" else size / self.shaft_ratio)

    def _check(self, source: str) -> None:
        for column in [*self.wanted["t"], *self.needed("theta", source, "all")]:
            if column not in self.found:
                raise self.missing(column, source)
        for column in self.present:
            if self.found.count(column) > 1:
                raise failure(source, f"column {column!r} is there {self.found.count(column)} times")


def signal_columns(robot: RobotColumns) -> dict[str, tuple[str, ...]]:
    """The columns of each signal of a robot, as its recordings call them."""
    renamed = robot.columns.names
    return {signal: tuple(renamed.get(c, c) for c in columns) for signal, columns in _our_columns(robot).items()}


def as_columns(robot: RobotColumns, signals: Mapping[str, FloatArray], source: str) -> dict[str, FloatArray]:
    """Give time ``t`` (T,) and signals (T, k), in SI units and behind the gears, as the columns of a recording."""
    columns = signal_columns(robot)
    driven = {s: ~robot.passive if s in OF_MOTORS else np.ones(len(columns[s]), bool) for s in signals}
    there = [column for s, own in driven.items() for column, kept in zip(columns[s], own, strict=True) if kept]
    recorded = Layout.of(robot, there, source).as_recorded(dict(signals))
    return {
        column: np.ascontiguousarray(values)
        for signal, array in recorded.items()
        for column, values in zip(columns[signal], np.atleast_2d(array.T), strict=True)
        if column in there
    }


def currents(robot: RobotColumns) -> dict[str, tuple[str, float]]:
    """By the column of a motor's torque that of its current, as recordings call both, and the torque of an ampere."""
    renamed, tau = robot.columns.names, signal_columns(robot)["tau"]
    current = [renamed.get(column, column) for column in joint_columns("current", robot.names)]
    each = zip(tau, current, robot.torque_constant, strict=True)
    return {torque: (column, constant) for torque, column, constant in each if constant is not None}


def time_unit(robot: RobotColumns) -> float:
    """How many seconds a unit of time is in a robot's recordings."""
    unit = robot.column_units.get("t")
    return 1.0 if unit is None else unit.size


def _our_columns(robot: RobotColumns) -> dict[str, tuple[str, ...]]:
    measured = {channel.signal: channel.columns(robot) for channel in CHANNELS.values() if not channel.drives}
    others = {signal: joint_columns(signal, robot.names) for signal in UNMEASURED}
    inertial = {signal: measured.pop(signal) for signal in ("acceleration", "rate")}
    return {"t": ("t",)} | measured | others | inertial


def _by_unit(
    robot: RobotColumns, found: list[str]
) -> tuple[dict[str, tuple[str, ...]], dict[str, FloatArray], tuple[str, ...]]:
    """The columns of each signal, how large their units are, and both in words."""
    wanted, instead = signal_columns(robot), currents(robot)
    sizes: dict[str, FloatArray] = {}
    words: dict[str, list[str]] = {}
    for signal, ours in _our_columns(robot).items():
        theirs, size = list(wanted[signal]), np.ones(len(ours))
        for index, column in enumerate(ours):
            current, constant = instead.get(theirs[index], ("", 0.0)) if signal == "tau" else ("", 0.0)
            if theirs[index] not in found and current in found:
                theirs[index], size[index] = current, constant
                column = f"current_{column.removeprefix('tau_')}"
                words.setdefault(f"taken for motor torque, {constant:g} N m/A", []).append(current)
            if (unit := robot.column_units.get(column)) is not None:
                size[index] *= unit.size
                if theirs[index] in found:
                    words.setdefault(f"{unit.name} to {unit.si}, times {unit.size:.6g}", []).append(theirs[index])
        wanted[signal] = tuple(theirs)
        if (size != 1).any():
            sizes[signal] = size
    return wanted, sizes, tuple(f"{_list(columns)}: {how}" for how, columns in words.items())


def _list(columns: list[str]) -> str:
    return ", ".join(columns) if len(columns) <= 3 else f"{columns[0]} … {columns[-1]} ({len(columns)} columns)"


def _there(arrays: dict[str, Any], *signals: str) -> list[str]:
    return [signal for signal in signals if arrays.get(signal) is not None]
