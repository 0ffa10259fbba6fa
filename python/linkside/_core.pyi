"""Compiled kernels of linkside: float64 arrays in C order, joints in log order, SI units."""

from collections.abc import Callable, Mapping, Sequence
from os import PathLike
from typing import Any, Literal, final

import numpy as np
import numpy.typing as npt

__all__ = [
    "AccelerationObserver",
    "BagCollector",
    "ElasticJointFilter",
    "ExtendedKalmanFilter",
    "LearningLoop",
    "LearningStep",
    "Likelihood",
    "McapReader",
    "ParticleFilter",
    "Response",
    "Robot",
    "State",
    "StretchSmoother",
    "VelocityObserver",
    "acceleration_inverse",
    "derivative_order",
    "feedforward",
    "largest_nis",
    "observer_gains",
    "sampled_observer",
    "simulate",
    "unpack_file",
]

_Array = npt.NDArray[np.float64]
_Signal = _Array | Sequence[float]
_Arrays = tuple[_Array, _Array, _Array]
_KalmanArrays = tuple[_Array, _Array, _Array, _Array]

@final
class Robot:
    """A robot flattened for the kernels. Methods take rows (T, n) and give one array a row."""

    def __new__(
        cls,
        gravity: Sequence[float] | _Array,
        bodies: Sequence[Mapping[str, Any]],
        drives: Sequence[Mapping[str, Any]],
        coupling: _Array,
        accelerometers: Sequence[Mapping[str, Any]],
        gyroscopes: Sequence[Mapping[str, Any]],
        tool: Mapping[str, Any] | None,
        rotors: Sequence[Mapping[str, Any]],
        counterbalances: Sequence[Mapping[str, Any]],
        gearing: tuple[Sequence[int], Sequence[float]],
        followers: Sequence[tuple[int, float, float]],
    ) -> Robot: ...
    @property
    def n(self) -> int: ...
    def inverse_dynamics(self, q: _Array, dq: _Array, ddq: _Array) -> _Array: ...
    def inverse_dynamics_derivatives(self, q: _Array, dq: _Array, ddq: _Array) -> _Array: ...
    def mass_matrix(self, q: _Array) -> _Array: ...
    def forward_dynamics(self, q: _Array, dq: _Array, theta: _Array, dtheta: _Array, tau: _Array) -> _Array: ...
    def coriolis_matrix(self, q: _Array, dq: _Array) -> _Array: ...
    def gravity_torque(self, q: _Array) -> _Array: ...
    def link_friction(self, dq: _Array, load: _Array) -> _Array: ...
    def motor_friction(self, dtheta: _Array, load: _Array) -> _Array: ...
    def specific_force(self, q: _Array, dq: _Array, ddq: _Array) -> _Array: ...
    def specific_force_derivatives(self, q: _Array, dq: _Array, ddq: _Array) -> _Array: ...
    def angular_rate(self, q: _Array, dq: _Array) -> _Array: ...
    def tool_position(self, q: _Array) -> _Array: ...

@final
class AccelerationObserver:
    """Observer of one robot, designed for one sampling period."""

    def __new__(
        cls,
        robot: Robot,
        *,
        period: float,
        poles: Sequence[Sequence[complex]],
        bias: bool,
        predictor: bool,
        joint_accelerations: bool,
        worst_acceleration_std: float,
        rest: bool,
    ) -> AccelerationObserver: ...
    def copy(self) -> AccelerationObserver: ...
    def reset(self) -> None: ...
    def start(self, theta: _Signal, q: _Signal, dtheta: _Signal, dq: _Signal) -> None: ...
    def begin(self, theta: _Signal, q: _Signal, dtheta: _Signal, dq: _Signal) -> None: ...
    def step(self, theta: _Signal, tau: _Signal, acceleration: _Signal) -> State: ...
    def hold(self, tau: _Signal) -> None: ...
    def run(self, theta: _Array, tau: _Array, acceleration: _Array) -> dict[str, npt.NDArray[Any]]: ...
    @staticmethod
    def run_all(
        jobs: Sequence[tuple[AccelerationObserver, _Arrays]],
    ) -> list[dict[str, npt.NDArray[Any]] | Exception]: ...

