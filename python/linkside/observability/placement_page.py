"""A report of a choice of accelerometers."""

from __future__ import annotations

from collections.abc import Sequence

from linkside.report import Input, Page, Verdict
from linkside.text import Titled

from .placement import Placement


def page(placement: Placement, inputs: Sequence[Input] = ()) -> Page:
    """Lay out the report; ``inputs`` are the files it was made from."""
    sensors = Titled("", ("accelerometer", "link", "axes", "xyz [m]", "rpy [rad]"))
    for s in placement.chosen:
        sensors.add_row(s.name, s.link, s.axes, *(" ".join(f"{x:.4g}" for x in v) for v in (s.xyz, s.rpy)))
    return Page(
        f"Accelerometers for {placement.robot.model.name}",
        _verdict(placement),
        [("chosen", str(len(placement.chosen))), ("candidates", str(len(placement.links)))],
        ["Mount them as listed, then check the robot: linkside check robot.yaml"],
        [
            ("The set", [sensors, *(f"Singular for {posture.words}." for posture in placement.report.singular)]),
            ("Where it is singular, and each candidate alone", [("Singular postures, and scores", placement.figure())]),
        ],
        inputs,
    )


def _verdict(placement: Placement) -> Verdict:
    """Whether the set is better than the robot's own."""
    words = placement.to_text().partition("\n")[0]
    if placement.score < placement.before:
        return Verdict("good", "The set sees links better than the robot's own sensors", (words,))
    return Verdict("doubtful", "The robot's own sensors see links as well", (words,))
