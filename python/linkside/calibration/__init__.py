"""Calibration of a robot from its own recordings: stiffness, damping, loads, sensors, with standard errors."""

from .calibrate import calibrate
from .calibration import Calibration
from .result import Estimated, Fit
from .search import Step
from .together import Shared, Together, calibrate_together
from .tracker import Alignment, align_tracker
from .uncertainty import Contradiction

__all__ = [
    "Alignment",
    "Calibration",
    "Contradiction",
    "Estimated",
    "Fit",
    "Shared",
    "Step",
    "Together",
    "align_tracker",
    "calibrate",
    "calibrate_together",
]
