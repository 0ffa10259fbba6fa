"""A filter and a delay inside an accelerometer, undone: every reading at the time that it is of."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.recording.estimate import Status
from linkside.robot import Robot

Arrays = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


def is_late(robot: Robot) -> bool:
    """Whether an accelerometer has a filter or a delay inside."""
    return any(sensor.corner_frequency or sensor.delay for sensor in robot.accelerometers)


def unfiltered(robot: Robot, readings: FloatArray, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Undo the accelerometers' filters.

    A filter with time constant T turns a specific force f that runs straight over a sample of h into
    y = α y₋ + c₀ f₋ + c₁ f with α = exp(-h/T). So (y - α y₋)/(1 - α) is f as it was c₀ h/(1 - α) before, to second
    order in h, and noise that entered behind the filter has (1 + α²)/(1 - α)² times its variance.

    Parameters
    ----------
    readings : (T, m)
        Accelerometer channels, evenly sampled.

    Returns
    -------
    readings : (T, m)
        Without the filters.
    lag : (m,)
        How long before its time stamp each reading was true: the filter's part and the declared delay [s].
    noise : (m,)
        Factor on the noise's standard deviation.
    """
    sensors = [sensor for sensor in robot.accelerometers for _ in sensor.axes]
    # A corner above any that matters stands for no filter: α is zero.
    constant = np.array([1 / (2 * np.pi * s.corner_frequency) if s.corner_frequency else 0.0 for s in sensors])
    there = constant > 0
    alpha = np.exp(-period / np.where(there, constant, np.inf)) * there
    before = np.vstack([readings[:1], readings[:-1]])
    kept = np.where(there, alpha * before, 0.0)
    lag = np.where(there, constant - period * alpha / (1 - alpha), 0.0) + [s.delay for s in sensors]
    return (readings - kept) / (1 - alpha), lag, np.sqrt(1 + alpha**2) / (1 - alpha)


@dataclass(frozen=True)
class Schedule:
    """Samples of a log, and between them the moments at which late readings were true, in order of time.

    Attributes
    ----------
    t : (T,)
        Times of the samples.
    lag : (channels,)
        How late each channel's readings are [s].
    """

    t: FloatArray
    lag: FloatArray

    @cached_property
    def lags(self) -> FloatArray:
        """The different lags; the first is zero, of the samples themselves."""
        return np.unique(np.concatenate([[0.0], self.lag]))

    @cached_property
    def order(self) -> npt.NDArray[np.intp]:
        """Moments by lag and row, flattened, in order of time from the first sample on."""
        times = (self.t[None, :] - self.lags[:, None]).ravel()
        order = np.argsort(times, kind="stable")
        # What was true before the first sample has nothing to start from.
        return order[int(np.flatnonzero(order == 0)[0]) :]

    def spread(
        self, arrays: tuple[FloatArray, ...], period: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Rows for the filter from rows of samples: steps of time, readings, motor velocities, jerk."""
        _, readings, dtheta, jerk = arrays
        group, row = np.divmod(self.order, len(self.t))
        times = self.t[row] - self.lags[group]
        own = self.lags[group][:, None] == self.lag[None, :]
        dt = np.diff(times, prepend=times[0] - period)
        interval = np.searchsorted(self.t, times)
        velocity = np.where(group[:, None] == 0, dtheta[row], np.nan)
        return dt, np.where(own, readings[row], np.nan), velocity, np.ascontiguousarray(jerk[interval])

    def gather(self, result: dict[str, Any], readings: FloatArray) -> dict[str, Any]:
        """Rows of samples from the filter's: each with what was used since the sample before."""
        group, row = np.divmod(self.order, len(self.t))
        samples = np.flatnonzero(group == 0)
        out = {name: np.ascontiguousarray(values[samples]) for name, values in result.items()}
        starts = np.concatenate([[0], samples[:-1] + 1])
        for name in ("nis", "used", "log_likelihood"):
            out[name] = np.add.reduceat(result[name], starts).astype(result[name].dtype)
        gated = np.bitwise_or.reduceat(result["status"], starts) & Status.GATED
        missing = np.isnan(readings).any(axis=1) * Status.BRIDGED
        out["status"] = (gated | missing | (out["used"] == 0) * Status.PREDICTED).astype(np.uint8)
        for name in ("innovation", "innovation_std"):
            if name in result:
                for lag in self.lags[1:]:
                    moments = self.lags[group] == lag
                    late = self.lag == lag
                    out[name][:, late] = np.nan
                    out[name][np.ix_(row[moments], late)] = result[name][np.ix_(moments, late)]
        return out
