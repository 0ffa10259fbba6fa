"""Iterative learning control on an estimated path: computes the next command after each repeat of a motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.recording.estimate import Estimate
from linkside.recording.times import counterparts
from linkside.robot import Robot
from linkside.robot.considered import considered
from linkside.statistics import rms

from .loop import Loop, Motion

BANDWIDTHS = (20.0, 14.0, 10.0, 7.0, 5.0, 3.5, 2.5)
"""Frequencies up to which a robot may learn: the first with which it converges is taken [Hz]."""

ALLOWED = 0.95
"""Contraction that the worst robot within tolerances may then have."""


@dataclass(frozen=True)
class Trial:
    """Errors of one repeat of the motion, and those expected of the next.

    Attributes
    ----------
    number : int
        From 0, the repeat without a correction.
    rms : (n,)
        Error of the links, rms [rad].
    tool_rms : float, optional
        Distance of the tool from where it was to be, rms, where the robot has a tool [m].
    std : (n,)
        Standard deviation of the estimate, rms, as far as the method has one [rad].
    expected : (n,)
        Error that the model expects of the next repeat, rms [rad].
    used : float
        Share of the rows that were learnt from.
    """

    number: int
    rms: tuple[float, ...]
    tool_rms: float | None
    std: tuple[float, ...]
    expected: tuple[float, ...]
    used: float

    @property
    def reached(self) -> bool:
        """Whether every link's error is below the estimate's own standard deviation, so that no more can be learnt."""
        return all(error <= std for error, std in zip(self.rms, self.std, strict=True))


@dataclass(frozen=True)
class Margin:
    """How fast learning converges, and whether it does on robots that are not quite the known one.

    Attributes
    ----------
    contraction : float
        Factor by which each repeat brings the correction at least nearer to its limit, on the robot as known.
    worst : float
        The same on the worst of the robots with stiffnesses and masses off by their tolerances.
    stiffness, mass : float
        Factors of that robot on the known one.
    """

    contraction: float
    worst: float
    stiffness: float
    mass: float

    @property
    def monotone(self) -> bool:
        """Whether every repeat brings the correction nearer to its limit, on all of these robots."""
        return self.worst < 1


class PathLearning:
    """Norm-optimal iterative learning control of a robot's links on their estimate.

    Motors follow a reference by τ = k_p (r − θ) + k_d (ṙ − θ̇) + what else the controller adds. Each repeat of a motion
    is recorded and estimated; `learn` takes the estimate, and `correction` is what the next reference has beside the
    first. The links' answer is that of the robot's model along the motion, in closed loop.

    Gunnarsson and Norrlöf, "On the design of ILC algorithms using optimization", Automatica 37, 2001; on estimates:
    Axelsson, Karlsson and Norrlöf, "Estimation-based norm-optimal iterative learning control", Systems & Control
    Letters 73, 2014. Time and memory are proportional to the length of the motion.

    Parameters
    ----------
    robot
        The robot, with motor inertias.
    motion
        How the links are to move.
    kp, kd
        Gains of the motors' controller, one number or one a joint, link side [N m/rad, N m s/rad].
    bandwidth
        Frequency up to which it learns [Hz]. By default the first of `BANDWIDTHS` with which every robot within
        tolerances converges.
    rate
        How much of what is beyond its bandwidth a repeat may change: 1 learns at once, smaller numbers average the
        noise of more repeats.
    deviations
        Standard deviations by which stiffnesses and masses may be off.
    margin
        As it was found before for the same settings, ``bandwidth`` among them; by default it is looked for.

    Raises
    ------
    EstimatorError
        Settings out of range, a motion of other joints, a loop that is not stable, or one that would not converge.

    Attributes
    ----------
    curvature : (T, n)
        Second derivative of the correction [rad/s²].
    trials : tuple of Trial
        The repeats that were learnt from.
    margin : Margin
        How fast it converges.
    """

    def __init__(
        self,
        robot: Robot,
        motion: Motion,
        kp: npt.ArrayLike,
        kd: npt.ArrayLike,
        *,
        bandwidth: float | None = None,
        rate: float = 0.5,
        deviations: float = 1.0,
        margin: Margin | None = None,
    ) -> None:
        robot.require_masses("learning")
        if bandwidth is not None and not 0 < bandwidth < 0.5 / motion.period:
            raise EstimatorError(f"bandwidth is {bandwidth!r}, expected more than 0 and less than half the sample rate")
        if not 0 <= deviations < np.inf:
            raise EstimatorError(f"deviations is {deviations!r}, expected 0 or more")
        if not 0 < rate <= 1:
            raise EstimatorError(f"rate is {rate!r}, expected more than 0 and at most 1")
        self.robot, self.motion, self.rate = robot, motion, rate
        self.kp, self.kd = (_gains(name, gain, robot.n) for name, gain in (("kp", kp), ("kd", kd)))
        self._loop = Loop(robot, motion, self.kp, self.kd)
        if bandwidth is None or margin is None:
            bandwidth, margin = self._designed(bandwidth, deviations)
        self.bandwidth, self.margin = bandwidth, margin
        self.curvature = np.zeros_like(motion.q)
        self.trials: tuple[Trial, ...] = ()

    @property
    def correction(self) -> FloatArray:
        """Correction that is added to the motors' reference in the next repeat, (T, n) [rad]."""
        return self._loop.correction(self.curvature)

    def answer(self, curvature: FloatArray) -> FloatArray:
        """How links are expected to deviate by a correction of this second derivative, (T, n) [rad]."""
        return self._loop.core.answer(np.ascontiguousarray(curvature))

    def learn(self, estimate: Estimate) -> Trial:
        """Take the estimate of a repeat with the present `correction`, and improve that.

        Rows that are not good are left out, and rows with a larger standard deviation than usual count for less.

        Raises
        ------
        EstimatorError
            Of other joints, without a row for each time of the motion, or without a good row.
        """
        error, std, weight = self._read(estimate)
        # The step that costs nothing but its own weights goes to an input without curvature, as far as the rate says.
        change = self._step(self.bandwidth, weight).solve(error, -self.rate * self.curvature)
        expected = error - self.answer(change)
        trial = Trial(
            number=len(self.trials),
            rms=_of_each(error),
            tool_rms=self._tool_rms(error),
            std=_of_each(std),
            expected=_of_each(expected),
            used=float(np.mean(weight[:, 0] > 0)),
        )
        self.curvature, self.trials = self.curvature + change, (*self.trials, trial)
        return trial

    def resumed(self, curvature: FloatArray, trials: tuple[Trial, ...]) -> PathLearning:
        """Resume an iteration."""
        if curvature.shape != self.motion.q.shape or not np.isfinite(curvature).all():
            raise EstimatorError(
                f"curvature has shape {curvature.shape}, expected finite numbers {self.motion.q.shape}"
            )
        self.curvature, self.trials = curvature, trials
        return self

    def _read(self, estimate: Estimate) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Errors of the links, their standard deviations and weights, (T, n) each; zero where nothing is known."""
        if estimate.names != self.robot.names:
            raise EstimatorError(
                f"the estimate is of {', '.join(estimate.names)}, expected {', '.join(self.robot.names)}"
            )
        own = self.motion.t - self.motion.t[0]
        rows = counterparts(own, estimate.t - estimate.t[0], "the estimate")
        q, good = estimate.q[rows], (estimate.status[rows] == 0) & np.isfinite(estimate.q[rows]).all(axis=1)
        if not good.any():
            raise EstimatorError("the estimate has no good row during the motion: nothing can be learnt from it")
        std = np.zeros_like(q) if estimate.q_std is None else estimate.q_std[rows]
        usual = np.median(std[good], axis=0)
        share = np.ones_like(q) if not usual.all() else np.minimum(1.0, usual / np.maximum(std, usual)) ** 2
        return (
            np.where(good[:, None], self.motion.q - q, 0.0),
            np.where(good[:, None], std, 0.0),
            np.where(good[:, None], share, 0.0),
        )

    def _tool_rms(self, error: FloatArray) -> float | None:
        if self.robot.tool is None:
            return None
        wanted, found = (self.robot.tool_position(q) for q in (self.motion.q, self.motion.q - error))
        return float(rms(np.linalg.norm(wanted - found, axis=1)))

    def _step(self, bandwidth: float, weight: FloatArray) -> _core.LearningStep:
        """The step for a bandwidth, at which by ρ curvature costs as much as the error; ρ/(ρ + λ) is the rate."""
        rough = (2 * np.pi * bandwidth) ** -4.0
        n = self.robot.n
        return _core.LearningStep(self._loop.core, weight, [rough] * n, [rough * (1 - self.rate) / self.rate] * n)

    def _designed(self, bandwidth: float | None, deviations: float) -> tuple[float, Margin]:
        """The bandwidth and its margin: that which is given, or the widest that converges."""
        others = self._within(deviations)
        for tried in BANDWIDTHS if bandwidth is None else (bandwidth,):
            margin = self._margin_at(tried, others)
            if margin.worst <= ALLOWED:
                break
        if not margin.monotone:
            raise EstimatorError(
                f"learning up to {tried:g} Hz would not converge on a robot of {margin.stiffness:.2f} times the "
                f"stiffness and {margin.mass:.2f} times the mass, which robot.yaml's tolerances allow: a repeat might "
                f"bring the correction {margin.worst:.3f} times as far from its limit; lower bandwidth or rate, or "
                "calibrate"
            )
        return tried, margin

    def _margin_at(self, bandwidth: float, others: dict[tuple[float, float], Loop]) -> Margin:
        step = self._step(bandwidth, np.ones_like(self.motion.q))
        start = np.random.default_rng(0).standard_normal(self.motion.q.size)
        factors = {of: step.contraction(loop.core, start) for of, loop in others.items()}
        (stiffness, mass), worst = max(factors.items(), key=lambda pair: pair[1])
        return Margin(factors[1.0, 1.0], worst, stiffness, mass)

    def _within(self, deviations: float) -> dict[tuple[float, float], Loop]:
        """Loops of robots with other stiffnesses and masses, by factors on these; the known one is among them."""
        stds = {
            kind: max((one.std for one in considered(self.robot) if one.kind == kind), default=0.0)
            for kind in ("stiffness", "mass")
        }
        sides = {kind: np.exp(deviations * std * np.array([-1.0, 1.0])) for kind, std in stds.items()}
        loops = {(1.0, 1.0): self._loop}
        for stiffness in sides["stiffness"]:
            for mass in sides["mass"]:
                other = self.robot.scaled(stiffness=float(stiffness), mass=float(mass))
                loops[float(stiffness), float(mass)] = Loop(other, self.motion, self.kp, self.kd)
        return loops


def _gains(name: str, value: npt.ArrayLike, n: int) -> FloatArray:
    gains = per_joint(name, value, n)
    if not np.isfinite(gains).all() or (gains < 0).any():
        raise EstimatorError(
            f"{name} is {gains[~(gains >= 0) | np.isinf(gains)][0]:g}, expected finite gains of 0 or more"
        )
    return gains


def _of_each(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(rms(column)) for column in values.T)
