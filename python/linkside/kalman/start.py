"""Position and velocity of a robot at the first sample, from the first readings, at rest or in motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError, NumericalError
from linkside.robot import Robot

Start = Literal["auto", "rest"] | tuple[npt.ArrayLike, npt.ArrayLike]
"""The first samples decide; at rest; or a mean and a covariance of the state at the first sample."""

WINDOW = _core.START_SAMPLES
"""Samples from which the initial state is determined."""

LEAST = 8
"""Fewest samples that can show that a robot is at rest."""

WIDENING = 5.0
"""A start's standard deviations over those of the fit, whose readings the filter is going to use again."""

FASTEST, HARDEST = 10.0, 100.0
"""Velocity [rad/s] and acceleration [rad/s²] before anything is read."""

OFFSET = 0.2
"""How far accelerometers may be off beside their noise [m/s²]."""

DOUBT = 0.1
"""Of the torque that moves links, the part that may be wrong."""

ROUNDS = 3
"""How often torsion and what it depends on are found in turn."""

SHAKEN = 0.05
"""Time for which links may have been moved by random jerk before the first sample, and vibrate [s]."""

QUIET = 4.0
"""A robot is at rest while its readings stay within this many standard deviations of their mean."""


@dataclass(frozen=True)
class Readings:
    """The first samples: times (k,) [s], signals (k, n), (k, m), (k, channels), None where there is no such signal."""

    t: FloatArray
    theta: FloatArray
    dtheta: FloatArray | None
    acceleration: FloatArray | None
    wrench: FloatArray | None = None


@dataclass(frozen=True)
class Spread:
    """Standard deviations of readings: motor positions and velocities, accelerometers; and the density of jerk (n,)."""

    theta: FloatArray
    dtheta: float
    acceleration: FloatArray
    jerk: FloatArray


@dataclass(frozen=True)
class Moving:
    """Links and motors at the first sample, each (n,), and standard deviations that belong to them.

    ``by_dtheta`` and ``by_ddtheta`` (n, n) [s²] are how much faster and further links would be were motors faster and
    accelerated more: zero where links are not taken to move as their motors.
    """

    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    theta: FloatArray
    dtheta: FloatArray
    ddtheta: FloatArray
    q_std: FloatArray
    dq_std: FloatArray
    ddq_std: FloatArray
    dtheta_std: FloatArray
    ddtheta_std: FloatArray
    by_dtheta: float
    by_ddtheta: FloatArray


