"""Calibration of a robot from its own recordings: stiffness, damping, loads, sensors, with standard errors."""

from .calibrate import calibrate
from .calibration import Calibration
from .result import Estimated, Fit
from .search import Step
from .uncertainty import Contradiction

__all__ = ["Calibration", "Contradiction", "Estimated", "Fit", "Step", "calibrate"]
