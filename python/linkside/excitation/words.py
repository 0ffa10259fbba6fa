"""What a motion tells, in words."""

from __future__ import annotations

from linkside.text import Titled

from .foresight import Foreseen


def foreseen_table(before: Foreseen | None, after: Foreseen) -> Titled:
    """Give each parameter's standard error before and after, and why one cannot be told.

    Without ``before``, standard errors before are the tolerances of robot.yaml.
    """
    count, every = len(after.told), len(after.parameters)
    table = Titled(
        f"Standard errors to expect of a calibration: {count} of {every} parameters can be told",
        ("parameter", "robot.yaml", "before", "after", "unit", "in words"),
    )
    for index, p in enumerate(after.parameters):
        slope = abs(p.slope(0.0))
        first = slope * (1.0 if before is None else float(before.std[index]))
        reason = after.reasons.get(p.name)
        words = "" if reason is None else f"cannot be told: {reason}"
        table.add_row(p.name, f"{p.start:.4g}", f"{first:.2g}", f"{slope * after.std[index]:.2g}", p.unit, words)
    return table
