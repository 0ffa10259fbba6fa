"""Where the links of an elastic-joint robot really are.

>>> import linkside
>>> robot = linkside.Robot.load(linkside.demo.ROBOT)
>>> log = linkside.Log.read(linkside.demo.LOG, robot)
>>> estimate = linkside.AccelerationObserver(robot).run(log)
>>> estimate.q.shape
(2000, 6)
"""

from . import demo
from .control import controllers, feedback, trajectories
from .errors import (
    ConfigError,
    EstimatorError,
    LinksideError,
    LinksideWarning,
    LogError,
    NumericalError,
    OutputError,
    RecordingWarning,
    RobotWarning,
)
from .kalman import (
    CubatureKalmanFilter,
    CubatureSmoother,
    ElasticJointFilter,
    ElasticJointIteratedSmoother,
    ElasticJointSmoother,
    ElasticNoise,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    IteratedSmoother,
    KalmanEstimate,
    MotorJerkFilter,
    MotorJerkNoise,
    MotorJerkSmoother,
    Noise,
    RauchTungStriebelSmoother,
    UnscentedKalmanFilter,
    UnscentedSmoother,
    smooth_file,
)
from .observability import sensors
from .observers import AccelerationObserver, poles
from .particle import MarginalizedParticleFilter, Mixture, ParticleEstimate, ParticleFilter
from .recording import Estimate, EstimateWriter, Finding, Log, Status, inspect
from .robot import Robot
from .simulation import Sensor, Simulation, simulate
from .velocity import GainMap, HybridGain, NicosiaTomeiObserver, ReducedOrderObserver, VelocityEstimate

__all__ = [
    "AccelerationObserver",
    "ConfigError",
    "CubatureKalmanFilter",
    "CubatureSmoother",
    "ElasticJointFilter",
    "ElasticJointIteratedSmoother",
    "ElasticJointSmoother",
    "ElasticNoise",
    "Estimate",
    "EstimateWriter",
    "EstimatorError",
    "ExtendedKalmanFilter",
    "Finding",
    "FixedLagSmoother",
    "GainMap",
    "HybridGain",
    "IteratedSmoother",
    "KalmanEstimate",
    "LinksideError",
    "LinksideWarning",
    "Log",
    "LogError",
    "MarginalizedParticleFilter",
    "Mixture",
    "MotorJerkFilter",
    "MotorJerkNoise",
    "MotorJerkSmoother",
    "NicosiaTomeiObserver",
    "Noise",
    "NumericalError",
    "OutputError",
    "ParticleEstimate",
    "ParticleFilter",
    "RauchTungStriebelSmoother",
    "RecordingWarning",
    "ReducedOrderObserver",
    "Robot",
    "RobotWarning",
    "Sensor",
    "Simulation",
    "Status",
    "UnscentedKalmanFilter",
    "UnscentedSmoother",
    "VelocityEstimate",
    "control",
    "controllers",
    "demo",
    "feedback",
    "inspect",
    "poles",
    "sensors",
    "simulate",
    "smooth_file",
    "trajectories",
]
