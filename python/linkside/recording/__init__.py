"""Recordings and what was found from them: logs, estimates, and their files."""

from .estimate import Estimate, EstimateError, EstimateWriter, Status
from .log import Log, LogStream

__all__ = ["Estimate", "EstimateError", "EstimateWriter", "Log", "LogStream", "Status"]
