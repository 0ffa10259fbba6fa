"""Smoothing of a stream, a few samples late."""

from __future__ import annotations

from typing import Any

import numpy as np

from linkside import _core
from linkside.arguments import sized, whole
from linkside.arrays import Signal
from linkside.errors import EstimatorError, NumericalError
from linkside.recording.batch import Copies
from linkside.robot import Robot

from .filtering import KalmanEstimate
from .jerk_driven import ExtendedKalmanFilter
from .noise import Noise
from .start import WINDOW
from .starting import early_readings, own_sample


class FixedLagSmoother(Copies):
    """Smoother for a stream: estimates the state ``lag`` samples ago from all samples up to now.

    A step costs the same whatever the lag. A lag much longer than the filter's memory gains little.

    Parameters
    ----------
    robot, noise, **settings
        As of `ExtendedKalmanFilter`.
    lag
        Samples to wait for, at least 1.

    Raises
    ------
    EstimatorError
        Settings out of range.

    Notes
    -----
    Each time step is a regression of the state before it on the state after it (Rauch, Tung and Striebel 1965).
    Regressions over half a lag are kept combined (Särkkä and García-Fernández 2021), so that each `step` combines only
    a few.

    A fault that is found flags all rows that are still within the lag, because it began earlier.
    """

    _cores = ("_core",)

    def __init__(self, robot: Robot, noise: Noise | None = None, *, lag: int, **settings: Any) -> None:
        self.robot, self.lag = robot, whole("lag", lag, least=1)
        self._filter = ExtendedKalmanFilter(robot, noise, **settings)
        self.reset()

    def _described(self) -> dict[str, Any]:
        return {"lag": self.lag}

    def reset(self) -> None:
        """Reset: the next `step` starts from the beginning."""
        self._core: _core.FixedLagSmoother | None = None
        self._early: list[dict[str, Any]] = []

    def step(
        self,
        *,
        dt: float,
        theta: Signal,
        acceleration: Signal | None = None,
        dtheta: Signal | None = None,
        ddqref: Signal | None = None,
        further: Signal | None = None,
    ) -> _core.State | None:
        """Take one sample, as `ExtendedKalmanFilter.step` does.

        Returns
        -------
        State or None
            The state ``lag`` samples ago, with ``state`` and ``covariance``; ``t`` counts from 0 at the first sample.
            None while there are not enough samples.
        """
        try:
            if self._core is not None and len(self._early) >= WINDOW:
                return self._core.step(dt, theta, acceleration, dtheta, ddqref, further)
            signals = {"theta": theta, "acceleration": acceleration, "dtheta": dtheta, "ddqref": ddqref}
            return self._decide(own_sample({"dt": dt, **signals, "further": further}))
        except NumericalError:
            self.reset()
            raise

    def _decide(self, sample: dict[str, Any]) -> _core.State | None:
        """Take one of the first samples, which decide where the filter starts: all so far once more from there."""
        samples = [*self._early, sample]
        core = self._started(samples)
        for early in samples:
            state = core.step(**early)
        self._core, self._early = core, samples
        return state

    def _started(self, samples: list[dict[str, Any]]) -> _core.FixedLagSmoother:
        """A smoother that starts where these first samples say."""
        motors = np.isnan(sized("theta", samples[0]["theta"], self.robot.n))
        if motors.any():
            joint = self.robot.names[int(np.argmax(motors))]
            raise EstimatorError(
                f"the first sample of theta of joint {joint} is missing; a filter cannot start without"
            )
        live, first = self._filter, early_readings(self.robot, samples)
        law, period = live.live_law, samples[0]["dt"]  # the first step of time says how many samples a delay spans
        started = live.started_core(live.live_kinds, live.noise_for(None, law), first, period, law)
        return _core.FixedLagSmoother(started, self.lag)

    def flush(self) -> KalmanEstimate | None:
        """Return the estimate of the last ``lag`` samples at the end of a stream, and reset."""
        if self._core is None:
            return None
        result: dict[str, Any] = self._core.flush()
        self.reset()
        del result["findings"]
        return self._filter.told(**result)

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restart."""
        vars(self).update(state)
        self.reset()