def find_start(robot: Robot, readings: Readings, spread: Spread) -> Moving | None:
    """Fit the motors' first positions, and ask how far links may be from following them; None of a robot at rest.

    The fit is generalised least squares with the covariance that white jerk gives to positions, so that it needs no
    choice of a window. A link is where its torsion puts it, and accelerates as accelerometers say, or as its motor
    does, give or take as much again.

    Raises
    ------
    NumericalError
        Readings so extreme that the fit is not finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        if is_resting(readings, spread) or np.isnan(readings.theta[0]).any():
            return None
        moving = _moving(robot, readings, spread)
    if moving is None or not all(np.isfinite(values).all() for values in vars(moving).values()):
        raise NumericalError("the first samples are too far apart for a filter to find where it starts")
    return moving


def _moving(robot: Robot, readings: Readings, spread: Spread) -> Moving | None:
    theta, dtheta, ddtheta, std = _fit(readings, spread)
    if not all(np.isfinite(values).all() for values in (theta, dtheta, ddtheta)):
        return None
    if stands := bool((np.abs(dtheta) <= WIDENING * std[1]).all()):
        dtheta = np.zeros_like(dtheta)  # it has rested so far, or turns back just then
    stiffness = np.array([d.stiffness if d.elastic else np.inf for d in robot.drives], float)
    q, dq = theta.copy(), dtheta.copy()
    for _ in range(ROUNDS):
        ddq, jerk, ddq_std = _link_acceleration(robot, readings, q, dq, (dtheta, ddtheta, std), spread)
        mass = robot.mass_matrix(q)
        load, weight = robot.inverse_dynamics(q, dq, ddq), robot.gravity_torque(q)
        twist = np.clip(mass @ jerk / stiffness, -np.abs(dtheta) - 0.1, np.abs(dtheta) + 0.1)
        q, dq = theta - load / stiffness, dtheta - twist
    follows, seen = np.isinf(stiffness), _sees(readings, spread)
    ddq_std = np.where(follows, WIDENING * std[2], ddq_std)
    q_std = np.hypot(np.abs(mass) @ ddq_std, DOUBT * (load - weight)) / stiffness
    swing = np.sqrt(SHAKEN * np.diag(mass) / stiffness) * spread.jerk  # as fast as a vibration of that acceleration is
    return Moving(
        q=q,
        dq=dq,
        ddq=ddq,
        theta=theta,
        dtheta=dtheta,
        ddtheta=ddtheta,
        q_std=np.hypot(q_std, WIDENING * std[0]),
        dq_std=np.sqrt(twist**2 + (WIDENING * std[1]) ** 2 + (0.0 if seen else swing) ** 2),
        ddq_std=ddq_std,
        dtheta_std=WIDENING * std[1],
        ddtheta_std=WIDENING * std[2],
        by_dtheta=0.0 if stands else 1.0,
        by_ddtheta=np.zeros_like(mass) if seen or stands else -mass / stiffness[:, None],
    )


def is_resting(readings: Readings, spread: Spread) -> bool:
    """Whether nothing moves in the first samples: motors stand, and accelerometers read the same."""
    if len(readings.t) < LEAST:
        return False
    quiet = [_is_quiet(readings.theta, spread.theta, drift=True)]
    if readings.dtheta is not None:
        quiet.append(bool((np.abs(np.nan_to_num(readings.dtheta)) <= 2 * QUIET * spread.dtheta).all()))
    if readings.acceleration is not None:
        quiet.append(_is_quiet(readings.acceleration, spread.acceleration))
    return all(quiet)


def _is_quiet(values: FloatArray, std: FloatArray, *, drift: bool = False) -> bool:
    """Whether values (k, m) scatter about their mean, and with ``drift`` about no slope, by no more than ``std``."""
    there = ~np.isnan(values)
    count = np.maximum(there.sum(axis=0), 1)
    away = np.where(there, values - np.where(there, values, 0.0).sum(axis=0) / count, 0.0)
    quiet = (np.abs(away) <= QUIET * std).all()
    if drift:
        # A slope moves the halves' means apart by far less than the scatter shows.
        middle = len(values) // 2
        halves = [away[:middle].sum(axis=0), away[middle:].sum(axis=0)]
        quiet &= (np.abs(np.array(halves)) <= QUIET * std * np.sqrt(np.maximum(count, 2) / 2)).all()
    return bool(quiet)


def _fit(readings: Readings, spread: Spread) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Motor position, velocity and acceleration at the first sample (n,), and standard deviations (3, n)."""
    age = readings.t - readings.t[0]
    fits = [_fit_joint(age, readings, spread, joint) for joint in range(readings.theta.shape[1])]
    mean, std = np.array([fit[0] for fit in fits]).T, np.array([fit[1] for fit in fits]).T
    return mean[0], mean[1], mean[2], std


def _fit_joint(age: FloatArray, readings: Readings, spread: Spread, joint: int) -> tuple[FloatArray, FloatArray]:
    theta = readings.theta[:, joint]
    rows, values, covariances = [], [], []
    there = ~np.isnan(theta)
    s = age[there]
    rows.append(np.stack([np.ones_like(s), s, s**2 / 2], axis=1))
    values.append(theta[there] - theta[0])
    early, apart = np.minimum.outer(s, s), np.abs(np.subtract.outer(s, s))
    wander = early**3 * (early**2 / 5 + apart * early / 2 + apart**2 / 3) / 4  # ∫ (a−u)²/2 (b−u)²/2 du up to min(a, b)
    covariances.append(spread.jerk[joint] ** 2 * wander + spread.theta[joint] ** 2 * np.eye(len(s)))
    if readings.dtheta is not None and not np.isnan(readings.dtheta[:, joint]).all():
        there = ~np.isnan(readings.dtheta[:, joint])
        s = age[there]
        rows.append(np.stack([np.zeros_like(s), np.ones_like(s), s], axis=1))
        values.append(readings.dtheta[there, joint])
        early, apart = np.minimum.outer(s, s), np.abs(np.subtract.outer(s, s))
        wander = early**2 * (early / 3 + apart / 2)
        covariances.append(spread.jerk[joint] ** 2 * wander + spread.dtheta**2 * np.eye(len(s)))
    prior = np.array([0.0, 1 / FASTEST**2, 1 / HARDEST**2])
    information, pull, count, residual = np.diag(prior), np.zeros(3), -3, 0.0
    weights = [np.linalg.inv(covariance) for covariance in covariances]
    for a, y, w in zip(rows, values, weights, strict=True):
        information = information + a.T @ w @ a
        pull = pull + a.T @ w @ y
    scale = 1 / np.sqrt(np.diag(information))
    covariance = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
    mean = covariance @ pull
    for a, y, w in zip(rows, values, weights, strict=True):
        residual += float((y - a @ mean) @ w @ (y - a @ mean))
        count += len(y)
    # Motors that move in another way than white jerk does leave larger residuals.
    worse = np.sqrt(max(1.0, residual / max(count, 1))) if count > 0 else 1.0
    mean[0] += theta[0]
    return mean, np.asarray(worse * np.sqrt(np.diag(covariance)))


