"""A report of how far motions are apart."""

from __future__ import annotations

from collections.abc import Sequence

from linkside.report import Input, Page, Verdict
from linkside.report.page import Part, paragraphs

from .compare import Comparison
from .output import SCALES, tables


def page(comparison: Comparison, inputs: Sequence[Input]) -> Page:
    """Lay out the report."""
    shown = [m for m in comparison.measures if m.segment == "all" and (m.signal == "tool" or m.signal.startswith("q_"))]
    tool = [m for m in shown if m.signal == "tool"]
    worst = {m.estimate: m for m in sorted(tool or shown, key=lambda m: m.rms)}
    order = sorted(worst.values(), key=lambda m: m.rms)
    lines = []
    for m in order:
        scale, unit = SCALES.get(m.unit, (1.0, m.unit))
        what = "tool" if tool else m.signal
        lines.append(
            f"{m.estimate}: {what} {scale * m.rms:.4g} {unit} RMS, at most {scale * m.max:.4g} {unit}; "
            f"{scale * m.rms_centred:.4g} {unit} RMS without its constant part"
        )
    nearest = (
        f"{order[0].estimate} is nearest to {comparison.reference}"
        if len(order) > 1
        else (f"{order[0].estimate} beside {comparison.reference}" if order else "Nothing in common")
    )
    parts: list[Part] = paragraphs(tables(comparison))
    figure: list[Part] = [(f"Difference from {comparison.reference}", comparison.figure())]
    return Page(
        f"Comparison with {comparison.reference}",
        Verdict("open", nearest, tuple(lines)),
        sections=[("Over time", figure), ("Tables", parts)],
        inputs=inputs,
    )
