"""Observers of link velocity from motor side signals, and the design of their gains."""

from .gain_map import GainMap
from .observers import HybridGain, NicosiaTomeiObserver, ReducedOrderObserver, VelocityEstimate

__all__ = ["GainMap", "HybridGain", "NicosiaTomeiObserver", "ReducedOrderObserver", "VelocityEstimate"]
