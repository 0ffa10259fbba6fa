"""What a robot's accelerometers see of its links, and where to place them."""

from .analysis import CheckReport, check
from .placement import Placement, candidates, place, read_candidates

__all__ = ["CheckReport", "Placement", "candidates", "check", "place", "read_candidates"]
