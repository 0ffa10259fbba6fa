"""Smoothing of a stream, a few samples late."""

from __future__ import annotations

from collections import deque
from itertools import islice
from typing import Any

import numpy as np

from linkside import _core
from linkside.arguments import finite_or_missing, sized, time_step, whole
from linkside.arrays import FloatArray, Signal
from linkside.errors import EstimatorError, NumericalError
from linkside.recording.batch import Copies
from linkside.robot import Robot

from .filtering import KalmanEstimate
from .jerk_driven import Arrays, ExtendedKalmanFilter
from .noise import Noise
from .start import WINDOW, Readings


class FixedLagSmoother(Copies):
    """Smoother for a stream: the estimate of ``lag`` samples ago by all samples since.

    Each step runs backwards over ``lag`` samples. A lag much longer than the filter's memory gains little.

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
    """

    _cores = ("_before",)

    def __init__(self, robot: Robot, noise: Noise | None = None, *, lag: int, **settings: Any) -> None:
        self.robot, self.lag = robot, whole("lag", lag, least=1)
        self._filter = ExtendedKalmanFilter(robot, noise, **settings)
        self._kinds = self._filter.live_kinds
        self.reset()

    def _described(self) -> dict[str, Any]:
        return {"lag": self.lag}

    def reset(self) -> None:
        """Reset: the next `step` starts from the beginning."""
        law = self._filter.live_law
        self._before = self._filter.core(self._kinds, self._filter.noise_for(None, law), np.inf, law)
        self._window: deque[tuple[float, FloatArray, FloatArray, FloatArray]] = deque()
        self._ddqref: FloatArray | None = None
        self._period = np.inf  # the first step of time says how many samples a delay spans
        self._t, self._count = 0.0, 0

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
        time_step(dt)
        reading = self._reading(theta, acceleration, further)
        moved = self._moved(dt, dtheta, ddqref)
        before = self._period, self._ddqref
        self._period = self._period if self._count else dt
        self._ddqref = None if ddqref is None else sized("ddqref", ddqref, self.robot.n)
        self._window.append((dt, reading, *moved))
        self._count += 1
        try:
            return self._advanced()
        except EstimatorError:
            self._window.pop()
            self._count -= 1
            self._period, self._ddqref = before
            raise
        except NumericalError:
            self.reset()
            raise

    def _advanced(self) -> _core.State | None:
        """The state ``lag`` samples ago, if there is one; older samples are dropped."""
        if self._count <= WINDOW:
            self._begin()
        row = len(self._window) - 1 - self.lag
        if row < 0:
            return None
        t = self._t + sum(sample[0] for sample in islice(self._window, 1, row + 1))
        arrays = self._stacked(len(self._window))
        state = _core.StretchSmoother(self._before).row(self._before, arrays, row, t)
        # While the first samples decide where the filter starts, none can be forgotten.
        while self._count >= WINDOW and len(self._window) > self.lag:
            self._forget()
        return state

    def flush(self) -> KalmanEstimate | None:
        """Return the estimate of the last ``lag`` samples at the end of a stream, and reset."""
        done = max(len(self._window) - self.lag, 0)
        estimate = self._back(slice(done, None)) if self._window else None
        self.reset()
        return estimate

    def __copy__(self) -> FixedLagSmoother:
        """Copy the state, the samples that wait included."""
        other: FixedLagSmoother = super().__copy__()
        other._window = self._window.copy()
        return other

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restart."""
        vars(self).update(state)
        self.reset()

    def _reading(self, theta: Signal, acceleration: Signal | None, further: Signal | None) -> FloatArray:
        motors = sized("theta", theta, self.robot.n)
        if not self._count and np.isnan(motors).any():
            joint = self.robot.names[int(np.argmax(np.isnan(motors)))]
            raise EstimatorError(
                f"the first sample of theta of joint {joint} is missing; a filter cannot start without"
            )
        channels, *others = (self._filter.width(kind) for kind in self._kinds[1:])
        rest = (sized("acceleration", acceleration, channels), sized("further", further, sum(others)))
        parts = zip(("theta", "acceleration", "further"), (motors, *rest), strict=True)
        return np.concatenate([finite_or_missing(name, values) for name, values in parts])

    def _moved(self, dt: float, dtheta: Signal | None, ddqref: Signal | None) -> tuple[FloatArray, FloatArray]:
        """Motor velocities, and the commanded jerk since the sample before."""
        now = None if ddqref is None else sized("ddqref", ddqref, self.robot.n)
        jerk = np.zeros(self.robot.n)
        if now is not None and self._ddqref is not None:
            jerk = np.nan_to_num((now - self._ddqref) / dt, posinf=0.0, neginf=0.0)
        return sized("dtheta", dtheta, self.robot.n), jerk

    def _begin(self) -> None:
        """Let the filter before the window start where the samples so far say."""
        readings = np.array([row[1] for row in self._window])
        dtheta = np.array([row[2] for row in self._window])
        n, sensors = self.robot.n, self._filter.width("acceleration")
        first = Readings(
            np.cumsum([row[0] for row in self._window]),
            readings[:, :n],
            None if np.isnan(dtheta).all() else dtheta,
            None if np.isnan(readings[:, n : n + sensors]).all() else readings[:, n : n + sensors],
        )
        law = self._filter.live_law
        noise = self._filter.noise_for(None, law)
        self._before = self._filter.started_core(self._kinds, noise, first, self._period, law)

    def _back(self, rows: slice) -> KalmanEstimate:
        """Rows of the window, smoothed."""
        arrays = self._stacked(len(self._window))
        result = _core.StretchSmoother(self._before).back(self._before, arrays, True)
        t = self._t + np.cumsum(arrays[0]) - arrays[0][0]
        first: dict[str, Any] = {name: a[rows] for name, a in result.items() if name != "findings"}
        return KalmanEstimate(t=t[rows], names=self.robot.names, left_out=self._filter.left_out, **first)

    def _forget(self) -> None:
        """Let the filter before the window take the window's first sample."""
        self._before.run(self._stacked(1), False, False)
        self._window.popleft()
        self._t += self._window[0][0]

    def _stacked(self, count: int) -> Arrays:
        rows = [self._window[index] for index in range(count)]
        dt, readings, dtheta, jerk = (np.array(column) for column in zip(*rows, strict=True))
        return dt, readings, dtheta, jerk
