"""Motions that let a calibration tell springs, masses and where sensors are."""

from .excitation import Excitation
from .excite import excite, foretell
from .foresight import Foreseen, MotorMotion
from .limits import Limits

__all__ = ["Excitation", "Foreseen", "Limits", "MotorMotion", "excite", "foretell"]
