"""Checks of recordings against their robot, which run before any estimate and cost little."""

from .finding import Finding
from .inspector import CHECKS, Inspector, inspect, verdicts

__all__ = ["CHECKS", "Finding", "Inspector", "inspect", "verdicts"]
