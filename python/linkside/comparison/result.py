"""What a comparison found."""

from __future__ import annotations

from dataclasses import dataclass

from .measures import Difference, Measure
from .repeats import Repeats
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
    repeats : Repeats, optional
        What repeats of one motion have in common, and what not; None with fewer than two.
    """

    reference: str
    measures: tuple[Measure, ...]
    differences: tuple[Difference, ...]
    segments: tuple[Segment, ...] = ()
    repeats: Repeats | None = None

    @property
    def spread(self) -> dict[str, float]:
        """Of repeats: standard deviation between them by signal, RMS over time; else empty."""
        return {} if self.repeats is None else self.repeats.spread
