"""What is known of the links' errors, by all repeats."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Estimate
from linkside.recording.times import counterparts
from linkside.statistics import rms

from .loop import Motion

ORDINARY = 0.1
"""Share of the first repeat's error up to which a standard deviation is that of an ordinary row."""


@dataclass(frozen=True, eq=False)
class Seen:
    """Errors of the links in one repeat, their standard deviations, and where they are known, (T, n) each.

    ``tool_std`` is the standard deviation of the tool's position, rms [m].
    """

    error: FloatArray
    std: FloatArray
    known: npt.NDArray[np.bool_]
    tool_std: float | None

    @classmethod
    def of(cls, motion: Motion, estimate: Estimate) -> Seen:
        """Compare an estimate with the motion; rows that are not good are not known.

        Raises
        ------
        EstimatorError
            Without a row for each time of the motion, or without a good row.
        """
        rows = counterparts(motion.t - motion.t[0], estimate.t - estimate.t[0], "the estimate")
        q = estimate.q[rows]
        good = (estimate.status[rows] == 0) & np.isfinite(q).all(axis=1)
        if not good.any():
            raise EstimatorError("the estimate has no good row during the motion: nothing can be learnt from it")
        std = np.zeros_like(q) if estimate.q_std is None else estimate.q_std[rows]
        known = np.broadcast_to(good[:, None], q.shape)
        tool = estimate.tool_std
        return cls(
            np.where(known, motion.q - q, 0.0),
            np.where(known, std, 0.0),
            known,
            None if tool is None else rms(np.linalg.norm(tool[rows[good]], axis=1)),
        )

    def sizes(self, of: FloatArray) -> tuple[float, ...]:
        """Root mean square of a signal over the known rows, by joint."""
        return tuple(float(rms(column[known])) for column, known in zip(of.T, self.known.T, strict=True))


@dataclass(frozen=True, eq=False)
class Belief:
    """Errors to expect of the next repeat and their variances, (T, n) each; infinite where no repeat has shown any.

    A Kalman filter from repeat to repeat for each row: what earlier repeats have shown counts beside the new estimate
    as far as it is as certain. A row that one repeat lacks is so known by others, and a row that is always as uncertain
    always counts the same, so that learning has one limit.
    """

    error: FloatArray
    variance: FloatArray

    @classmethod
    def none(cls, motion: Motion) -> Belief:
        """Before the first repeat."""
        return cls(np.zeros_like(motion.q), np.full_like(motion.q, np.inf))

    def told(self, seen: Seen) -> Belief:
        """Take in the errors of a repeat."""
        variance = seen.std**2
        total = self.variance + variance
        comparable = np.isfinite(total) & (total > 0)
        share = np.where(seen.known, 1.0, 0.0)  # all of an estimate without a standard deviation, or without an earlier
        share[comparable] *= self.variance[comparable] / total[comparable]
        error = self.error + share * (seen.error - self.error)
        return Belief(error, np.where(seen.known, share * variance, self.variance))

    def after(self, step: FloatArray) -> Belief:
        """Expect the next repeat after links were moved by ``step``, by the model: right to within the step's size."""
        return replace(self, error=self.error - step, variance=self.variance + np.mean(step**2, axis=0))

    def weight(self, first: FloatArray) -> FloatArray:
        """How much rows count, (T, n): less where their standard deviation is larger than usual.

        And not small beside the ``first`` repeat's errors, (n,): what all repeats have in common, as of a wrong
        stiffness, differs from row to row and is no noise.
        """
        std = np.sqrt(self.variance)
        known = np.isfinite(std)
        usual = np.array([np.median(s[k]) if k.any() else 0.0 for s, k in zip(std.T, known.T, strict=True)])
        ordinary = np.maximum(usual, ORDINARY * first)
        large = known & (std > ordinary)
        share = known.astype(float)
        share[large] = (np.broadcast_to(ordinary, std.shape)[large] / std[large]) ** 2
        return share
