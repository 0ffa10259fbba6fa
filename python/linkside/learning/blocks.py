"""The quadratic program of a step within limits, sparse along the motion.

Norm-optimal learning with constraints: S. Mishra, U. Topcu and M. Tomizuka, "Optimization-based constrained iterative
learning control", IEEE Transactions on Control Systems Technology 19, 2011. The step may differ from that without
limits by an input that is constant over blocks of samples. The states between blocks are variables, too, so that the
program is as sparse as one of optimal control, and its solution takes time in proportion to the length of the motion.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError

from .loop import Loop

CLOSE = 1e-6
"""Accuracy of the solution, relative; steps stay away from limits by more."""

PER_PERIOD = 10
"""Blocks in a period of the bandwidth up to which is learnt."""


class BlockProgram:
    """What limits cost: ‖C x‖² + ‖w‖² in the step's weights, for an input w that is constant over blocks.

    Parameters
    ----------
    loop
        The closed loop, with s states.
    weight : (T, n)
        Of the links' errors.
    cost : float
        Of the input.
    bandwidth
        Up to which is learnt [Hz].

    Attributes
    ----------
    size : int
        Samples of a block.
    first : (N,)
        First sample of each block.
    """

    def __init__(self, loop: Loop, weight: FloatArray, cost: float, bandwidth: float) -> None:
        self._loop, (count, n) = loop, weight.shape
        self.size = max(1, int(1 / (PER_PERIOD * bandwidth * loop.period)))
        self.first = np.arange(0, count, self.size)
        padded = np.zeros((len(self.first) * self.size, n))
        padded[:count] = weight
        # w = (ρ + λ)^(-1/2) w', which costs as much as errors.
        self._unit = cost**-0.5
        self._transition, self._hessian = self._over_blocks(padded.reshape(len(self.first), self.size, n))

    def constant(self, w: FloatArray, count: int) -> FloatArray:
        """The input of each sample, (T, n), by that of each block."""
        return np.repeat(w, self.size, axis=0)[:count]

    def solve(self, low: FloatArray, high: FloatArray, scale: float) -> FloatArray | None:
        """The input (N, n) of least cost with deviations (N, 4, n) between ``low`` and ``high``; None without any.

        Deviations are of position, velocity and torque at the blocks' ends, and of the acceleration in blocks.
        ``scale`` is what positions are of the size of [rad].
        """
        import clarabel
        from scipy import sparse

        loop, (blocks, _, n), s = self._loop, low.shape, len(self._loop.entry)
        width = s + n
        hessian, equal = self._sparse()
        rows = np.zeros((4 * n, width))
        # A block's end is the start of the next; its position and velocity are those of its state.
        gains = np.abs(loop.torque).max(axis=1)
        rows[:n, :s], rows[n : 2 * n, :s] = loop.command, loop.rate
        rows[2 * n : 3 * n, s:], rows[3 * n :, :s] = np.eye(n), loop.torque / gains[:, None]
        unit = np.ones((4, n))
        unit[2], unit[3] = 1 / self._unit, 1 / gains
        tall = sparse.kron(sparse.eye(blocks), rows, format="csc")
        a, b = [equal], [np.zeros(blocks * s)]
        for sign, bound in ((1.0, high), (-1.0, -low)):
            wide = (bound * unit / scale).reshape(-1)
            kept = np.isfinite(wide)
            a.append(sign * tall[kept])
            b.append(wide[kept])
        cones = [clarabel.ZeroConeT(blocks * s), clarabel.NonnegativeConeT(sum(len(one) for one in b[1:]))]
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads = False, 1
        settings.tol_feas, settings.tol_gap_rel, settings.tol_gap_abs = CLOSE, CLOSE, CLOSE
        solver = clarabel.DefaultSolver(
            hessian, np.zeros(blocks * width), sparse.vstack(a, format="csc"), np.concatenate(b), cones, settings
        )
        found = solver.solve()
        if found.status not in (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved):
            return None
        w: FloatArray = np.asarray(found.x, np.float64).reshape(blocks, width)[:, s:]
        w *= self._unit * scale
        return w

    def _over_blocks(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """[A B] over whole blocks (N, s, s + n), and the Hessian in the state at their start and the input."""
        loop, (s, n) = self._loop, self._loop.entry.shape
        middle = np.minimum(self.first + self.size // 2, len(loop.posture) - 1)
        a = loop.transition[loop.posture[middle]]
        moved = np.zeros((len(a), s, s + n))
        moved[:, :, :s] = np.eye(s)
        hessian = np.zeros((len(a), s + n, s + n))
        for i in range(self.size):
            seen = loop.links @ moved
            hessian += seen.transpose(0, 2, 1) @ (weight[:, i, :, None] * seen)
            moved = a @ moved
            moved[:, :, s:] += self._unit * loop.entry
        hessian[:, range(s, s + n), range(s, s + n)] += self.size
        return moved, hessian

    def _sparse(self) -> tuple[Any, Any]:
        """The Hessian's upper triangle, and x₊ - A x - B w = 0 from x = 0, in (x, w) of all blocks."""
        from scipy import sparse

        blocks, s, width = self._transition.shape
        i, j = np.triu_indices(width)
        starts = np.arange(blocks)[:, None] * width
        data = self._hessian[:, i, j].reshape(-1)
        places = ((starts + i).reshape(-1), (starts + j).reshape(-1))
        hessian = sparse.csc_matrix((data, places), shape=(blocks * width, blocks * width))
        i, j = (index.reshape(-1) for index in np.indices((s, width)))
        rows = (np.arange(1, blocks)[:, None] * s + i).reshape(-1)
        moved = sparse.coo_matrix(
            (self._transition[:-1].reshape(-1), (rows, (starts[:-1] + j).reshape(-1))),
            shape=(blocks * s, blocks * width),
        )
        states = sparse.kron(sparse.eye(blocks), np.eye(s, width))
        return hessian, (states - moved).tocsc()


def require_solver() -> None:
    """Raise where the solver is not installed."""
    try:
        import clarabel  # noqa: F401
    except ImportError:
        raise EstimatorError("limits need a solver: pip install 'linkside[learning]'") from None
