"""Iterative learning control on estimates: from repeat to repeat, a better path."""

from linkside.robot.limits import Limits

from .belief import Belief
from .learning import Margin, PathLearning
from .loop import Motion
from .state import read, wanted_motion, write
from .trial import Trial

__all__ = ["Belief", "Limits", "Margin", "Motion", "PathLearning", "Trial", "read", "wanted_motion", "write"]
