"""Motions that make springs, masses and poses of sensors identifiable."""

from linkside.robot.limits import Limits

from .excitation import Excitation
from .excite import excite, expected_errors
from .expected import ExpectedErrors, MotorMotion

__all__ = ["Excitation", "ExpectedErrors", "Limits", "MotorMotion", "excite", "expected_errors"]
