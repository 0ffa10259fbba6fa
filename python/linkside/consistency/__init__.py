"""Whether an estimate's errors are as large as it says."""

from .compare import Consistency, consistency
from .measures import Ratio

__all__ = ["Consistency", "Ratio", "consistency"]
