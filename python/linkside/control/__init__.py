"""Control of elastic-joint robots: motions, torques along them, feedback, and what it does to the loop."""

from .feedforward import Desired, derivative_order, inverse_dynamics

__all__ = ["Desired", "derivative_order", "inverse_dynamics"]
