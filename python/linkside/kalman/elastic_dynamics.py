"""What Kalman filters and smoothers on the elastic-joint dynamics share, whatever moves the motors."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from linkside import _core
from linkside.arrays import FloatArray
from linkside.recording.batch import Job
from linkside.recording.log import Log
from linkside.robot.considered import Uncertain, core_settings

from .filtering import KalmanEstimate, KalmanMethod
from .late_sensors import inside
from .link_disturbance import LinkDisturbance
from .start import Moving, Readings
from .starting import DecidingFilter, first_readings, in_pieces

Arrays = tuple[FloatArray, FloatArray, FloatArray]


class OnElasticDynamics(KalmanMethod):
    """State: link positions and velocities, the same of elastic joints' motors, friction elements, and more."""

    _uncertain: list[Uncertain]

    _run_all = staticmethod(_core.ElasticJointFilter.run_all)

    def _job(self, log: Log, law: LinkDisturbance | None = None) -> Job[KalmanEstimate]:
        kinds = self.kinds(log)
        arrays = self.arrays(log, kinds)
        core = self.started_core(kinds, log, first_readings(log), law)
        return Job(log, core, arrays, partial(self._estimate, log, kinds))

    @abstractmethod
    def started_core(
        self, kinds: tuple[str, ...], log: Log, first: Readings, law: LinkDisturbance | None = None
    ) -> _core.ElasticJointFilter:
        """Build a filter of the core that starts where the ``first`` samples say."""

    @abstractmethod
    def arrays(self, log: Log, kinds: tuple[str, ...], before: Log | None = None) -> Arrays:
        """Steps of time, readings and what moves the motors, one row a sample, for the core's filter."""

    def _relaxed(self, kinds: tuple[str, ...]) -> bool:
        """Whether friction elements start relaxed: no sensor tells where links are, so that noise would move them."""
        return "q" not in kinds

    def _counts(self, one: Uncertain, kinds: tuple[str, ...]) -> bool:
        """Whether a parameter is one of known tolerance: not the past of friction elements that is estimated."""
        return one.kind != "hysteresis" or self._relaxed(kinds)

    def _begun(
        self, moving: Moving, arrays: Mapping[str, Any], kinds: tuple[str, ...]
    ) -> tuple[list[FloatArray], list[FloatArray]]:
        """Mean and standard deviations of links, motors and friction elements of a robot that is moving, one by one."""
        elastic = self.robot.elastic
        motors = np.hypot(arrays["reading"][: self.robot.n], self.noise.position)
        reach = [element.reach for drive in self.robot.drives for element in drive.hysteresis]
        mean = [moving.q, moving.dq, moving.theta[elastic], moving.dtheta[elastic], np.zeros(len(reach))]
        std = [moving.q_std, moving.dq_std, motors[elastic], moving.dtheta_std[elastic]]
        gone = _core.RELAXED if self._relaxed(kinds) else 1.0
        std.append(gone * np.array(reach) / np.sqrt(3))  # anywhere between the limits, or near the middle
        return mean, std

    def _tied(self, covariance: FloatArray, moving: Moving) -> FloatArray:
        """Links stand where springs hold what friction elements do not."""
        k = 2 * (self.robot.n + int(self.robot.elastic.sum()))
        for j, drive in enumerate(self.robot.drives):
            for element in drive.hysteresis:
                nearer = element.stiffness / (drive.stiffness or np.inf) * covariance[k, k]
                covariance[j, j] += nearer**2 / covariance[k, k]
                covariance[j, k] = covariance[k, j] = nearer
                k += 1
        return covariance

    def _common(self, kinds: tuple[str, ...], period: float, noise: Any, law: LinkDisturbance | None) -> dict[str, Any]:
        """Describe what filters of the core have in common, in plain numbers."""
        return {
            **self._channels(kinds),
            "relaxed": self._relaxed(kinds),
            "noise": noise.arrays(self.robot, kinds),
            "gate": self._gate,
            "iterations": self._iterations,
            "late": inside(self.robot, kinds, period),
            **core_settings(self.robot, [one for one in self._uncertain if self._counts(one, kinds)]),
            "losses": self._loss_names(kinds),
            "points": self._points,
            "link_disturbance": None if law is None else law.arrays,
            "wrenches": self._wrench_law,
        }

    def _sampled(self, log: Log, kinds: tuple[str, ...], before: Log | None) -> tuple[FloatArray, FloatArray]:
        """Steps of time and readings, one row a sample; ``before`` ends with the last sample before."""
        readings = np.hstack([log.theta if kind == "motor" else getattr(log, kind) for kind in kinds])
        dt = np.diff(log.t, prepend=log.t[0] - log.period if before is None else before.t[-1])
        return dt, np.ascontiguousarray(readings)


class LiveOnElasticDynamics(OnElasticDynamics, DecidingFilter[_core.ElasticJointFilter]):
    """The same of a filter, sample by sample."""

    @property
    def live_kinds(self) -> tuple[str, ...]:
        """Kinds of channels that `step` takes."""
        there = {"acceleration": bool(self.robot.acceleration_channels), "dtheta": True}
        wanted = {kind: there.get(kind, False) if asked is None else asked for kind, asked in self._wanted.items()}
        return ("motor", *(kind for kind, use in wanted.items() if use))

    def run_pieces(self, pieces: Iterable[Log]) -> Iterator[KalmanEstimate]:
        """Estimate a recording piece by piece, in bounded memory; bit-identical to `run`.

        The first piece decides whether disturbance torques are estimated, and the scale of jerk where ``noise`` does
        not give one that the model has.
        """
        self.refuse_pieces()

        def start(piece: Log, first: Readings) -> tuple[_core.ElasticJointFilter, tuple[str, ...]]:
            kinds = self.kinds(piece)
            return self.started_core(kinds, piece, first, self.law(piece)), kinds

        def run(
            core: _core.ElasticJointFilter, kinds: tuple[str, ...], piece: Log, before: Log | None
        ) -> dict[str, Any]:
            return core.run(self.arrays(piece, kinds, before))

        return in_pieces(pieces, start, run, self._estimate)
