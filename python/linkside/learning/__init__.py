"""Iterative learning control on estimates: from repeat to repeat, a better path."""

from .learning import Margin, PathLearning, Trial
from .loop import Motion
from .state import read, wanted_motion, write

__all__ = ["Margin", "Motion", "PathLearning", "Trial", "read", "wanted_motion", "write"]
