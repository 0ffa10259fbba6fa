"""Whether an estimate's errors agree with its standard deviations."""

from .compare import Consistency, consistency
from .measures import Ratio

__all__ = ["Consistency", "Ratio", "consistency"]
