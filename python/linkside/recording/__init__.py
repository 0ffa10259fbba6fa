"""Recordings and what was found from them: logs, estimates, and their files."""

from .checks import Finding, inspect
from .estimate import Estimate, EstimateError, EstimateWriter, Status
from .log import Log, LogStream

__all__ = ["Estimate", "EstimateError", "EstimateWriter", "Finding", "Log", "LogStream", "Status", "inspect"]
