"""Faults that an estimator found in a recording, and their likely causes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

CoreFinding = tuple[int | None, int, int, float, float, str]
"""A finding as the core has it: channel, first and last sample, size, deviations, kind."""

CAUSES = {
    "stuck": ("the sensor or its cable has failed", "the recorder repeated an old value"),
    "saturated": ("the sensor's range is too small for this motion",),
    "dead": ("the sensor is not connected",),
    "wrap": ("the encoder wrapped and its turns were not counted",),
    "flipped": ("the sign of this channel is turned in the log", "the sensor is mounted the other way round"),
    "step": (
        "the sensor was moved, or changed its zero or its scale",
        "something pushed the robot, or it took up a load",
        "robot.yaml is wrong about this sensor or its joint",
    ),
    "drift": (
        "the encoder slips or drifts: its position leaves the integral of the motor's measured velocity",
        "the velocity is wrong, in its scale or its zero",
    ),
    "correlated": (
        "a spring, a mass or a payload is not as robot.yaml says",
        "something drives the robot that robot.yaml lacks: friction, a cable, a contact",
        "a sensor drifts",
    ),
    "unknown": (
        "the robot is not as robot.yaml says, by more than its tolerances",
        "the noise of the readings is larger than robot.yaml says",
        "the robot touched something",
    ),
}
"""Likeliest causes of each kind, in order."""


@dataclass(frozen=True)
class Fault:
    """Readings that contradict the model.

    Attributes
    ----------
    channel : str or None
        The log's column that contradicts the model and all other columns; None where no single one does.
    since, until : int
        First and last sample that show it, counted from the recording's start.
    size : float
        How far off the readings were when it was found [the column's unit].
    deviations : float
        The same in standard deviations; repetitions of a value that is stuck.
    kind : str
        What the readings look like: one of `CAUSES`.
    left_out : bool
        Whether the estimate goes on without the channel, as ``exclude_faulty`` asks.
    """

    channel: str | None
    since: int
    until: int
    size: float
    deviations: float
    kind: str
    left_out: bool = False

    @property
    def causes(self) -> tuple[str, ...]:
        """Likeliest causes, in order."""
        return CAUSES[self.kind]

    def __str__(self) -> str:
        """Give one line: what, since when, by how much, and why."""
        where = f"rows {self.since} to {self.until}"
        causes = "; or ".join(self.causes)
        if self.channel is None:
            what = "stay on one side of their predictions" if self.kind == "correlated" else "contradict the model"
            return f"{where}: readings {what}. Likely: {causes}"
        by = (
            f"for {self.deviations:.0f} readings"
            if self.kind in ("stuck", "saturated", "dead")
            else (f"by {self.size:.3g} ({self.deviations:.3g} standard deviations)")
        )
        words = {"step": "contradicts the other channels", "drift": "contradicts its motor's velocity"}
        word = words.get(self.kind, f"looks {self.kind}")
        after = "; left out from there on" if self.left_out else ""
        return f"{where}: '{self.channel}' {word}, {by}{after}. Likely: {causes}"


def named(found: Iterable[CoreFinding], columns: tuple[str, ...]) -> tuple[Fault, ...]:
    """Findings of the core with the names of the columns."""
    return tuple(Fault(columns[one[0]] if columns and one[0] is not None else None, *one[1:]) for one in found)
