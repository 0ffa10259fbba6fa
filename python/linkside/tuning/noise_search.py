"""The free values of noise as a vector, and the likelihood of recordings over it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.optimize

from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.channels import CHANNELS, widths
from linkside.errors import EstimatorError, NumericalError
from linkside.kalman.filtering import KalmanEstimate
from linkside.kalman.jerk_driven import ExtendedKalmanFilter
from linkside.kalman.noise import Noise, jerk_scale
from linkside.recording.log import Log
from linkside.recording.motion import moving
from linkside.robot import Robot
from linkside.statistics import long_run_variance

Progress = Callable[[int, float], None]

PER_JOINT = ("jerk", "transmission", "position_walk", "velocity_walk")
PER_SENSOR = {"acceleration": "accelerometers", "rate": "gyroscopes"}
"""Found sensor by sensor where they are given so."""

DESCRIBED = {channel.noise: kind for kind, channel in CHANNELS.items()} | {
    "torsion": "motor",
    "motor_velocity": "motor",
}
"""Kind of the channels whose readings a value of `Noise` describes; the others describe states."""

RESTARTS = 4
HOPELESS = 1e12


@dataclass
class NoiseSearch:
    """The free values as a vector: logarithms of the factor on each one's start."""

    robot: Robot
    logs: Sequence[Log]
    before: Noise
    free: tuple[str, ...]
    settings: dict[str, Any]
    progress: Progress | None
    evaluations: int = 0
    best: float = -np.inf
    best_at: FloatArray = field(init=False)
    entries: list[tuple[str, int | None]] = field(init=False)
    base: Noise = field(init=False)
    start: FloatArray = field(init=False)

    def __post_init__(self) -> None:
        """Lay out the vector."""
        self.base = self._with_arrays()
        joints = np.any([moving(log) for log in self.logs], axis=0)
        self.entries = [(name, member) for name in self.free for member in self._members(name, joints)]
        values = [getattr(self.base, name) for name, _ in self.entries]
        pairs = zip(values, self.entries, strict=True)
        self.start = np.array([value if member is None else value[member] for value, (_, member) in pairs])
        for (name, _), value in zip(self.entries, self.start, strict=True):
            if value <= 0:
                raise EstimatorError(f"free: {name} starts at {value:g}; give it a value above 0 to vary")
        self._jerks = [self.base.for_log(log, self.robot).jerk for log in self.logs]

    def _with_arrays(self) -> Noise:
        """The start, with an entry a joint of what is free joint by joint; jerk is the largest of the logs'."""
        noise = self.before
        if "jerk" in self.free and noise.jerk is None:
            noise = noise.updated(jerk=tuple(np.max([jerk_scale(log) for log in self.logs], axis=0)))
        chosen = [name for name in PER_JOINT if name in self.free]
        return noise.updated(**{n: tuple(per_joint(n, getattr(noise, n), self.robot.n)) for n in chosen})

    def _members(self, name: str, moving: npt.NDArray[np.bool_]) -> list[int | None]:
        """Joints or sensors that a value is found for; None: one for all."""
        if name in PER_SENSOR and isinstance(getattr(self.base, name), tuple):
            return list(range(len(getattr(self.base, name))))
        if name not in PER_JOINT:
            return [None]
        return [joint for joint in range(self.robot.n) if name != "transmission" or moving[joint]]

    @property
    def names(self) -> tuple[str, ...]:
        """What is free, such as ``transmission_axis2``."""
        return tuple(name if member is None else f"{name}_{self._owner(name, member)}" for name, member in self.entries)

    def _owner(self, name: str, member: int) -> str:
        owners = self.robot.names if name in PER_JOINT else [s.name for s in getattr(self.robot, PER_SENSOR[name])]
        return owners[member]

    def noise(self, x: FloatArray) -> Noise:
        """The noise at a vector."""
        changes: dict[str, Any] = {}
        for (name, member), value in zip(self.entries, self.start * np.exp(x), strict=True):
            if member is None:
                changes[name] = float(value)
            else:
                changes.setdefault(name, list(getattr(self.base, name)))[member] = float(value)
        return self.base.updated(**changes)

    def noises(self, x: FloatArray) -> list[Noise]:
        """The same for each log, which has a scale of jerk of its own where that is not free."""
        noise = self.noise(x)
        return [noise if "jerk" in self.free else noise.updated(jerk=jerk) for jerk in self._jerks]

    def filters(self, x: FloatArray) -> list[ExtendedKalmanFilter]:
        """A filter for each log."""
        return [ExtendedKalmanFilter(self.robot, noise, **self.settings) for noise in self.noises(x)]

    def run(self, x: FloatArray, innovations: bool = False) -> list[KalmanEstimate]:
        """Filter every log, one after the other."""
        return [f.run(log, innovations=innovations) for f, log in zip(self.filters(x), self.logs, strict=True)]

    def cost(self, x: FloatArray) -> float:
        """Minus the log-likelihood."""
        try:
            value = total(self.run(x), "log_likelihood")
        except NumericalError:  # this far out the filter diverges
            value = -HOPELESS
        self.note(x, value)
        return -value

    def note(self, x: FloatArray, log_likelihood: float) -> None:
        """Count an evaluation, and remember the best."""
        self.evaluations += 1
        if log_likelihood > self.best:
            self.best, self.best_at = log_likelihood, np.array(x)
        if self.progress is not None:
            self.progress(self.evaluations, self.best)

    def maximise(self, span: tuple[float, float]) -> FloatArray:
        """Look for one factor for all values first, then for each its own."""
        low, high = np.log(span)
        ones = np.ones(len(self.start))

        def together(y: float) -> float:
            return self.cost(y * ones)

        options = {"xatol": 0.05}
        scipy.optimize.minimize_scalar(together, bounds=(low, high), method="bounded", options=options)
        self.cost(0 * ones)
        self._descend((low, high))
        return self.best_at

    def _descend(self, bounds: tuple[float, float]) -> None:
        """Powell's method, restarted at the best point until that gains little, because valleys are narrow."""
        options = {"xtol": 1e-2, "ftol": 1e-9}
        for _ in range(RESTARTS):
            reached = self.best
            scipy.optimize.minimize(
                self.cost, self.best_at, method="Powell", bounds=[bounds] * len(self.start), options=options
            )
            if not self.best - reached > 0.1:
                return

    def widening(self, x: FloatArray) -> FloatArray:
        """The factor on each value that describes readings: the root of its channels' long-run variance, at least 1."""
        by_kind = self._long_run_variances(x)
        factors = np.ones(len(x))
        for index, (name, member) in enumerate(self.entries):
            variances = by_kind.get(DESCRIBED.get(name, ""))
            if variances is not None:
                chosen = variances[self._channels(name, member)]
                factors[index] = np.sqrt(max(1.0, float(np.mean(chosen))))
        return factors

    def _channels(self, name: str, member: int | None) -> slice:
        """Which channels of its kind a value describes."""
        if member is None:
            return slice(None)
        axes = (
            [len(s.axes) for s in getattr(self.robot, PER_SENSOR[name])] if name in PER_SENSOR else [1] * self.robot.n
        )
        first = sum(axes[:member])
        return slice(first, first + axes[member])

    def _long_run_variances(self, x: FloatArray) -> dict[str, FloatArray]:
        """Of each channel's normalised innovations by kind, the mean over the logs that have it."""
        found: dict[str, list[FloatArray]] = {}
        for log, estimate in zip(self.logs, self.run(x, innovations=True), strict=True):
            kinds = ExtendedKalmanFilter(self.robot, **self.settings).kinds(log)
            assert estimate.innovation is not None
            assert estimate.innovation_std is not None
            normalised = estimate.innovation / estimate.innovation_std
            ends = np.cumsum(widths(self.robot, kinds))
            for kind, part in zip(kinds, np.split(normalised, ends[:-1], axis=1), strict=True):
                found.setdefault(kind, []).append(np.array([long_run_variance(channel) for channel in part.T]))
        return {kind: np.mean(variances, axis=0) for kind, variances in found.items() if variances[0].size}

    def score(self, x: FloatArray) -> tuple[float, float]:
        """Log-likelihood, and normalised innovation squared per reading."""
        estimates = self.run(x)
        return total(estimates, "log_likelihood"), total(estimates, "nis") / total(estimates, "used")


def total(estimates: Sequence[KalmanEstimate], name: str) -> float:
    """Sum of a quantity over all samples of several recordings."""
    return float(sum(getattr(estimate, name).sum() for estimate in estimates))
