"""A report of a planned motion."""

from __future__ import annotations

from collections.abc import Sequence

from linkside.report import Input, Page, Verdict

from .excitation import Excitation


def page(planned: Excitation, inputs: Sequence[Input] = ()) -> Page:
    """Lay out the report; ``inputs`` are the files it was made from."""
    motion, errors = planned.tables()
    return Page(
        f"A motion to calibrate {planned.robot.model.name} by",
        _verdict(planned),
        [
            ("duration", f"{planned.motion.t[-1]:g} s at {1 / planned.motion.period:g} Hz"),
            ("identifiable without it", str(len(planned.before.identifiable))),
            ("identifiable with it", f"{len(planned.after.identifiable)} of {len(planned.after.parameters)}"),
        ],
        [
            "Look at the motion before the robot moves: it keeps the limits of joints, but knows of no obstacle.",
            "Record it, and calibrate: linkside calibrate robot.yaml log.parquet --out robot.calibrated.yaml",
        ],
        [
            ("Motion", [motion, ("Positions of the motors, and standard errors to expect", planned.figure())]),
            ("Parameters", [errors]),
        ],
        inputs,
    )


def _verdict(planned: Excitation) -> Verdict:
    """Whether every spring is identifiable."""
    springs = [p.name for p in planned.after.parameters if p.kind == "stiffness"]
    lost = tuple(f"{name}: {planned.after.reasons[name]}" for name in springs if name in planned.after.reasons)
    if lost:
        if len(lost) == len(springs):
            return Verdict("bad", "No spring is identifiable", lost)
        return Verdict("doubtful", "Not every spring is identifiable", lost)
    worst = max(
        (s for p, s in zip(planned.after.parameters, planned.after.std, strict=True) if p.name in springs), default=0
    )
    return Verdict(
        "good", f"Every spring is identifiable, with a standard error of at most {worst:.0%} of its tolerance"
    )
