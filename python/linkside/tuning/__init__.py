"""Tuning: noise by maximum likelihood, poles of observers by trade-off."""

from .noise_likelihood import tune
from .observer_front import tune_observer

__all__ = ["tune", "tune_observer"]