@final
class State:
    """The estimate at one sample: the fields of an estimate's row, None for what a method does not have."""

    @property
    def t(self) -> float: ...
    @property
    def q(self) -> _Array: ...
    @property
    def dq(self) -> _Array: ...
    @property
    def ddq(self) -> _Array: ...
    @property
    def theta(self) -> _Array: ...
    @property
    def dtheta(self) -> _Array: ...
    @property
    def q_std(self) -> _Array: ...
    @property
    def disturbance(self) -> _Array | None: ...
    @property
    def disturbance_std(self) -> _Array | None: ...
    @property
    def tool_position(self) -> _Array: ...
    @property
    def tool_std(self) -> _Array: ...
    @property
    def status(self) -> int: ...
    @property
    def nis(self) -> float | None: ...
    @property
    def log_likelihood(self) -> float | None: ...
    @property
    def used(self) -> int | None: ...
    @property
    def effective(self) -> float | None: ...
    @property
    def level(self) -> int | None: ...
    @property
    def state(self) -> _Array: ...
    @property
    def covariance(self) -> _Array: ...

@final
class LearningLoop:
    def __new__(cls, transition: _Array, posture: Sequence[int], entry: _Array, output: _Array) -> LearningLoop: ...
    def answer(self, v: _Array) -> _Array: ...
    def adjoint(self, e: _Array) -> _Array: ...

@final
class LearningStep:
    def __new__(
        cls,
        model: LearningLoop,
        weight: _Array,
        roughness: Sequence[float],
        change: Sequence[float],
    ) -> LearningStep: ...
    def solve(self, e: _Array, mean: _Array) -> _Array: ...
    def contraction(self, real: LearningLoop, start: _Array) -> float: ...

@final
class Likelihood:
    """Likelihood of one recording."""

    def __new__(
        cls,
        robot: Robot,
        signals: Mapping[str, Any],
        *,
        noise: Mapping[str, Any],
        biased: Sequence[bool],
        torque: bool,
        fixed: Sequence[tuple[tuple[str, int, int], float]],
        huber: float,
    ) -> Likelihood: ...
    def log_likelihood(self, names: Sequence[tuple[str, int, int]], values: Sequence[float]) -> float: ...
    def evaluate(
        self, names: Sequence[tuple[str, int, int]], values: Sequence[float], detail: bool = False
    ) -> dict[str, Any]: ...

@final
class Response:
    """What sensors would read if nothing but the motors moved the links."""

    def __new__(
        cls,
        robot: Robot,
        motion: Mapping[str, _Array],
        *,
        kinds: Sequence[str],
        fixed: Sequence[tuple[tuple[str, int, int], float]],
    ) -> Response: ...
    def evaluate(
        self, names: Sequence[tuple[str, int, int]], values: Sequence[float], offset: Sequence[float]
    ) -> tuple[_Array, _Array]: ...

