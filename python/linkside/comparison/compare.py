"""Comparing motions with a reference: by time, in segments, and as repeats of one motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.mapping import Map, here
from linkside.recording import Estimate
from linkside.robot import Robot
from linkside.robot.workspace import prismatic

from . import output
from .alignment import ALIGNMENTS, find_shift, sampled
from .measures import Difference, Measure
from .reading import read_motion
from .repeats import Repeats
from .result import ComparisonResult
from .segments import Segment, between_rests

if TYPE_CHECKING:
    from matplotlib.figure import Figure

KINDS = {"q": "rad", "dq": "rad/s", "ddq": "rad/s²", "theta": "rad", "dtheta": "rad/s"}
"""Signals of joints that are compared, and their units; m in place of rad for joints that slide."""

RATES = {"q": "dq", "dq": "ddq", "theta": "dtheta"}
"""The signal that is another's rate of change."""

WHOLE = "all"
"""The segment that is the whole motion."""


class Comparison(ComparisonResult):
    """A result that can be written and drawn."""

    def to_text(self) -> str:
        """Give tables of the tool and of the joints."""
        return output.to_text(self)

    def to_json(self) -> str:
        """Give everything but the differences over time, SI units."""
        return output.to_json(self)

    def to_csv(self) -> str:
        """Give a row a measure, SI units."""
        return output.to_csv(self)

    def to_latex(self) -> str:
        """Give a table for a paper: tool, or joints where there is no tool."""
        return output.to_latex(self)

    def write(self, path: str | Path) -> None:
        """Write as the suffix says, ``.json``, ``.csv``, ``.tex`` or ``.txt``, whole or not at all."""
        output.write(self, path)

    def figure(self) -> Figure:
        """Draw the differences over time."""
        from .figure import draw

        return draw(self)


def compare_files(
    reference: str | Path,
    estimates: Sequence[str | Path],
    *,
    robot: Robot | None = None,
    names: Sequence[str] | None = None,
    shift: float | Literal["auto"] = 0.0,
    align: Literal["time", "start"] = "time",
    segments: Sequence[Segment] | Literal["rests"] = (),
    repeats: bool = False,
    read: Callable[[str | Path, Robot | None], Estimate] = read_motion,
    run: Map = here,
) -> Comparison:
    """Compare files of estimates with a truth, another estimate, or the commanded path of a log.

    Each estimate is read and compared by itself, wherever ``run`` has it, see `linkside.fleet.mapped`; ``read`` reads
    a file. Names are those given, or those of the files; everything else is as in `compare`.
    """
    named = list(names or distinct([Path(path) for path in estimates]))
    if len(named) != len(estimates):
        raise EstimatorError(f"{len(named)} names for {len(estimates)} estimates")
    files = dict(zip(named, estimates, strict=True))
    if len(files) != len(estimates):
        raise EstimatorError("two estimates have the same name; give names that differ")
    clocks = _Clocks.of(read(reference, robot), align, shift)
    differences = list(run(partial(_of_file, clocks, read, robot), list(files.items())))
    return _compared(str(reference), clocks.reference, differences, robot, segments, repeats=repeats)


def distinct(paths: Sequence[Path]) -> list[str]:
    """Shortest names of files that tell them apart: the stem, or as many folders as are needed."""
    for depth in range(1, max((len(path.parts) for path in paths), default=1) + 1):
        names = ["/".join((*path.parts[-depth:-1], path.name.split(".")[0])) for path in paths]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]


def compare(
    reference: Estimate,
    estimates: Mapping[str, Estimate],
    *,
    name: str = "reference",
    robot: Robot | None = None,
    shift: float | Literal["auto"] = 0.0,
    align: Literal["time", "start"] = "time",
    segments: Sequence[Segment] | Literal["rests"] = (),
    repeats: bool = False,
) -> Comparison:
    """Measure how far estimates are from a reference of the same motion.

    The reference is interpolated at each estimate's times, but not over gaps; times that it does not cover are left
    out.

    Parameters
    ----------
    reference, estimates
        Motions, the latter by name.
    robot
        States which joints slide, so that they are in metres.
    shift
        Delay of the estimates' clocks [s]; ``"auto"`` finds it for each, see `find_shift`.
    align
        ``"time"``, or ``"start"`` for motions that were recorded at different times: each begins at its first row.
    segments
        Parts to measure apart, or ``"rests"`` for those between the reference's rests.
    repeats
        The estimates are repeats of one motion, in the order in which they were made: their mean is compared as well,
        and their spread, trend and outliers are given, see `Repeats`.

    Raises
    ------
    EstimatorError
        Nothing in common, in time or in signals; or an argument out of range.
    """
    clocks = _Clocks.of(reference, align, shift)
    differences = [clocks.difference(label, estimate) for label, estimate in estimates.items()]
    return _compared(name, reference, differences, robot, segments, repeats=repeats)


