"""Control of elastic-joint robots: motions, torques along them, feedback, and analysis of the closed loop."""

from .feedforward import Desired, derivative_order, inverse_dynamics

__all__ = ["Desired", "derivative_order", "inverse_dynamics"]