@final
class ExtendedKalmanFilter:
    """Extended Kalman filter of one robot."""

    def __new__(
        cls,
        robot: Robot,
        *,
        kinds: Sequence[str],
        biased: Sequence[bool],
        noise: Mapping[str, Any],
        gate: float | None,
        iterations: int,
        damping: bool,
        tolerances: Sequence[tuple[str, int, int, float]],
        correlations: Sequence[tuple[int, int, float]] = ...,
        late: Sequence[tuple[float, float, int] | None] | None = None,
        link_disturbance: Mapping[str, Any] | None = None,
    ) -> ExtendedKalmanFilter: ...
    @property
    def states(self) -> int: ...
    @property
    def own_states(self) -> int: ...
    @property
    def parameters(self) -> tuple[list[float], list[float]]: ...
    @property
    def findings(self) -> list[tuple[int | None, int, int, float, float, str]]: ...
    @property
    def covariance(self) -> _Array: ...
    def copy(self) -> ExtendedKalmanFilter: ...
    def reset(self) -> None: ...
    def linearise_along(self, leading: _Array) -> None: ...
    def set_losses(self, names: Sequence[str]) -> None: ...
    def set_start(self, mean: _Signal, covariance: _Array) -> None: ...
    def step(
        self,
        dt: float,
        theta: _Signal,
        acceleration: _Signal | None = None,
        dtheta: _Signal | None = None,
        ddqref: _Signal | None = None,
        further: _Signal | None = None,
    ) -> State: ...
    def run(self, arrays: _KalmanArrays, covariance: bool, innovations: bool) -> dict[str, npt.NDArray[Any]]: ...
    @staticmethod
    def run_all(
        jobs: Sequence[tuple[ExtendedKalmanFilter, _KalmanArrays]], way: str, covariance: bool, innovations: bool
    ) -> list[dict[str, npt.NDArray[Any]] | Exception]: ...

@final
class ElasticJointFilter:
    """Kalman filter on the elastic-joint model of one robot."""

    def __new__(
        cls,
        robot: Robot,
        *,
        kinds: Sequence[str],
        disturbances: bool,
        biased: Sequence[bool],
        first_order: bool,
        held: bool,
        noise: Mapping[str, Any],
        gate: float | None,
        iterations: int,
        tolerances: Sequence[tuple[str, int, int, float]],
        correlations: Sequence[tuple[int, int, float]] = ...,
        late: Sequence[tuple[float, float, int] | None] | None = None,
        link_disturbance: Mapping[str, Any] | None = None,
    ) -> ElasticJointFilter: ...
    @property
    def states(self) -> int: ...
    @property
    def own_states(self) -> int: ...
    @property
    def covariance(self) -> _Array: ...
    @property
    def parameters(self) -> tuple[list[float], list[float]]: ...
    def copy(self) -> ElasticJointFilter: ...
    def reset(self) -> None: ...
    def set_losses(self, names: Sequence[str]) -> None: ...
    def set_start(self, mean: _Signal, covariance: _Array) -> None: ...
    def step(self, dt: float, readings: _Signal, tau: _Signal) -> State: ...
    def run(self, arrays: tuple[_Array, _Array, _Array]) -> dict[str, npt.NDArray[Any]]: ...
    @staticmethod
    def run_all(
        jobs: Sequence[tuple[ElasticJointFilter, tuple[_Array, _Array, _Array]]],
        way: str,
        covariance: bool,
        innovations: bool,
    ) -> list[dict[str, npt.NDArray[Any]] | Exception]: ...

@final
class StretchSmoother:
    """Smoother that takes a recording's stretches from the last to the first."""

    def __new__(cls, filter: ExtendedKalmanFilter) -> StretchSmoother: ...
    @property
    def stretch(self) -> int: ...
    def back(
        self, start: ExtendedKalmanFilter, arrays: _KalmanArrays, covariance: bool
    ) -> dict[str, npt.NDArray[Any]]: ...
    def row(self, start: ExtendedKalmanFilter, arrays: _KalmanArrays, row: int, t: float) -> State: ...