@dataclass(frozen=True, eq=False)
class _Clocks:
    """A reference, and how times of estimates belong to its own."""

    reference: Estimate
    align: str
    shift: float | Literal["auto"]

    @classmethod
    def of(cls, reference: Estimate, align: str, shift: float | Literal["auto"]) -> _Clocks:
        if align not in ALIGNMENTS:
            raise EstimatorError(f"align is {align!r}, expected one of {', '.join(ALIGNMENTS)}")
        if shift != "auto" and not math.isfinite(shift):
            raise EstimatorError(f"shift is {shift}, expected a finite time in seconds, or 'auto'")
        return cls(reference, align, shift)

    def difference(self, label: str, estimate: Estimate) -> Difference:
        reference = self.reference
        origin = reference.t[0] if self.align == "start" and len(reference) else 0.0
        moved = _from_start(estimate, origin) if self.align == "start" else estimate
        late = find_shift(reference, moved) if self.shift == "auto" else float(self.shift)
        return _difference(label, reference, moved, late)


def _of_file(
    clocks: _Clocks,
    read: Callable[[str | Path, Robot | None], Estimate],
    robot: Robot | None,
    file: tuple[str, str | Path],
) -> Difference:
    name, path = file
    return clocks.difference(name, read(path, robot))


def _compared(
    name: str,
    reference: Estimate,
    differences: list[Difference],
    robot: Robot | None,
    segments: Sequence[Segment] | Literal["rests"],
    *,
    repeats: bool,
) -> Comparison:
    if not differences:
        raise EstimatorError("there is no estimate to compare")
    judged = Repeats.of(differences) if repeats and len(differences) > 1 else None
    if judged is not None:
        differences.append(judged.mean)
    parts = between_rests(reference) if segments == "rests" else tuple(segments)
    units = _units(reference, robot)
    measures = [m for d in differences for m in _measures(d, parts, units)]
    return Comparison(name, tuple(measures), tuple(differences), parts, judged)


def _from_start(motion: Estimate, origin: float) -> Estimate:
    return replace(motion, t=motion.t - motion.t[0] + origin) if len(motion) else motion


def _difference(name: str, reference: Estimate, estimate: Estimate, shift: float) -> Difference:
    t = estimate.t - shift
    signals = {}
    for kind in KINDS:
        for joint in estimate.names:
            ours, theirs = _column(estimate, kind, joint), _column(reference, kind, joint)
            if ours is not None and theirs is not None:
                rates = _column(reference, RATES[kind], joint) if kind in RATES else None
                signals[f"{kind}_{joint}"] = ours - sampled(reference.t, theirs, rates, t)
    if estimate.tool_position is not None and reference.tool_position is not None:
        signals["tool"] = estimate.tool_position - sampled(reference.t, reference.tool_position, None, t)
    known = {s: e for s, e in signals.items() if np.isfinite(e).all(axis=1).any()}
    if not known:
        what = "no time" if signals else "no signal"
        raise EstimatorError(
            f"{name} has {what} in common with the reference, which goes {_span(reference)}; it goes {_span(estimate)}"
        )
    return Difference(name, t, shift, known)


def _span(motion: Estimate) -> str:
    return f"from {motion.t[0]:.6g} to {motion.t[-1]:.6g} s" if len(motion) else "nowhere"


def _column(motion: Estimate, kind: str, joint: str) -> FloatArray | None:
    """A signal of a joint, (T, 1), where it is known at all."""
    array = getattr(motion, kind)
    if array is None or joint not in motion.names:
        return None
    column = array[:, [motion.names.index(joint)]]
    return None if np.isnan(column).all() else column


def _measures(difference: Difference, segments: Sequence[Segment], units: dict[str, str]) -> list[Measure]:
    found = list(difference.measures(WHOLE, np.ones(len(difference.t), bool), units))
    for segment in segments:
        inside = (difference.t >= segment.start) & (difference.t <= segment.end)
        found += difference.measures(segment.name, inside, units)
    return found


def _units(reference: Estimate, robot: Robot | None) -> dict[str, str]:
    slides = dict(zip(robot.names, prismatic(robot), strict=True)) if robot is not None else {}
    units = {
        f"{kind}_{joint}": unit.replace("rad", "m") if slides.get(joint, False) else unit
        for kind, unit in KINDS.items()
        for joint in reference.names
    }
    return units | {"tool": "m"}
