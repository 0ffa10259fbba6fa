"""What a robot.yaml may declare that not every method accounts for; a method refuses it by name."""

from __future__ import annotations

from collections.abc import Callable

from linkside.errors import EstimatorError

from .robot import Robot

FEATURES: dict[str, Callable[[Robot], list[str]]] = {
    "coupling": lambda robot: [row for row, entries in robot.config.coupling.items() if any(entries.values())],
    "rotors": lambda robot: list(robot.config.rotors),
    "stiffness_table": lambda robot: [drive.name for drive in robot.drives if drive.stiffness_table],
    "backlash": lambda robot: [drive.name for drive in robot.drives if drive.backlash.half_gap],
    "corner_frequency": lambda robot: [sensor.name for sensor in robot.accelerometers if sensor.corner_frequency],
    "delay": lambda robot: [sensor.name for sensor in robot.accelerometers if sensor.delay],
}
"""By key of robot.yaml: the joints or sensors that have it."""

UNSUPPORTED: dict[str, tuple[str, ...]] = {
    "the acceleration-driven observer": ("rotors", "backlash", "corner_frequency", "delay"),
    "the acceleration-driven observer on joint accelerations": ("rotors", "backlash"),
    "a filter on the acceleration-driven model": ("coupling", "rotors"),
    "a velocity observer": ("rotors",),
    "the momentum residual": ("rotors",),
    "inverse dynamics along a motion": ("rotors",),
    "state feedback": ("rotors",),
    "calibration": ("rotors", "stiffness_table", "backlash"),
}
"""By method: what it does not account for. Simulator, elastic-joint filters and smoothers account for all of it."""


def refuse_unsupported(robot: Robot, method: str) -> None:
    """Raise `EstimatorError` about the first thing that a robot declares and a method does not account for."""
    for key in UNSUPPORTED[method]:
        if owners := FEATURES[key](robot):
            raise EstimatorError(
                f"robot.yaml gives {', '.join(map(repr, owners))} {key}, which {method} does not account for; "
                "use another method, or take it out"
            )
