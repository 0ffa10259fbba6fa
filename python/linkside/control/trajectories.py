"""Smooth motions of the links, with the derivatives that inverse dynamics of elastic joints needs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, factorial, perm
from typing import Any

import numpy as np
import numpy.typing as npt
from numpy.polynomial import Chebyshev

from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot
from linkside.robot.kinematics import tool_jacobian

HIGHEST = 17
"""No robot is asked for a derivative beyond this."""

NODES = 24
"""Postures along each line of a Cartesian path that inverse kinematics is solved for."""

CLOSE = 1e-9
"""A path of joints meets its line to within this [m, rad]."""


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A motion of the links over time, at rest before and after it.

    Attributes
    ----------
    t : (T,)
        Times, rising [s].
    derivatives : (p + 1, T, n)
        Positions, velocities, accelerations, jerks and so on in log order [rad, rad/s, …].
    continuity : int
        Up to this derivative the motion is continuous, its beginning and end at rest included.

    Examples
    --------
    >>> motion = rest_to_rest([[0.0], [0.5]], duration=1.0, period=0.25)
    >>> motion.q.ravel().round(4).tolist()
    [0.0, 0.0245, 0.25, 0.4755, 0.5]
    >>> motion.continuity
    4
    """

    t: FloatArray
    derivatives: FloatArray
    continuity: int

    def __post_init__(self) -> None:
        """Check the shapes."""
        shape = np.shape(self.derivatives)
        if np.ndim(self.t) != 1 or len(shape) != 3 or shape[1] != len(self.t) or shape[0] < 3:
            raise EstimatorError(
                f"trajectory: expected times (T,) and derivatives (p + 1, T, n) with p of 2 or more, got "
                f"{np.shape(self.t)} and {shape}"
            )

    def __len__(self) -> int:
        """Count the samples."""
        return len(self.t)

    @property
    def order(self) -> int:
        """The highest derivative that is known."""
        return len(self.derivatives) - 1

    @property
    def q(self) -> FloatArray:
        """Positions, (T, n)."""
        return np.asarray(self.derivatives[0])

    @property
    def dq(self) -> FloatArray:
        """Velocities, (T, n)."""
        return np.asarray(self.derivatives[1])

    @property
    def ddq(self) -> FloatArray:
        """Accelerations, (T, n)."""
        return np.asarray(self.derivatives[2])

    def held(self, before: float = 0.0, after: float = 0.0) -> Trajectory:
        """Give the same motion with pauses [s] at its ends; time goes on from the same start."""
        period = self.t[1] - self.t[0]
        counts = [_samples("pause", seconds, period) for seconds in (before, after)]
        derivatives = np.pad(self.derivatives, ((0, 0), counts, (0, 0)))
        derivatives[0] = np.pad(self.q, (counts, (0, 0)), mode="edge")
        t = self.t[0] + period * np.arange(derivatives.shape[1])
        return Trajectory(t, derivatives, self.continuity)


def rest_to_rest(
    points: npt.ArrayLike, duration: float | Sequence[float], period: float, *, degree: int = 9
) -> Trajectory:
    """Move from point to point along polynomials of time, at rest at each.

    A polynomial of degree 2m + 1 has m derivatives that vanish at its ends: of a quintic velocity and
    acceleration, at degree 7 the jerk as well, at degree 9 (the default) its derivative, too.

    Parameters
    ----------
    points : (m, n)
        Link positions [rad].
    duration
        Of each of the m − 1 movements, or of all [s]; a multiple of the period.
    period
        Time between samples [s].
    degree
        Odd, 3 to 33.

    Raises
    ------
    EstimatorError
        Points, durations or a degree that cannot be used.
    """
    points = _points(points)
    movements = list(zip(points[:-1], points[1:], _durations(duration, len(points) - 1), strict=True))
    smooth = _smoothness(degree)
    parts = [
        start[None, None, :] * _first(HIGHEST + 1) + _timing(seconds, period, smooth)[:, :, None] * (end - start)
        for start, end, seconds in movements
    ]
    return _joined(parts, period, smooth)


def spline(times: npt.ArrayLike, points: npt.ArrayLike, period: float, *, continuity: int = 4) -> Trajectory:
    """Pass through points at given times, from rest to rest, along one spline.

    It is of degree 2 c + 1 for continuity c: its derivatives up to c vanish at both ends; inside, those up to 2 c are
    continuous.

    Parameters
    ----------
    times : (m,)
        When each point is passed, rising, from 0 [s].
    points : (m, n)
        Link positions [rad].
    period
        Time between samples [s].
    continuity
        1 to 7.
    """
    from scipy.interpolate import make_interp_spline

    points, knots = _points(points), np.asarray(times, float)
    if knots.shape != (len(points),) or knots[0] != 0 or not (np.diff(knots) > 0).all():
        raise EstimatorError(f"spline: expected {len(points)} rising times from 0, one a point, got {knots}")
    if not 1 <= continuity <= 7:
        raise EstimatorError(f"spline: continuity is {continuity}, expected 1 to 7")
    ends = [(order, np.zeros(points.shape[1])) for order in range(1, continuity + 1)]
    curve = make_interp_spline(knots, points, k=2 * continuity + 1, bc_type=(ends, ends))
    t = period * np.arange(1.0 + _samples("the last time", float(knots[-1]), period))
    degree = 2 * continuity + 1
    derivatives = [curve(np.minimum(t, knots[-1]), order) for order in range(degree + 1)]
    return Trajectory(t, np.array(derivatives), continuity)


