"""Smoothing of a stream, a few samples late."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.errors import EstimatorError, NumericalError
from linkside.recording.batch import Copies
from linkside.robot import Robot

from .filtering import KalmanEstimate, Signal, sized
from .jerk_driven import Arrays, ExtendedKalmanFilter
from .noise import Noise

FloatArray = npt.NDArray[np.float64]


class FixedLagSmoother(Copies):
    """Smoother for a stream: the estimate of ``lag`` samples ago by all samples since.

    Each step costs the way back over ``lag`` samples. Little is gained by a lag much longer than it takes the filter to
    forget a reading.

    Parameters
    ----------
    robot, noise, **settings
        As of `ExtendedKalmanFilter`.
    lag
        Samples to wait for, at least 1.

    Raises
    ------
    EstimatorError
        Settings out of range, or sensors whose readings come late.
    """

    _cores = ("_before",)

    def __init__(self, robot: Robot, noise: Noise | None = None, *, lag: int, **settings: Any) -> None:
        if not isinstance(lag, int) or lag < 1:
            raise EstimatorError(f"lag is {lag!r}, expected a whole number of at least 1")
        self.robot, self.lag = robot, lag
        self._filter = ExtendedKalmanFilter(robot, noise, **settings)
        self._filter._refuse_late("a fixed-lag smoother")
        self._kinds = self._filter._live_kinds
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next `step` starts anew."""
        self._before = self._filter._core(self._kinds, self._filter.noise)
        self._window: deque[tuple[float, FloatArray, FloatArray, FloatArray]] = deque()
        self._ddqref: FloatArray | None = None
        self._begun = False
        self._t = 0.0

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
        if not 0 < dt < np.inf:
            raise EstimatorError(f"dt is {dt}, expected a positive, finite time in seconds")
        reading = self._reading(theta, acceleration, further)
        moved = self._moved(dt, dtheta, ddqref)
        self._window.append((dt, reading, *moved))
        self._begun = True
        self._ddqref = None if ddqref is None else sized("ddqref", ddqref, self.robot.n)
        if len(self._window) <= self.lag:
            return None
        try:
            state = _core.StretchSmoother(self._before).first(self._before, self._stacked(len(self._window)), self._t)
            self._forget()
        except NumericalError:
            self.reset()
            raise
        return state

    def flush(self) -> KalmanEstimate | None:
        """At the end of a stream, the estimate of the last ``lag`` samples; then start anew."""
        estimate = self._back(len(self._window)) if self._window else None
        self.reset()
        return estimate

    def __copy__(self) -> FixedLagSmoother:
        """Copy the state, the samples that wait included."""
        other: FixedLagSmoother = super().__copy__()
        other._window = self._window.copy()
        return other

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start anew."""
        vars(self).update(state)
        self.reset()

    def _reading(self, theta: Signal, acceleration: Signal | None, further: Signal | None) -> FloatArray:
        motors = sized("theta", theta, self.robot.n)
        if not self._begun and np.isnan(motors).any():
            joint = self.robot.names[int(np.argmax(np.isnan(motors)))]
            raise EstimatorError(
                f"the first sample of theta of joint {joint} is missing; a filter cannot start without"
            )
        channels, *others = (self._filter._width(kind) for kind in self._kinds[1:])
        rest = (sized("acceleration", acceleration, channels), sized("further", further, sum(others)))
        for name, values in zip(("theta", "acceleration", "further"), (motors, *rest), strict=True):
            if np.isinf(values).any():
                raise EstimatorError(f"{name} is {values}, expected finite numbers, or NaN where a reading is missing")
        return np.concatenate((motors, *rest))

    def _moved(self, dt: float, dtheta: Signal | None, ddqref: Signal | None) -> tuple[FloatArray, FloatArray]:
        """Motor velocities, and the commanded jerk since the sample before."""
        now = None if ddqref is None else sized("ddqref", ddqref, self.robot.n)
        jerk = np.zeros(self.robot.n)
        if now is not None and self._ddqref is not None:
            jerk = np.nan_to_num((now - self._ddqref) / dt, posinf=0.0, neginf=0.0)
        return sized("dtheta", dtheta, self.robot.n), jerk

    def _back(self, rows: int) -> KalmanEstimate:
        """The window's first rows, smoothed."""
        arrays = self._stacked(len(self._window))
        result = _core.StretchSmoother(self._before).back(self._before, arrays, True)
        t = self._t + np.cumsum(arrays[0]) - arrays[0][0]
        first: dict[str, Any] = {name: a[:rows] for name, a in result.items()}
        return KalmanEstimate(t=t[:rows], names=self.robot.names, **first)

    def _forget(self) -> None:
        """Let the filter before the window take the window's first sample."""
        self._before.run(self._stacked(1), False, False)
        self._window.popleft()
        self._t += self._window[0][0]

    def _stacked(self, count: int) -> Arrays:
        rows = [self._window[index] for index in range(count)]
        dt, readings, dtheta, jerk = (np.array(column) for column in zip(*rows, strict=True))
        return dt, readings, dtheta, jerk
