"""Whether to trust an estimate: contradictions between readings and model, and parameters known to a tolerance only."""

from .findings import Finding
from .tolerances import Uncertain, considered

__all__ = ["Finding", "Uncertain", "considered"]
