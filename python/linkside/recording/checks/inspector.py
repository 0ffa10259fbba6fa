"""The table of checks, and the inspector that runs them over a recording or its pieces."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import TypeGuard

from linkside.arrays import FloatArray
from linkside.errors import LogError, RecordingWarning
from linkside.robot import Robot

from . import channels, clock, gravity, positions, units
from .finding import Finding
from .view import Kind, Recording, View

Check = Callable[[View], Iterator[Finding]]

CHECKS: dict[str, Check] = {
    "resolution of time": clock.resolution,
    "rate of time": clock.rate,
    "evenness of time": clock.evenness,
    "sentinels": channels.sentinels,
    "units of positions": units.positions,
    "jumps of positions": positions.impossible,
    "joint limits": positions.limits,
    "velocities": units.velocities,
    "accelerometers": gravity.accelerometers,
    "motor torques": gravity.torques,
    "channels that stay": channels.stays,
}
"""The checks in their order; the first that refuses the recording ends the inspection."""

BEFORE = 3
"""Rows of the piece before that a check may look at."""


class Inspector:
    """Checks of one recording, whole or piece by piece.

    Parameters
    ----------
    robot
        The robot.
    source
        The recording, for messages.
    collect
        Keep what is refused among the findings instead of raising it, and warn of nothing.

    Attributes
    ----------
    findings : list of Finding
        So far; one for each check and column.
    """

    def __init__(self, robot: Robot, source: str, *, collect: bool = False) -> None:
        self.findings: list[Finding] = []
        self._robot, self._source, self._collect = robot, source, collect
        self._before: Recording | None = None
        self._first = 0
        self._offset: dict[tuple[str, int], float] = {}

    def seconds(self, period: float, column: str) -> float:
        """How many seconds a unit of time is, by a period in that unit."""
        found = clock.unit(period, self._robot.config.rate_hz, column)
        if found is None or found.size is None:
            return 1.0
        self._add(found)
        return found.size

    def __call__(self, log: Kind) -> Kind:
        """Check a piece; gives it with positions unwrapped, and what was found.

        Raises
        ------
        LogError
            What is found is impossible.
        """
        # The turns that were counted in the pieces before.
        log = _shifted(log, ((signal, joint, offset) for (signal, joint), offset in self._offset.items() if offset))
        view = View(log, self._robot, self._first, self._before)
        refused = max([self._add(found) for found in channels.sentinels(view)], default=False)
        if not refused:
            log = self._unwrapped(log, view)
            view = replace(view, log=log)
        for name, check in CHECKS.items():
            if name != "sentinels" and not refused:
                refused = max([self._add(found) for found in check(view)], default=False)
        self._before, self._first = log[-BEFORE:], self._first + len(log)
        return replace(log, findings=tuple(self.findings))  # type: ignore[type-var]

    def _add(self, found: Finding) -> bool:
        """Keep a finding, the first of its kind and column; whether it refuses the recording."""
        if found.verdict == "refused" and not self._collect:
            raise LogError(f"{self._source}: {found}")
        if not any((known.kind, known.column) == (found.kind, found.column) for known in self.findings):
            self.findings.append(found)
            if not self._collect:
                warnings.warn(f"{self._source}: {found}", RecordingWarning, stacklevel=4)
        return found.verdict == "refused"

    def _unwrapped(self, log: Kind, view: View) -> Kind:
        wraps = list(positions.wraps(view))
        for found, signal, joint, offset in wraps:
            self._add(found)
            self._offset[signal, joint] = self._offset.get((signal, joint), 0.0) + float(offset[-1])
        return _shifted(log, ((signal, joint, offset) for _, signal, joint, offset in wraps))


def _shifted(log: Kind, offsets: Iterable[tuple[str, int, FloatArray | float]]) -> Kind:
    """Positions with offsets, each of a signal and a joint, and one number or (T,)."""
    arrays: dict[str, FloatArray] = {}
    for signal, joint, offset in offsets:
        arrays.setdefault(signal, getattr(log, signal).copy())[:, joint] += offset
    for array in arrays.values():
        array.flags.writeable = False
    return replace(log, **arrays) if arrays else log  # type: ignore[type-var]


def inspect(log: Recording, robot: Robot) -> tuple[Finding, ...]:
    """Return all findings about a recording, including those that `Log.read` refuses; raise and warn of nothing."""
    return tuple(found for _, results in _results(log, robot) for found in results)


def verdicts(log: Kind, robot: Robot) -> tuple[list[tuple[str, str]], Finding | None]:
    """Each check with its verdict in words, and the first finding that refuses the recording."""
    rows = [("units of robot.yaml", f"converted: {words}") for words in log.conversions]
    refused: Finding | None = None
    for name, results in _results(log, robot):
        rows += [(name, f"{found.verdict}: {found}") for found in results] or [(name, "good")]
        refused = refused or next((found for found in results if found.verdict == "refused"), None)
    return rows, refused


def _results(log: Kind, robot: Robot) -> Iterator[tuple[str, list[Finding]]]:
    """Findings of each check, of all of them whatever those before said."""
    (column,) = log.columns("t")
    known = [found for found in log.findings if found.verdict == "mended"]
    unit = clock.unit(log.period, robot.config.rate_hz, column)
    if unit is not None and unit.size is not None:
        known.append(unit)
        log = replace(log, t=unit.size * log.t, period=unit.size * log.period)  # type: ignore[type-var]
    view = View(log, robot)
    sound = not list(channels.sentinels(view))
    wraps = list(positions.wraps(view)) if sound else []
    known += [found for found, *_ in wraps]
    yield "unit of time, wraps", known
    view = replace(view, log=_shifted(log, ((signal, joint, offset) for _, signal, joint, offset in wraps)))
    for name, check in CHECKS.items():
        yield name, list(check(view)) if sound or name == "sentinels" else []


def able(robot: object) -> TypeGuard[Robot]:
    """Whether a robot has what the checks need: kinematics, not only names of columns."""
    return hasattr(robot, "specific_force") and hasattr(robot, "config")
