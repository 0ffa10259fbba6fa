"""Observability of link accelerations by accelerometers, and where to place these."""

from .analysis import check
from .placement import Placement, candidates, place, read_candidates
from .report import CheckReport
from .result import Observability

__all__ = ["CheckReport", "Observability", "Placement", "candidates", "check", "place", "read_candidates"]
