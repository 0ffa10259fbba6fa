"""An estimate beside its recording, thinned to the rate of a picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Estimate
from linkside.recording.log import Log
from linkside.robot import Robot

ROWS = 8192


class Excerpt(NamedTuple):
    """Rows of a recording and of its estimate, at the same times."""

    log: Log
    estimate: Estimate

    def residuals(self, robot: Robot) -> dict[str, FloatArray]:
        """Readings less what they must be by the estimate (T,) by column; NaN where nothing was read."""
        log, estimate = self
        found = dict(zip(log.columns("theta"), (log.theta - estimate.theta).T, strict=True))
        if estimate.ddq is not None and log.acceleration is not None:
            must = robot.specific_force(*map(np.ascontiguousarray, (estimate.q, estimate.dq, estimate.ddq)))
            found |= zip(log.columns("acceleration"), (log.acceleration - must).T, strict=True)
        return found


def excerpts(robot: Robot, log: str | Path, estimate: str | Path, rate: float) -> Iterator[Excerpt]:
    """Read both piece by piece, and keep about ``rate`` rows a second.

    Raises
    ------
    LogError
        A file that cannot be read.
    EstimatorError
        The estimate is not of this recording: its times or its joints differ.
    """
    stream = Log.stream(log, robot, ROWS, allow_gaps=True)
    every = max(1, round(1 / (rate * stream.period)))
    first = 0
    estimates = Estimate.stream(estimate, ROWS)
    for piece in stream:
        part = next(estimates, None)
        if (
            part is None
            or len(part) != len(piece)
            or not np.allclose(part.t, piece.t, rtol=0, atol=0.01 * stream.period)
        ):
            raise EstimatorError(
                f"{estimate}: its times are not those of {log}; a log that was resampled is another log"
            )
        if part.names != robot.names:
            raise EstimatorError(f"{estimate}: its joints are {', '.join(part.names)}, not {', '.join(robot.names)}")
        rows = slice((-first) % every, None, every)
        first += len(piece)
        if len(piece.t[rows]):
            yield Excerpt(piece[rows], part[rows])
    if next(estimates, None) is not None:
        raise EstimatorError(f"{estimate}: it has more rows than {log}")