@final
class ParticleFilter:
    """Particle filter of one robot."""

    def __new__(
        cls,
        robot: Robot,
        *,
        kinds: Sequence[str],
        biased: Sequence[bool],
        noise: Mapping[str, Any],
        damping: bool,
        tolerances: Sequence[tuple[str, int, int, float]],
        marginalised: Literal["nothing", "biases", "accelerations"],
        settings: Mapping[str, Any],
        correlations: Sequence[tuple[int, int, float]] = ...,
        late: Sequence[tuple[float, float, int] | None] | None = None,
    ) -> ParticleFilter: ...
    @property
    def states(self) -> int: ...
    @property
    def own_states(self) -> int: ...
    @property
    def effective(self) -> float: ...
    @property
    def covariance(self) -> _Array: ...
    def copy(self) -> ParticleFilter: ...
    def set_start(self, mean: _Signal, covariance: _Array) -> None: ...
    def reset(self) -> None: ...
    def step(
        self,
        dt: float,
        theta: _Signal,
        acceleration: _Signal | None = None,
        dtheta: _Signal | None = None,
        ddqref: _Signal | None = None,
        further: _Signal | None = None,
    ) -> State: ...
    def run(self, arrays: _KalmanArrays, covariance: bool) -> dict[str, npt.NDArray[Any]]: ...
    @staticmethod
    def run_all(
        jobs: Sequence[tuple[ParticleFilter, _KalmanArrays]], smooth: bool, covariance: bool
    ) -> list[dict[str, npt.NDArray[Any]] | Exception]: ...

@final
class VelocityObserver:
    """Velocity observer of one robot, designed for one sampling period."""

    def __new__(
        cls,
        robot: Robot,
        *,
        period: float,
        gains: Sequence[float],
        levels: Mapping[str, Any] | None,
        map: Mapping[str, Any] | None,
        spring: Sequence[float],
        motors: bool,
        wrap: Sequence[float],
        rest: bool,
    ) -> VelocityObserver: ...
    def copy(self) -> VelocityObserver: ...
    def reset(self) -> None: ...
    def start(self, dq: _Signal, lag: _Signal) -> None: ...
    def begin(self, dq: _Signal, lag: _Signal) -> None: ...
    def step(self, q: _Signal, tau: _Signal) -> State: ...
    def run(self, q: _Array, tau: _Array) -> dict[str, npt.NDArray[Any]]: ...
    @staticmethod
    def run_all(
        jobs: Sequence[tuple[VelocityObserver, tuple[_Array, _Array]]],
    ) -> list[dict[str, npt.NDArray[Any]] | Exception]: ...

def observer_gains(robot: Robot, joint: int, poles: Sequence[complex]) -> _Array: ...
def sampled_observer(robot: Robot, joint: int, poles: Sequence[complex], period: float) -> list[_Array]: ...
def acceleration_inverse(robot: Robot, q: _Signal, worst_std: float) -> _Array: ...
def largest_nis(used: float) -> float: ...
def derivative_order(robot: Robot) -> int: ...
def feedforward(robot: Robot, t: _Array, derivatives: _Array) -> dict[str, _Array]: ...
def simulate(
    robot: Robot,
    settings: Mapping[str, Any],
    sensors: Sequence[Mapping[str, Any]],
    source: bool | tuple[ElasticJointFilter, Sequence[int]] | AccelerationObserver,
    law: Mapping[str, Any] | Callable[[float, _Array, _Array, _Array, _Array], _Signal],
) -> dict[str, _Array]: ...

@final
class BagCollector:
    """Gathers columns from messages. A request: topic, paths, the path of names if paths are of arrays, which names."""

    def __new__(
        cls, requests: Sequence[tuple[str, Sequence[str], str | None, Sequence[str] | None]], compressed: bool
    ) -> BagCollector: ...
    def define(self, topic: str, message: str, encoding: str, language: str, definition: bytes) -> int: ...
    def add(self, channel: int, rows: Sequence[tuple[int, bytes]]) -> None: ...
    def topics(self) -> list[tuple[str, str, int]]: ...
    def finish(self) -> list[tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], list[str], list[_Array]]]: ...

@final
class McapReader:
    """Reads an MCAP file from its beginning to its end."""

    def __new__(cls, path: str | PathLike[str]) -> McapReader: ...
    def advance(self, collector: BagCollector) -> bool: ...
    @property
    def truncated(self) -> bool: ...
    @property
    def damaged(self) -> list[int]: ...

def unpack_file(source: str | PathLike[str], target: str | PathLike[str]) -> None: ...
