"""How far motions of the same robot are apart: estimates, measured truths and commanded paths."""

from .alignment import ALIGNMENTS, find_shift
from .compare import Comparison, compare, compare_files
from .measures import Difference, Measure
from .reading import read_motion
from .repeats import Repeats
from .segments import Segment, between_rests, read_segments

__all__ = [
    "ALIGNMENTS",
    "Comparison",
    "Difference",
    "Measure",
    "Repeats",
    "Segment",
    "between_rests",
    "compare",
    "compare_files",
    "find_shift",
    "read_motion",
    "read_segments",
]
