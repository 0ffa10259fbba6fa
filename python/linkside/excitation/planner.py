"""The search for a motion within limits that carries the most information."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
import scipy.optimize

from linkside._core import Response
from linkside.arrays import FloatArray
from linkside.calibration.prepared import ZEROS, Prepared, kinds
from linkside.calibration.problem import bare
from linkside.calibration.response import ResponseProblem
from linkside.errors import EstimatorError
from linkside.robot.limits import Limits

from .expected import MotorMotion, Sensing
from .series import FourierSeries

SOUGHT = ("stiffness", "mass_scale", "payload_mass", "translation", "rotation")
"""Kinds that a motion is planned for; others are uncertain beside them."""

RATE, PER_PERIOD = 200.0, 16.0
"""Least rate of samples during the search [Hz], and least number a period of the highest frequency."""

FIRST = 3
"""Of this number of motions that are tried, one is at random."""

STEP = 0.3
"""First step of the search in a coefficient, of joints that go to their limits at length 1."""

HALVINGS = 8
"""Steps of the bisection for the largest motion within limits of torque."""


@dataclass(frozen=True, eq=False)
class Room:
    """Where joints may move, and which of them do.

    Attributes
    ----------
    posture : (n,)
        Where the motion begins and ends [rad, m].
    reach : (n,)
        How far joints may be from there.
    limits : Limits
        Of all joints.
    joints : (m,)
        Indices of those that move.
    """

    posture: FloatArray
    reach: FloatArray
    limits: Limits
    joints: npt.NDArray[np.intp]


Progress: TypeAlias = Callable[[int, float], None]
"""Called with the number of motions tried and the best cost."""

Torque: TypeAlias = Callable[[MotorMotion], FloatArray]


class Planner:
    """Directions in the space of Fourier series; each is taken as far as limits allow.

    Parameters
    ----------
    sensing
        The robot and its sensors.
    series, room
        What the motion is made of, and where it stays.
    known : (p, p)
        Information of what is recorded besides, tolerances included.
    rate
        Of the recording to be [Hz].

    Attributes
    ----------
    t : (T,)
        Times at which motions are looked at [s].
    """

    def __init__(self, sensing: Sensing, series: FourierSeries, room: Room, known: FloatArray, rate: float) -> None:
        self.sensing, self.series, self.room, self.known, self._rate = sensing, series, room, known, rate
        self._base = bare(sensing.robot)
        coarse = max(RATE, PER_PERIOD * series.highest / series.duration)
        self.t = np.arange(round(series.duration * min(rate, coarse)) + 1) / min(rate, coarse)
        self._gain = rate / min(rate, coarse)
        self._sought = [i for i, p in enumerate(sensing.free) if p.kind in SOUGHT] or list(range(len(sensing.free)))

    def best(self, evaluations: int, seed: int, progress: Progress | None = None) -> FloatArray:
        """Search among random directions, and then from the best of them; coefficients (size, m) within limits."""
        shape = (self.series.size, len(self.room.joints))
        tried: list[tuple[float, FloatArray]] = []

        def cost(x: FloatArray) -> float:
            tried.append((self.cost(x.reshape(shape)), x.reshape(shape).copy()))
            if progress is not None:
                progress(len(tried), min(found for found, _ in tried))
            return tried[-1][0]

        first, size = evaluations // FIRST, int(np.prod(shape))
        if evaluations - first < size + 2:  # too few for a step in every direction
            first = evaluations
        for x in np.random.default_rng(seed).standard_normal((first, *shape)) / np.sqrt(shape[0]):
            cost(x)
        if first < evaluations:
            options = {"maxiter": evaluations - first, "rhobeg": STEP}
            scipy.optimize.minimize(cost, _best(tried).ravel(), method="COBYLA", options=options)
        samples = np.arange(round(self.series.duration * self._rate) + 1) / self._rate
        return self._largest(self.within(_best(tried)), self.elastic_torque, samples)

    def cost(self, x: FloatArray) -> float:
        """Logarithm of the volume of what stays uncertain of what is sought, a parameter."""
        information = self.known + self.information(self.motion(self.within(x), self.t))
        covariance = np.linalg.inv(information)[np.ix_(self._sought, self._sought)]
        return float(np.linalg.slogdet(covariance)[1]) / (2 * len(self._sought))

    def motion(self, x: FloatArray, t: FloatArray) -> MotorMotion:
        """Give the motion of coefficients (size, m)."""
        theta, dtheta, ddtheta = (np.zeros((len(t), self.sensing.robot.n)) for _ in range(3))
        parts = self.series(t, x)
        for all_, own in zip((theta, dtheta, ddtheta), parts, strict=True):
            all_[:, self.room.joints] = own
        return MotorMotion(t, theta + self.room.posture, dtheta, ddtheta)

    def information(self, motion: MotorMotion) -> FloatArray:
        """Fisher's information of readings along a motion with the sensors' own noise, in tolerances."""
        sensing, log = self.sensing, self.sensing.log(motion.t, motion.theta)
        std = np.concatenate([np.broadcast_to(sensing.noise[k], len(log.columns(k))) for k in sensing.noise])
        nothing = np.zeros((len(motion.t), len(std)))
        zeros = sum(len(log.columns(kind)) for kind in sensing.noise if kind in ZEROS)
        blank = Prepared(
            log, kinds(sensing.robot, [log]), motion.arrays, nothing, nothing > 0, np.zeros(2 * sensing.robot.n + zeros)
        )
        problem = ResponseProblem(sensing.robot, [blank], sensing.free, size=std, base=self._base)
        z = sensing.start(problem)
        read = replace(blank, readings=problem.predicted(z)[0])
        exact = ResponseProblem(sensing.robot, [read], sensing.free, size=std, base=self._base)
        return self._gain * exact.evidence(z).information

    def within(self, x: FloatArray) -> FloatArray:
        """Scale coefficients (size, m) so that a joint whose column has length 1 or more goes to its limits."""
        joints, limits = self.room.joints, self.room.limits
        length = np.maximum(np.linalg.norm(x, axis=0), 1e-12)
        most = np.array([self.room.reach[joints], limits.velocity[joints], limits.acceleration[joints]])
        share = (most / self.series.bounds(x / length)).min(axis=0)
        return self._largest(x / length * share * np.minimum(length, 1.0), self._rigid_torque, self.t)

    def _largest(self, x: FloatArray, torque: Torque, t: FloatArray) -> FloatArray:
        """Scale a motion down until motors' torques at times ``t`` are within limits."""

        def fits(share: float) -> bool:
            return bool((np.abs(torque(self.motion(share * x, t))) <= self.room.limits.torque).all())

        if fits(1.0):
            return x
        low, high = 0.0, 1.0
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if fits(middle) else (low, middle)
        if not low:
            self._refuse_heavy()
        return low * x

    def elastic_torque(self, motion: MotorMotion) -> FloatArray:
        """Torque (T, n) of motors, springs included: at frequencies near theirs they take more than rigid joints."""
        robot = self.sensing.robot
        core = Response(robot.core, motion.arrays, kinds=("torque",), fixed=[])
        springs, _ = core.evaluate([], [], [0.0] * (2 * robot.n))
        return np.where(robot.elastic, springs, self._load(motion)) + self._own_torque(motion)

    def _rigid_torque(self, motion: MotorMotion) -> FloatArray:
        """Torque (T, n) of motors if nothing were elastic."""
        return self._load(motion) + self._own_torque(motion)

    def _load(self, motion: MotorMotion) -> FloatArray:
        robot = self.sensing.robot
        load = robot.inverse_dynamics(motion.theta, motion.dtheta, motion.ddtheta)
        return np.asarray(load + robot.link_friction(motion.dtheta, load))

    def _own_torque(self, motion: MotorMotion) -> FloatArray:
        """What motors need for themselves: inertia, coupling, friction."""
        robot = self.sensing.robot
        inertia = np.diag([drive.motor_inertia or 0.0 for drive in robot.drives]) + robot.coupling + robot.coupling.T
        return np.asarray(motion.ddtheta @ inertia + robot.motor_friction(motion.dtheta))

    def _refuse_heavy(self) -> None:
        robot, limits = self.sensing.robot, self.room.limits
        held = np.abs(robot.gravity_torque(self.room.posture))
        j = int(np.argmax(held / limits.torque))
        raise EstimatorError(
            f"joint '{robot.names[j]}' cannot hold the robot in the posture where the motion begins: that takes "
            f"{held[j]:.4g} N m, its limit is {limits.torque[j]:.4g}; give another posture, or limit"
        )


def _best(tried: Sequence[tuple[float, FloatArray]]) -> FloatArray:
    return min(tried, key=lambda one: one[0])[1]