def polyline(
    robot: Robot,
    points: npt.ArrayLike,
    duration: float | Sequence[float],
    period: float,
    *,
    start: npt.ArrayLike,
    axes: str = "xyz",
    orientation: bool = False,
    joints: Sequence[str] | None = None,
    degree: int = 9,
) -> Trajectory:
    """Move the tool along straight lines, at rest at each corner, by inverse kinematics (Pinocchio).

    Parameters
    ----------
    robot
        With a tool.
    points : (m, k)
        Corners that the tool visits one after the other, from its position at `start` [m], in `axes`.
    duration
        Of each of the m lines, or of all [s].
    period
        Time between samples [s].
    start : (n,)
        Link positions at the beginning [rad].
    axes
        Coordinates of the base frame that are prescribed, such as ``"xz"`` for an arm in a vertical plane.
    orientation
        Whether the tool keeps its orientation as well.
    joints
        Names of those that move, as many as coordinates are prescribed; the default is all.
    degree
        Of the polynomial of time along each line, see `rest_to_rest`.

    Raises
    ------
    EstimatorError
        A point that cannot be reached from the one before, or joints more or fewer than coordinates.
    """
    solver = _InverseKinematics(robot, axes, orientation, joints)
    q = np.array(start, float)
    if q.shape != (robot.n,):
        raise EstimatorError(f"start: expected shape ({robot.n},), got {q.shape}")
    corners, smooth, parts = _points(points, least=1), _smoothness(degree), []
    for index, (corner, seconds) in enumerate(zip(corners, _durations(duration, len(corners)), strict=True)):
        path = solver.line(q, corner, f"line {index}")
        parts.append(_composed(path, _timing(seconds, period, smooth)))
        q = parts[-1][0, -1]
    return _joined(parts, period, smooth)


