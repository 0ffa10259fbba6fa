"""Whether an estimate's errors are as large as it says."""

from .compare import Consistency, Ratio, consistency

__all__ = ["Consistency", "Ratio", "consistency"]
