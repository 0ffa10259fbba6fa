"""Particle filters on the jerk-driven model."""

from .filters import MarginalizedParticleFilter, Mixture, ParticleEstimate, ParticleFilter

__all__ = ["MarginalizedParticleFilter", "Mixture", "ParticleEstimate", "ParticleFilter"]