class _InverseKinematics:
    """Postures along a straight line of the tool."""

    def __init__(self, robot: Robot, axes: str, orientation: bool, joints: Sequence[str] | None) -> None:
        if robot.tool is None:
            raise EstimatorError("polyline: the robot has no tool: name one in robot.yaml, `tool: {link: …}`")
        if not axes or set(axes) - set("xyz"):
            raise EstimatorError(f"axes: {axes!r}, expected some of 'xyz'")
        names = robot.names if joints is None else tuple(joints)
        if unknown := set(names) - set(robot.names):
            raise EstimatorError(f"joints: no joint '{sorted(unknown)[0]}'; there are {', '.join(robot.names)}")
        self.robot, self.names = robot, names
        self.rows = ["xyz".index(axis) for axis in axes]
        self.orientation = orientation
        coordinates = len(self.rows) + 3 * orientation
        if coordinates != len(names):
            raise EstimatorError(
                f"polyline: {len(names)} joints move and {coordinates} coordinates are prescribed; name as many "
                "joints=… as axes, with orientation=True three more"
            )
        self.moving = [robot.names.index(name) for name in names]

    def line(self, q: FloatArray, corner: FloatArray, what: str) -> list[Chebyshev]:
        """Joint positions as functions of the share of the line, 0 to 1."""
        if corner.shape != (len(self.rows),):
            raise EstimatorError(f"points: expected {len(self.rows)} coordinates, one an axis, got {len(corner)}")
        here, rotation = self._pose(q)
        u = 0.5 - 0.5 * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        postures = []
        for share in u:
            q = self._solve(q, here[self.rows] + share * (corner - here[self.rows]), rotation, what)
            postures.append(q)
        curves = [Chebyshev.fit(u, column, NODES - 1, domain=[0, 1]) for column in np.array(postures).T]
        for share in np.linspace(0, 1, 7):
            q = np.array([curve(share) for curve in curves])
            target = here[self.rows] + share * (corner - here[self.rows])
            if np.abs(self._error(q, target, rotation)).max() > CLOSE:
                raise EstimatorError(f"{what}: the joints turn too sharply along it: it passes near a singular posture")
        return curves

    def _solve(self, q: FloatArray, target: FloatArray, rotation: FloatArray, what: str) -> FloatArray:
        for _ in range(30):
            error = self._error(q, target, rotation)
            if np.abs(error).max() < 1e-13:
                return q
            step = np.linalg.lstsq(self._jacobian(q), error, rcond=1e-9)[0]
            q = q.copy()
            q[self.moving] += step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
        if np.abs(error).max() < CLOSE / 10:
            return q
        raise EstimatorError(f"{what}: the tool cannot reach {np.round(target, 4).tolist()} from the posture before")

    def _error(self, q: FloatArray, target: FloatArray, rotation: FloatArray) -> FloatArray:
        from scipy.spatial.transform import Rotation

        place, turned = self._pose(q)
        turn = Rotation.from_matrix(rotation @ turned.T).as_rotvec() if self.orientation else np.empty(0)
        return np.concatenate([target - place[self.rows], turn])

    def _pose(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        pose, _ = tool_jacobian(self.robot, q)
        return pose.translation, pose.rotation

    def _jacobian(self, q: FloatArray) -> FloatArray:
        columns = tool_jacobian(self.robot, q)[1][:, self.moving]
        return np.vstack([columns[self.rows], columns[3:]]) if self.orientation else columns[self.rows]


def _timing(seconds: float, period: float, smooth: int) -> FloatArray:
    """Share of a movement that is done, with its derivatives, (HIGHEST + 1, samples).

    It is the regularised incomplete beta function I_u(m + 1, m + 1), whose slope is proportional to (u (1 − u))ᵐ.
    """
    from scipy.special import beta, betainc

    m = smooth
    u = np.clip(np.arange(1 + _samples("duration", seconds, period)) * period / seconds, 0, 1)
    up, down = _powers(u, m), _powers(1 - u, m) * (-1.0) ** np.arange(HIGHEST)[:, None]
    rows = [betainc(m + 1, m + 1, u)]
    for order in range(HIGHEST):
        terms = (comb(order, j) * up[j] * down[order - j] for j in range(order + 1))
        rows.append(sum(terms) / beta(m + 1, m + 1) / seconds ** (order + 1))
    return np.array(rows)


def _powers(u: FloatArray, m: int) -> FloatArray:
    """Derivatives of uᵐ, (HIGHEST, samples)."""
    return np.array([perm(m, j) * u ** max(m - j, 0) for j in range(HIGHEST)])


def _composed(path: Sequence[Any], share: FloatArray) -> FloatArray:
    """Derivatives in time of functions of the share, by truncated power series, (HIGHEST + 1, samples, n)."""
    scale = np.array([float(factorial(k)) for k in range(HIGHEST + 1)])[:, None]
    inner = share / scale
    offset = inner.copy()
    offset[0] = 0.0
    columns = []
    for curve in path:
        outer = [(curve.deriv(k) if k else curve)(inner[0]) / scale[k] for k in range(min(HIGHEST, NODES - 1) + 1)]
        sum_ = np.zeros_like(inner)
        for coefficient in reversed(outer):
            sum_ = _product(sum_, offset)
            sum_[0] += coefficient
        columns.append(sum_ * scale)
    return np.stack(columns, axis=-1)


def _product(a: FloatArray, b: FloatArray) -> FloatArray:
    out = np.zeros_like(a)
    for k in range(len(a)):
        out[k:] += a[k] * b[: len(a) - k]
    return out


def _joined(parts: Sequence[FloatArray], period: float, smooth: int) -> Trajectory:
    """Movements one after the other; each begins where the one before ended."""
    derivatives = np.concatenate([parts[0], *(part[:, 1:] for part in parts[1:])], axis=1)
    return Trajectory(period * np.arange(float(derivatives.shape[1])), np.ascontiguousarray(derivatives), smooth)


def _first(count: int) -> FloatArray:
    return np.eye(count)[:, :1, None]


def _points(points: npt.ArrayLike, least: int = 2) -> FloatArray:
    array = np.asarray(points, float)
    if array.ndim != 2 or len(array) < least or not np.isfinite(array).all():
        raise EstimatorError(f"points: expected {least} rows or more of finite numbers, got shape {array.shape}")
    return array


def _durations(duration: float | Sequence[float], count: int) -> list[float]:
    durations = [float(d) for d in np.atleast_1d(duration)]
    durations = durations * count if len(durations) == 1 else durations
    if len(durations) != count:
        raise EstimatorError(f"duration: {len(durations)} given, for {count} movements")
    return durations


def _smoothness(degree: int) -> int:
    if degree % 2 == 0 or not 3 <= degree <= 2 * HIGHEST - 1:
        raise EstimatorError(f"degree is {degree}, expected an odd number from 3 to {2 * HIGHEST - 1}")
    return (degree - 1) // 2


def _samples(what: str, seconds: float, period: float) -> int:
    if not (np.isfinite(period) and period > 0):
        raise EstimatorError(f"period is {period}, expected a positive number of seconds")
    count = round(seconds / period) if np.isfinite(seconds) and seconds >= 0 else -1
    if count < 0 or abs(count * period - seconds) > 1e-6 * max(seconds, period):
        raise EstimatorError(f"{what} is {seconds} s, expected a multiple of the period {period} s")
    return count