def _link_acceleration(
    robot: Robot,
    readings: Readings,
    q: FloatArray,
    dq: FloatArray,
    motors: tuple[FloatArray, FloatArray, FloatArray],
    spread: Spread,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Acceleration and jerk of links at the first sample, and the former's standard deviation, each (n,).

    As their motors', give or take as much again and what jerk has left of before, or not at all where all motors
    stand. Accelerometers tell more, to their noise and `OFFSET`.
    """
    dtheta, ddtheta, std = motors
    shaken = np.sqrt(1.0 + ddtheta**2 + SHAKEN * spread.jerk**2)
    loose = np.hypot(shaken, WIDENING * std[2])
    if readings.acceleration is None or not _sees(readings, spread):
        return ddtheta if dtheta.any() else np.zeros_like(ddtheta), np.zeros_like(ddtheta), loose
    there = ~np.isnan(readings.acceleration).any(axis=1)
    age = (readings.t - readings.t[0])[there]
    path, velocity = q + np.outer(age, dq) + np.outer(age**2 / 2, ddtheta), dq + np.outer(age, ddtheta)
    by_ddq = robot.acceleration_map(q, dq)[0]
    force = robot.specific_force(path, velocity, np.broadcast_to(ddtheta, path.shape).copy())
    weight = by_ddq.T / (spread.acceleration**2 + OFFSET**2)
    covariance = np.linalg.inv(weight @ by_ddq + np.diag(1 / loose**2))
    more = (readings.acceleration[there] - force) @ (covariance @ weight).T
    # A straight line, whose scatter is what it does not explain.
    line = np.stack([np.ones_like(age), age], axis=1) if len(age) >= LEAST else np.ones((len(age), 1))
    fit = np.linalg.lstsq(line, more, rcond=None)[0]
    scatter = np.sqrt(np.mean((more - line @ fit) ** 2, axis=0))
    jerk = fit[1] if len(fit) > 1 else np.zeros_like(ddtheta)
    return ddtheta + fit[0], jerk, np.hypot(np.sqrt(np.diag(covariance)), 2 * scatter)


def _sees(readings: Readings, spread: Spread) -> bool:
    """Whether accelerometers say how links accelerate at the first sample."""
    there = readings.acceleration
    return there is not None and len(spread.acceleration) > 0 and bool(np.isfinite(there[0]).all())


def given(start: tuple[npt.ArrayLike, npt.ArrayLike], std: FloatArray, dense: int) -> tuple[FloatArray, FloatArray]:
    """Mean and covariance that a user gave, of the whole state, or without biases, which then have ``std``.

    Raises
    ------
    EstimatorError
        Shapes that do not belong together, values that are not finite, a covariance that is none.
    """
    own, p = (np.array(part, float) for part in start)
    states = len(std)
    k = len(own) if own.ndim == 1 else -1
    if k not in (dense, states) or p.shape != (k, k):
        raise EstimatorError(
            f"start has shapes {own.shape} and {p.shape}, expected ({states},) and ({states}, {states}), "
            f"or without biases ({dense},) and ({dense}, {dense})"
        )
    if not (np.isfinite(own).all() and np.isfinite(p).all()):
        raise EstimatorError("start has values that are not finite")
    scale = np.sqrt(np.maximum(np.diag(p), np.finfo(float).tiny))
    if not np.allclose(p, p.T, rtol=1e-9) or np.linalg.eigvalsh(p / np.outer(scale, scale)).min() < -1e-9:
        raise EstimatorError("start has a covariance that is not symmetric and positive semidefinite")
    mean, covariance = np.zeros(states), np.diag(std**2)
    mean[:k], covariance[:k, :k] = own, p
    return mean, covariance
