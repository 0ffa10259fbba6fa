"""What a comparison found."""

from __future__ import annotations

from dataclasses import dataclass

from .measures import Difference, Measure
from .segments import Segment


@dataclass(frozen=True, eq=False)
class ComparisonResult:
    """How far estimates are from a reference.

    Attributes
    ----------
    reference : str
        Its name.
    measures : tuple of Measure
        Estimate by estimate, segment by segment, signal by signal, SI units.
    differences : tuple of Difference
        What was measured.
    segments : tuple of Segment
        Parts of the motion that were measured apart.
    spread : dict of str to float
        Of repeats: standard deviation between them by signal, RMS over time; empty with fewer than two.
    """

    reference: str
    measures: tuple[Measure, ...]
    differences: tuple[Difference, ...]
    segments: tuple[Segment, ...] = ()
    spread: dict[str, float] | None = None
