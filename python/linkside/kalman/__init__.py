"""Kalman filters and smoothers: on the jerk-driven model, and on the elastic-joint dynamics."""

from .cramer_rao import Bound, bound
from .elastic_joint import ElasticJointFilter, ElasticJointIteratedSmoother, ElasticJointSmoother, ElasticNoise
from .filtering import KalmanEstimate
from .fixed_lag import FixedLagSmoother
from .jerk_driven import (
    CubatureKalmanFilter,
    CubatureSmoother,
    ExtendedKalmanFilter,
    IteratedSmoother,
    RauchTungStriebelSmoother,
    UnscentedKalmanFilter,
    UnscentedSmoother,
)
from .motor_jerk import MotorJerkFilter, MotorJerkNoise, MotorJerkSmoother
from .noise import Noise
from .stretches import smooth_file, smooth_pieces

__all__ = [
    "Bound",
    "CubatureKalmanFilter",
    "CubatureSmoother",
    "ElasticJointFilter",
    "ElasticJointIteratedSmoother",
    "ElasticJointSmoother",
    "ElasticNoise",
    "ExtendedKalmanFilter",
    "FixedLagSmoother",
    "IteratedSmoother",
    "KalmanEstimate",
    "MotorJerkFilter",
    "MotorJerkNoise",
    "MotorJerkSmoother",
    "Noise",
    "RauchTungStriebelSmoother",
    "UnscentedKalmanFilter",
    "UnscentedSmoother",
    "bound",
    "smooth_file",
    "smooth_pieces",
]
