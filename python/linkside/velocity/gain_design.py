"""Gains of the reduced-order observer for a robot: bounds of Coriolis forces, and the gain that dominates them.

Cristofaro and De Luca, "Reduced-order observer design for robot manipulators", 2023: eqs. (11), (12) and (15),
Remarks 3.2 and 3.3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias
from weakref import WeakKeyDictionary

import numpy as np
from scipy.optimize import minimize
from scipy.stats import qmc

from linkside.arrays import FloatArray, Progress
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.workspace import joint_limits

from .inertia import rigid_inertia
from .observers import HybridGain

Side = Literal["motors", "links"]

SAMPLES = 4096
"""Postures that are looked at."""

Measure: TypeAlias = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]

_CHUNK = 512
_REFINED = 3
_DIRECTIONS = np.linspace(0, np.pi, 1801)


@dataclass(frozen=True)
class Survey:
    """What gains depend on, over postures drawn within the joint limits.

    Attributes
    ----------
    q : (T, n)
        Postures [rad].
    coriolis : (T,)
        c0(q): ``norm(C(q, v)) <= c0(q) * norm(v)``. Exact for up to two joints, else an upper bound [kg m²].
    least, greatest : (T,)
        Smallest and largest eigenvalue of the inertia [kg m²].
    friction : float
        Smallest viscous friction of a joint [N m s/rad].
    """

    q: FloatArray
    coriolis: FloatArray
    least: FloatArray
    greatest: FloatArray
    friction: float


@dataclass(frozen=True)
class GainDesign:
    """A gain for speeds up to a bound, and what it guarantees.

    Attributes
    ----------
    speed, margin : float
        v_max and η: largest speed of the robot, largest error of the estimate [rad/s].
    gain : float
        k0 of eq. (11) [1/s]; see ``exact``.
    conservative : float
        The gain of Remark 3.3, from separate bounds of c0 and the inertia [1/s].
    posture : (n,)
        The posture of the maximum in eq. (11) [rad].
    coriolis : float
        Largest c0 over the postures [kg m²].
    inertia : tuple of float
        Smallest and largest eigenvalue of the inertia [kg m²].
    region : float
        Errors that start smaller than this are guaranteed to vanish, eq. (12) [rad/s].
    exact : bool
        Whether c0 is exact at each posture (up to two joints) or an upper bound.

    Notes
    -----
    At each posture the values are certified. Over postures they are maxima or minima of a sample, refined from its
    worst postures: there is no certificate between them.
    """

    speed: float
    margin: float
    gain: float
    conservative: float
    posture: FloatArray
    coriolis: float
    inertia: tuple[float, float]
    region: float
    exact: bool
    _robot: Robot
    _side: Side
    _survey: Survey

    def rate(self, error: float) -> float:
        """Guaranteed rate of decay of an initial ``error`` [rad/s] inside the region [1/s].

        Remark 3.2 as it has to be: ``(k0 λmin(M) + λmin(F) - c0 (v_max + ρ)) / λmax(M)`` at its least, with
        ``ρ = error * sqrt(λmax / λmin)``.
        """
        if not 0 <= error < self.region:
            raise EstimatorError(f"error is {error}, expected at least 0 and less than the region's {self.region:.6g}")
        s, (least, greatest) = self._survey, self.inertia
        reach = self.speed + error * np.sqrt(greatest / least)
        return float((self.gain * s.least + s.friction - s.coriolis * reach).min() / greatest)

    def hybrid(self, bound: float, levels: int, **settings: float) -> HybridGain:
        """Gains for speeds up to ``bound``, ``2 * bound``, …, ``levels * bound`` [rad/s], eq. (15)."""
        if not (bound > 0 and levels >= 1):
            raise EstimatorError(f"bound {bound} and levels {levels} of a gain: expected both to be positive")
        of = [_gain(self._robot, self._side, self._survey, r * bound, self.margin)[0] for r in range(1, levels + 1)]
        return HybridGain(tuple(of), bound, self.margin, **settings)  # type: ignore[arg-type]


def design_gain(
    robot: Robot,
    speed: float,
    margin: float,
    *,
    side: Side = "motors",
    samples: int = SAMPLES,
    progress: Progress | None = None,
) -> GainDesign:
    """Find the gain that makes the reduced-order observer converge for speeds up to ``speed``.

    Parameters
    ----------
    robot
        The robot; postures are those within its URDF's limits.
    speed, margin
        v_max and η [rad/s].
    side
        As of `ReducedOrderObserver`: whether motors count.
    samples
        Postures to look at, a power of two; the survey is kept with the robot.
    progress
        Called as ``progress(postures, samples)`` while postures are looked at.

    Raises
    ------
    EstimatorError
        A bound out of range, or an inertia that is singular at some posture, which is named.
    """
    for name, value in (("speed", speed), ("margin", margin)):
        if not (np.isfinite(value) and value > 0):
            raise EstimatorError(f"{name} is {value}, expected a positive number")
    s = survey(robot, side, samples, progress)
    gain, posture = _gain(robot, side, s, speed, margin)
    least, greatest, coriolis = float(s.least.min()), float(s.greatest.max()), float(s.coriolis.max())
    return GainDesign(
        speed=speed,
        margin=margin,
        gain=gain,
        conservative=max(0.0, (coriolis * (speed + margin) - s.friction) / least),
        posture=posture,
        coriolis=coriolis,
        inertia=(least, greatest),
        region=margin * float(np.sqrt(least / greatest)),
        exact=robot.n <= 2,
        _robot=robot,
        _side=side,
        _survey=s,
    )


def survey(robot: Robot, side: Side = "motors", samples: int = SAMPLES, progress: Progress | None = None) -> Survey:
    """Evaluate postures drawn within the joint limits, and the extremes found by refining the worst ones."""
    kept = _SURVEYS.setdefault(robot, {})
    if (side, samples) not in kept:
        kept[side, samples] = _survey(robot, side, samples, progress)
    return kept[side, samples]


_SURVEYS: WeakKeyDictionary[Robot, dict[tuple[Side, int], Survey]] = WeakKeyDictionary()


def _survey(robot: Robot, side: Side, samples: int, progress: Progress | None) -> Survey:
    limits = joint_limits(robot)
    unit = qmc.Sobol(robot.n, seed=0).random(samples)
    q = limits[0] + unit * (limits[1] - limits[0])
    parts = []
    for start in range(0, samples, _CHUNK):
        parts.append(_at(robot, side, q[start : start + _CHUNK]))
        if progress is not None:
            progress(min(start + _CHUNK, samples), samples)
    coriolis, least, greatest = (np.concatenate(part) for part in zip(*parts, strict=True))
    if not (least > 1e-12 * greatest).all():
        worst = int(np.argmin(least / greatest))
        raise EstimatorError(f"the inertia is singular at the posture {np.round(q[worst], 3).tolist()}")
    extremes = [
        _worst(robot, side, q, coriolis, lambda c, low, high: c),
        _worst(robot, side, q, -least, lambda c, low, high: -low),
        _worst(robot, side, q, greatest, lambda c, low, high: high),
    ]
    q = np.vstack([q, *(posture for _, posture in extremes)])
    more = _at(robot, side, q[samples:])
    coriolis, least, greatest = (np.concatenate(pair) for pair in zip((coriolis, least, greatest), more, strict=True))
    return Survey(q, coriolis, least, greatest, _friction(robot, side))


def _gain(robot: Robot, side: Side, s: Survey, speed: float, margin: float) -> tuple[float, FloatArray]:
    """Equation (11), and the posture that decides."""

    def needed(coriolis: FloatArray, least: FloatArray, _: FloatArray) -> FloatArray:
        return (coriolis * (speed + margin) - s.friction) / least

    worst, posture = _worst(robot, side, s.q, needed(s.coriolis, s.least, s.greatest), needed)
    return max(0.0, worst), posture


def _worst(robot: Robot, side: Side, q: FloatArray, values: FloatArray, of: Measure) -> tuple[float, FloatArray]:
    """Largest value near the largest of a sample, and where."""
    limits = joint_limits(robot)
    best, where = float(values.max()), q[int(np.argmax(values))]
    for start in q[np.argsort(values)[-_REFINED:]]:
        found = minimize(
            lambda x: -float(of(*_at(robot, side, x[None]))[0]),
            start,
            method="Nelder-Mead",
            bounds=list(zip(*limits, strict=True)),
            options={"xatol": 1e-7, "fatol": 1e-9 * max(1.0, abs(best)), "maxfev": 300 * robot.n},
        )
        if -found.fun > best:
            best, where = float(-found.fun), found.x
    return best, where


def _at(robot: Robot, side: Side, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """c0 and the smallest and largest eigenvalue of the inertia at postures (T, n)."""
    eigenvalues = np.asarray(np.linalg.eigvalsh(rigid_inertia(robot, q, side)), np.float64)
    return coriolis_bound(christoffel(robot, q)), eigenvalues[:, 0], eigenvalues[:, -1]


def christoffel(robot: Robot, q: FloatArray) -> FloatArray:
    """Christoffel symbols c_ijk (T, n, n, n) at postures (T, n): C(q, v)_ij is the sum of c_ijk v_k."""
    unit = np.eye(robot.n)
    return np.stack([robot.coriolis_matrix(q, np.broadcast_to(e, q.shape)) for e in unit], axis=-1)


def coriolis_bound(symbols: FloatArray) -> FloatArray:
    """c0 (T,): the largest ‖C(q, v)‖ of a unit v; exact for up to two joints, else the least norm of an unfolding."""
    count, n = symbols.shape[:2]
    if n <= 2:
        v = np.stack([np.cos(_DIRECTIONS), np.sin(_DIRECTIONS)])[:n]
        # The form is symmetric in its last two places, so that its maximum is on their diagonal (Banach).
        return np.asarray(np.linalg.norm(np.einsum("tijk,jm,km->tim", symbols, v, v), axis=1).max(axis=-1))
    unfoldings = [np.moveaxis(symbols, axis, 1).reshape(count, n, n * n) for axis in (1, 2)]
    norms = [np.linalg.eigvalsh(u @ u.transpose(0, 2, 1))[:, -1] for u in unfoldings]
    spectral = (np.abs(np.linalg.eigvalsh(symbols)).max(axis=-1) ** 2).sum(axis=-1)
    return np.asarray(np.sqrt(np.minimum.reduce([*norms, spectral])))


def _friction(robot: Robot, side: Side) -> float:
    link = np.array([drive.link_friction[5] + drive.bearing_friction.viscous for drive in robot.drives])
    motor = np.array([drive.motor_friction.viscous for drive in robot.drives])
    return float((link + motor if side == "motors" else link).min())
