"""Recordings and what was found from them: logs, estimates, and their files."""

from .checks import Finding, inspect
from .estimate import Estimate, EstimateError, Status
from .log import Log, LogStream
from .writer import EstimateWriter

__all__ = ["Estimate", "EstimateError", "EstimateWriter", "Finding", "Log", "LogStream", "Status", "inspect"]
