"""Gains that depend on the posture, designed for a robot.

Cristofaro and De Luca, "Reduced-order observer design for robot manipulators", 2023, Section 3.2, which states two aims
and leaves the method open. With ``Q = M ∂k/∂y + (M ∂k/∂y)ᵀ``, deformation reduction keeps the eigenvalues of Q
together, and the other map brings ∂k/∂y close to the inverse of M. Neither lowers the peak of the gain: the Euclidean
certificate asks for ``λmin(Q) / 2 >= c0 (v_max + η) - λmin(F)`` at each posture, hence for ``norm(∂k/∂y)`` of at least
that by ``λmin(M)``, whose maximum is the constant gain of eq. (11).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from linkside.arrays import FloatArray, Progress
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.workspace import prismatic

from .cutting_planes import widest
from .gain_design import Side, Survey, survey
from .gain_map import GainMap
from .inertia import rigid_inertia

SAMPLES = 256
"""Postures that are looked at."""

_MOVES = 1e-9


@dataclass(frozen=True)
class ShapedGain:
    """A gain that depends on the posture, and its properties over the postures that were sampled.

    Attributes
    ----------
    map : GainMap
        For `ReducedOrderObserver`; of `for_speed` with the unit of a gain, else only its shape.
    ratio : float
        Smallest by largest eigenvalue of ``Q = M ∂k/∂y + (M ∂k/∂y)ᵀ`` over all postures; not above 0 is no gain.
    limit : float or None
        Upper bound of the ratio for maps of these harmonics at the same postures: how close the search came to the
        optimum.
    peak : float
        Largest norm of ∂k/∂y.
    apart : float
        Largest norm of ∂k/∂y minus the inverse of the inertia [1/(kg m²)].

    Notes
    -----
    All are over a sample of postures, refined where the inertia and c0 are extreme: not a certificate between them.
    """

    map: GainMap
    ratio: float
    limit: float | None
    peak: float
    apart: float
    _survey: Survey
    _inertia: FloatArray

    def for_speed(self, speed: float, margin: float) -> ShapedGain:
        """Scale to the least gain that converges for speeds up to ``speed``, errors up to ``margin`` [rad/s].

        Raises
        ------
        EstimatorError
            A bound that is not positive, or a map without a positive Q at some posture, which is named.
        """
        for name, value in (("speed", speed), ("margin", margin)):
            if not (np.isfinite(value) and value > 0):
                raise EstimatorError(f"{name} is {value}, expected a positive number")
        s = self._survey
        least = _eigenvalues(self._inertia, self.map.jacobian(s.q))[:, 0] / 2
        if not (least > 0).all():
            worst = np.round(s.q[int(np.argmin(least))], 3).tolist()
            raise EstimatorError(f"the map gives no positive gain at the posture {worst}: expected more harmonics")
        factor = float(((s.coriolis * (speed + margin) - s.friction) / least).max())
        return replace(self, map=self.map * factor, peak=factor * self.peak)


def reduce_deformation(
    robot: Robot,
    harmonics: int = 2,
    *,
    side: Side = "motors",
    samples: int = SAMPLES,
    progress: Progress | None = None,
) -> ShapedGain:
    """Find the map that keeps the eigenvalues of Q closest together: maximise t with ``t I <= Q <= I``.

    Parameters
    ----------
    robot
        The robot; postures are those within its URDF's limits.
    harmonics
        Largest sum of a wave's ``|m|``; 0 finds the best constant matrix.
    side
        As of `ReducedOrderObserver`: whether motors count.
    samples
        Postures to look at, a power of two.
    progress
        Called as ``progress(round, most rounds)`` after each round of cutting planes.

    Raises
    ------
    EstimatorError
        Fewer harmonics than 0, or more than the postures can tell apart.

    Notes
    -----
    A semidefinite program, linear in the coefficients; solved by cutting planes, which also bound the distance from the
    optimum.
    """
    seen, waves, basis, inertia = _postures(robot, harmonics, side, samples)
    mean = np.linalg.inv(inertia.mean(axis=0))
    coefficients, limit = widest(inertia @ mean, basis, progress=progress)
    return _shaped(seen, inertia, waves, mean @ coefficients, limit)


def approximate_inverse(
    robot: Robot, harmonics: int = 6, *, side: Side = "motors", samples: int = SAMPLES
) -> ShapedGain:
    """Find the map whose ∂k/∂y comes nearest to the inverse of the inertia, in the mean square over the postures.

    Row by row the projection of the inverse onto gradients (Helmholtz). Parameters and errors are those of
    `reduce_deformation`.
    """
    seen, waves, basis, inertia = _postures(robot, harmonics, side, samples)
    inverse = np.linalg.inv(inertia[:samples])
    rows = basis[:samples].transpose(0, 2, 1).reshape(-1, basis.shape[1])
    coefficients = np.linalg.lstsq(rows, inverse.transpose(0, 2, 1).reshape(-1, robot.n), rcond=None)[0].T
    return _shaped(seen, inertia, waves, coefficients, None)


def shaped(robot: Robot, gain: GainMap, *, side: Side = "motors", samples: int = SAMPLES) -> ShapedGain:
    """Evaluate a given map, for example ``GainMap.constant(matrix)``."""
    if gain.n != robot.n:
        raise EstimatorError(f"a gain map is for {gain.n} joints, expected {robot.n}")
    seen = survey(robot, side, samples)
    return _measured(seen, rigid_inertia(robot, seen.q, side), gain, None)


def _postures(
    robot: Robot, harmonics: int, side: Side, samples: int
) -> tuple[Survey, FloatArray, FloatArray, FloatArray]:
    """Postures, waves (H, n), basis (T, n + 2 H, n) and inertia (T, n, n)."""
    if harmonics < 0:
        raise EstimatorError(f"harmonics is {harmonics}, expected at least 0")
    seen = survey(robot, side, samples)
    inertia = rigid_inertia(robot, seen.q, side)
    moving = _moving(robot, side, seen.q, inertia)
    waves = np.zeros((0, robot.n))
    if moving.size:
        lattice = [m for m in _lattice(moving.size, harmonics) if m > (0,) * moving.size]
        waves = np.zeros((len(lattice), robot.n))
        waves[:, moving] = np.reshape(lattice, (-1, moving.size))
    if robot.n + 2 * len(waves) > samples:
        raise EstimatorError(f"{len(waves)} waves are too many for {samples} postures: expected fewer harmonics")
    return seen, waves, _basis(waves, seen.q), inertia


def _moving(robot: Robot, side: Side, q: FloatArray, inertia: FloatArray) -> npt.NDArray[np.intp]:
    """Joints that turn and on whose position the inertia depends."""
    turning = []
    for joint, slides in enumerate(prismatic(robot)):
        other = q.copy()
        other[:, joint] = q[::-1, joint]
        change = np.abs(rigid_inertia(robot, other, side) - inertia).max()
        if not slides and change > _MOVES * np.abs(inertia).max():
            turning.append(joint)
    return np.array(turning, np.intp)


def _lattice(dimensions: int, most: int) -> Iterator[tuple[int, ...]]:
    """Whole numbers whose absolute values add up to at most ``most``."""
    if dimensions == 0:
        yield ()
        return
    for first in range(-most, most + 1):
        for rest in _lattice(dimensions - 1, most - abs(first)):
            yield (first, *rest)


def _basis(waves: FloatArray, q: FloatArray) -> FloatArray:
    """What coefficients (n, n + 2 H) of P, a and b are multiplied with to give ∂k/∂y (T, n + 2 H, n)."""
    phase = (q @ waves.T)[..., None]
    constant = np.broadcast_to(np.eye(q.shape[1]), (len(q), q.shape[1], q.shape[1]))
    return np.concatenate([constant, np.cos(phase) * waves, -np.sin(phase) * waves], axis=1)


def _shaped(
    seen: Survey, inertia: FloatArray, waves: FloatArray, coefficients: FloatArray, limit: float | None
) -> ShapedGain:
    n, count = len(coefficients), len(waves)
    sine, cosine = coefficients[:, n : n + count].T, coefficients[:, n + count :].T
    return _measured(seen, inertia, GainMap(coefficients[:, :n], waves, sine, cosine), limit)


def _measured(seen: Survey, inertia: FloatArray, gain: GainMap, limit: float | None) -> ShapedGain:
    jacobian = gain.jacobian(seen.q)
    eigenvalues = _eigenvalues(inertia, jacobian)
    ratio = float(eigenvalues[:, 0].min() / eigenvalues[:, -1].max())
    peak = float(np.linalg.norm(jacobian, 2, axis=(1, 2)).max())
    apart = float(np.linalg.norm(jacobian - np.linalg.inv(inertia), 2, axis=(1, 2)).max())
    return ShapedGain(gain, ratio, limit, peak, apart, seen, inertia)


def _eigenvalues(inertia: FloatArray, jacobian: FloatArray) -> FloatArray:
    """Eigenvalues of Q (T, n)."""
    product = inertia @ jacobian
    return np.asarray(np.linalg.eigvalsh(product + product.transpose(0, 2, 1)))
