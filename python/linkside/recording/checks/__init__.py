"""Recordings are looked at before they are believed: cheap checks of a log against its robot, before any estimate."""

from .finding import Finding
from .inspector import CHECKS, Inspector, inspect, verdicts

__all__ = ["CHECKS", "Finding", "Inspector", "inspect", "verdicts"]
