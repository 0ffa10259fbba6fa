"""Simulated recordings, with a known truth."""

from .simulator import Sensor, Simulation, simulate

__all__ = ["Sensor", "Simulation", "simulate"]
