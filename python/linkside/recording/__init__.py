"""Recordings and what was found from them: logs, estimates, and their files."""

from .estimate import Estimate, EstimateError, Status
from .log import Log, LogStream
from .writer import EstimateWriter

__all__ = ["Estimate", "EstimateError", "EstimateWriter", "Log", "LogStream", "Status"]
