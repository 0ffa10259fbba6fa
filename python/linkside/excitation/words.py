"""Standard errors to expect, as a table."""

from __future__ import annotations

from linkside.text import Titled

from .expected import ExpectedErrors


def errors_table(before: ExpectedErrors | None, after: ExpectedErrors) -> Titled:
    """Give each parameter's standard error before and after, and why one is not identifiable.

    Without ``before``, standard errors before are the tolerances of robot.yaml.
    """
    count, every = len(after.identifiable), len(after.parameters)
    table = Titled(
        f"Standard errors to expect of a calibration: {count} of {every} parameters are identifiable",
        ("parameter", "robot.yaml", "before", "after", "unit", "in words"),
    )
    for index, p in enumerate(after.parameters):
        slope = abs(p.slope(0.0))
        first = slope * (1.0 if before is None else float(before.std[index]))
        reason = after.reasons.get(p.name)
        words = "" if reason is None else f"not identifiable: {reason}"
        table.add_row(p.name, f"{p.start:.4g}", f"{first:.2g}", f"{slope * after.std[index]:.2g}", p.unit, words)
    return table
