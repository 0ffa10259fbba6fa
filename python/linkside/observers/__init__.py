"""Observers driven by accelerometers, their poles, and files of their tuning."""

from .acceleration import AccelerationObserver

__all__ = ["AccelerationObserver"]
