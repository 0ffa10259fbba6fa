"""Where the links of an elastic-joint robot really are.

>>> import linkside
>>> robot = linkside.Robot.load(linkside.demo.ROBOT)
>>> log = linkside.Log.read(linkside.demo.LOG, robot)
>>> estimate = linkside.AccelerationObserver(robot).run(log)
>>> estimate.q.shape
(2000, 6)
"""

from . import control, controllers, demo, feedback, poles, sensors, trajectories
from .elastic import ElasticJointFilter, ElasticJointSmoother, ElasticNoise
from .errors import ConfigError, EstimatorError, LinksideError, LogError, NumericalError, OutputError
from .estimate import Estimate, EstimateWriter, Status
from .filtering import KalmanEstimate
from .fixed_lag import FixedLagSmoother
from .kalman import ExtendedKalmanFilter, RauchTungStriebelSmoother
from .log import Log
from .noise import Noise
from .observers import AccelerationObserver
from .particle import MarginalizedParticleFilter, Mixture, ParticleEstimate, ParticleFilter
from .robot import Robot
from .simulate import Sensor, Simulation, simulate
from .stretches import smooth_file
from .velocity import HybridGain, NicosiaTomeiObserver, ReducedOrderObserver, VelocityEstimate

__all__ = [
    "AccelerationObserver",
    "ConfigError",
    "ElasticJointFilter",
    "ElasticJointSmoother",
    "ElasticNoise",
    "Estimate",
    "EstimateWriter",
    "EstimatorError",
    "ExtendedKalmanFilter",
    "FixedLagSmoother",
    "HybridGain",
    "KalmanEstimate",
    "LinksideError",
    "Log",
    "LogError",
    "MarginalizedParticleFilter",
    "Mixture",
    "NicosiaTomeiObserver",
    "Noise",
    "NumericalError",
    "OutputError",
    "ParticleEstimate",
    "ParticleFilter",
    "RauchTungStriebelSmoother",
    "ReducedOrderObserver",
    "Robot",
    "Sensor",
    "Simulation",
    "Status",
    "VelocityEstimate",
    "control",
    "controllers",
    "demo",
    "feedback",
    "poles",
    "sensors",
    "simulate",
    "smooth_file",
    "trajectories",
]
