"""Motions that make springs, masses and poses of sensors identifiable."""

from .excitation import Excitation
from .excite import excite, expected_errors
from .expected import ExpectedErrors, MotorMotion
from .limits import Limits

__all__ = ["Excitation", "ExpectedErrors", "Limits", "MotorMotion", "excite", "expected_errors"]
