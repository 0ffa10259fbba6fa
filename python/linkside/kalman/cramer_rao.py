"""How good an estimate can get: the Cramér–Rao bound along a motion, before anything is estimated."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from rich.console import RenderableType

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Estimate, result_of
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.statistics import rms
from linkside.text import Titled

from .jerk_driven import IteratedSmoother
from .noise import Noise
from .starting import first_readings


@dataclass(frozen=True, eq=False)
class Bound:
    """Least standard deviations that an unbiased estimate can have at each sample.

    Attributes
    ----------
    t : (T,)
        Time [s].
    names : tuple of str
        The n joints.
    filter_q, smoother_q : (T, n)
        Of link positions, by the samples up to each one, and by all [rad].
    filter_tool, smoother_tool : (T, 3), optional
        Of the tool [m].
    """

    t: FloatArray
    names: tuple[str, ...]
    filter_q: FloatArray
    smoother_q: FloatArray
    filter_tool: FloatArray | None = None
    smoother_tool: FloatArray | None = None

    def tables(self) -> Iterator[RenderableType]:
        """Tabulate the bounds of a filter and a smoother, as root mean squares over the motion."""
        table = Titled(
            "no estimate can be better: Cramér–Rao bound, RMS along the log",
            ("", "filter", "smoother", "smoother, worst"),
        )
        rows = [
            (f"{name} [µrad]", 1e6, self.filter_q[:, j], self.smoother_q[:, j]) for j, name in enumerate(self.names)
        ]
        if self.filter_tool is not None and self.smoother_tool is not None:
            sizes = [np.linalg.norm(std, axis=1) for std in (self.filter_tool, self.smoother_tool)]
            rows.append(("tool [mm]", 1e3, *sizes))
        for name, unit, filtered, smoothed in rows:
            values = (rms(filtered), rms(smoothed), float(smoothed.max()))
            table.add_row(name, *(f"{unit * value:.3g}" for value in values))
        yield table


def bound(robot: Robot, log: Log, motion: Estimate | None = None, noise: Noise | None = None) -> Bound:
    """Find the least standard deviations along a motion on the jerk-driven model.

    Tichavský, Muravchik and Nehorai (1998), with the derivatives of the dynamics at the motion itself: the accuracy
    that sensors and noise allow there, whatever the readings. A larger error is due to the method; a smaller one is due
    to chance, or to a method that uses more than the model.

    Parameters
    ----------
    robot
        With its sensors, whose noise counts; tolerances do not.
    log
        Says which readings there are and when. Their values matter only where ``motion`` or ``noise`` is not given, and
        for the damping torque where the log has no motor velocities.
    motion
        The motion, a truth for example, with ``q``, ``dq`` and ``ddq`` at the log's samples; by default the estimate of
        `IteratedSmoother`.
    noise
        As of `ExtendedKalmanFilter`.

    Raises
    ------
    EstimatorError
        A motion of other samples, or one that lacks accelerations.
    """
    method = IteratedSmoother(robot, noise, tolerances=False, link_disturbance=False)
    motion = method.run(log) if motion is None else motion
    if len(motion.t) != len(log) or motion.ddq is None:
        what = "no ddq" if motion.ddq is None else f"{len(motion.t)} samples"
        raise EstimatorError(f"motion has {what}, expected q, dq and ddq at the {len(log)} samples of the log")
    path = np.ascontiguousarray(np.hstack([motion.q, motion.dq, motion.ddq]))
    if not np.isfinite(path).all():
        row = int(np.argmin(np.isfinite(path).all(axis=1)))
        raise EstimatorError(f"motion is not finite at sample {row}, expected q, dq and ddq at every sample")
    kinds = method.kinds(log)
    core = method.started_core(kinds, method.noise_for(log, None), first_readings(log), log.period)
    core.linearise_along(path)
    job = [(core, method.arrays(log, kinds))]
    filtered, smoothed = (
        result_of(log.source, _core.ExtendedKalmanFilter.run_all(job, way, False, False)[0])
        for way in ("filter", "smooth")
    )
    return Bound(
        log.t, robot.names, filtered["q_std"], smoothed["q_std"], filtered.get("tool_std"), smoothed.get("tool_std")
    )
