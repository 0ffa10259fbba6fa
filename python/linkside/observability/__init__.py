"""What a robot's accelerometers see of its links, and where to place them."""

from .analysis import check
from .findings import Sight
from .placement import Placement, candidates, place, read_candidates
from .report import CheckReport

__all__ = ["CheckReport", "Placement", "Sight", "candidates", "check", "place", "read_candidates"]
