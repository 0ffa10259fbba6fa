"""Results as text, JSON, CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, fields
from pathlib import Path

from rich.console import RenderableType

from linkside.files.writing import check_writable, write_text
from linkside.text import Titled, as_text

from .measures import MEAN, Measure
from .repeats import Repeats
from .result import ComparisonResult

SUFFIXES = (".json", ".csv", ".tex", ".txt")

HEADS = ("RMS", "largest", "median", "95 %", "RMS, offset out", "largest, offset out")
SHOWN = ("rms", "max", "p50", "p95", "rms_centred", "max_centred")

SCALES = {"m": (1e3, "mm"), "rad": (1e3, "mrad"), "rad/s": (1e3, "mrad/s"), "m/s": (1e3, "mm/s")}
"""Units of tables that people read."""

WIDTH = 160

FEW = 8
"""Of up to this many estimates, each has a table of its joints."""


def tables(comparison: ComparisonResult) -> Iterator[RenderableType]:
    """A table of the tool, then one of the joints for each estimate, then the spread of repeats.

    Of many estimates, tables of the joints are those of the worst estimate and of the mean.
    """
    tool = [m for m in comparison.measures if m.signal == "tool"]
    if tool:
        yield _table(f"tool, distance from {comparison.reference} [mm]", tool, lambda m: (m.estimate, m.segment))
    names = _shown(comparison)
    for name in names:
        joints = [m for m in comparison.measures if m.estimate == name and m.signal.startswith("q_")]
        if joints:
            unit = SCALES[joints[0].unit][1]
            yield _table(f"{name}, joints [{unit}]", joints, lambda m: (m.signal.removeprefix("q_"), m.segment))
    if left := len(comparison.differences) - len(names):
        yield f"The joints of {left} more estimates, none of them worse, are in files (.json, .csv)."
    for difference in comparison.differences:
        if difference.shift:
            yield f"{difference.name}: its clock is {1e3 * difference.shift:.4g} ms late, which is corrected."
    if comparison.repeats is not None:
        yield from _repeats(comparison.repeats, {m.signal: m.unit for m in comparison.measures})


def _repeats(repeats: Repeats, units: dict[str, str]) -> Iterator[RenderableType]:
    """The spread between repeats, the distance of each from the median path, and their trend."""
    spread = Titled("standard deviation between repeats, RMS over time", ("signal", "spread", "unit"))
    for signal, value in repeats.spread.items():
        scale, unit = SCALES.get(units[signal], (1.0, units[signal]))
        spread.add_row(signal, f"{scale * value:.4g}", unit)
    yield spread
    if not repeats.signals:
        return
    scale, unit = SCALES[units[repeats.signals[0]]]
    distances = Titled(f"distance of each repeat from the median path [{unit}]", ("repeat", "distance", ""))
    for name, distance in repeats.distances.items():
        distances.add_row(name, f"{scale * distance:.4g}", "outlier, left out" if name in repeats.outliers else "")
    yield distances
    if repeats.has_trend:
        sizes = ", ".join(f"{signal} {scale * size:.4g} {unit}" for signal, size in repeats.trend.items())
        yield f"The repeats drift, from one to the next by {sizes} (p = {repeats.p_value:.2g})."


def _shown(comparison: ComparisonResult) -> list[str]:
    """Estimates whose joints have a table."""
    names = [difference.name for difference in comparison.differences]
    if len(names) <= FEW:
        return names
    joints = [m for m in comparison.measures if m.signal.startswith("q_")]
    worst = max(joints, key=lambda m: m.rms).estimate if joints else names[0]
    return [name for name in names if name in (worst, MEAN)]


def _table(title: str, measures: list[Measure], names: Callable[[Measure], tuple[str, str]]) -> Titled:
    parts = len({m.segment for m in measures}) > 1
    table = Titled(title, ("", *(["part"] if parts else []), *HEADS))
    for measure in measures:
        scale = SCALES.get(measure.unit, (1.0, ""))[0]
        name, part = names(measure)
        table.add_row(name, *([part] if parts else []), *(f"{scale * getattr(measure, s):.4f}" for s in SHOWN))
    return table


def to_text(comparison: ComparisonResult) -> str:
    """Give tables as text."""
    return as_text(tables(comparison), WIDTH)


def to_json(comparison: ComparisonResult) -> str:
    """Give everything but the differences over time, SI units."""
    whole = {
        "reference": comparison.reference,
        "shifts": {d.name: d.shift for d in comparison.differences},
        "segments": [asdict(segment) for segment in comparison.segments],
        "measures": [asdict(measure) for measure in comparison.measures],
        "spread": comparison.spread,
        **({} if comparison.repeats is None else {"repeats": _of_repeats(comparison.repeats)}),
    }
    return json.dumps(whole, indent=1, ensure_ascii=False) + "\n"


def _of_repeats(repeats: Repeats) -> dict[str, object]:
    names = ("signals", "distances", "outliers", "trend", "p_value")
    return {name: getattr(repeats, name) for name in names}


def to_csv(comparison: ComparisonResult) -> str:
    """Give a row a measure, SI units."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = [field.name for field in fields(Measure)]
    writer.writerow(names)
    writer.writerows([getattr(measure, name) for name in names] for measure in comparison.measures)
    return text.getvalue()


def to_latex(comparison: ComparisonResult) -> str:
    """Give a table for a paper: of the tool, or of the joints where there is no tool."""
    tool = [m for m in comparison.measures if m.signal == "tool"]
    shown = tool or [m for m in comparison.measures if m.signal.startswith("q_")]
    unit = SCALES[shown[0].unit][1] if shown else ""
    heads = ["", "part", *([] if tool else ["joint"]), *(_escape(head) for head in HEADS)]
    lines = [
        f"% differences from {comparison.reference} [{unit}]; needs booktabs",
        rf"\begin{{tabular}}{{{'l' * (len(heads) - len(HEADS))}{'r' * len(HEADS)}}}",
        r"\toprule",
        " & ".join(heads) + r" \\",
        r"\midrule",
    ]
    for m in shown:
        scale = SCALES[m.unit][0]
        cells = [m.estimate, m.segment, *([] if tool else [m.signal.removeprefix("q_")])]
        values = [f"{scale * getattr(m, s):.4f}" for s in SHOWN]
        lines.append(" & ".join([*map(_escape, cells), *values]) + r" \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _escape(text: str) -> str:
    for mark in "&%#_$":
        text = text.replace(mark, "\\" + mark)
    return text


def write(comparison: ComparisonResult, path: str | Path) -> None:
    """Write as the suffix says, whole or not at all."""
    check_writable(path, SUFFIXES)
    forms = {".json": to_json, ".csv": to_csv, ".tex": to_latex, ".txt": to_text}
    write_text(path, forms[Path(path).suffix.lower()](comparison))
