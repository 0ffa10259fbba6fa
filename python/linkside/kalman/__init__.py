"""Kalman filters and smoothers: on the jerk-driven model, and on the elastic-joint dynamics."""

from .elastic_joint import ElasticJointFilter, ElasticJointSmoother, ElasticNoise
from .filtering import KalmanEstimate
from .fixed_lag import FixedLagSmoother
from .jerk_driven import ExtendedKalmanFilter, RauchTungStriebelSmoother
from .noise import Noise
from .stretches import smooth_file, smooth_pieces

__all__ = [
    "ElasticJointFilter",
    "ElasticJointSmoother",
    "ElasticNoise",
    "ExtendedKalmanFilter",
    "FixedLagSmoother",
    "KalmanEstimate",
    "Noise",
    "RauchTungStriebelSmoother",
    "smooth_file",
    "smooth_pieces",
]
