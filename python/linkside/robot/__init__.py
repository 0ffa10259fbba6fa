"""A robot: what robot.yaml and its URDF describe, and the kinematic tree that the core computes with."""

from .robot import Robot

__all__ = ["Robot"]
