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
from linkside.recording.log import Log
from linkside.recording.times import counterparts
from linkside.robot import Robot
from linkside.robot.considered import considered
from linkside.robot.limits import Limits
from linkside.statistics import rms

from .belief import Belief, Seen
from .blocks import BlockProgram, require_solver
from .limited import limited
from .loop import Loop, Motion
from .signals import KINDS, Bounds, Signals
from .trial import Trial

BANDWIDTHS = (20.0, 14.0, 10.0, 7.0, 5.0, 3.5, 2.5)
"""Frequencies up to which a robot may learn: the first with which it converges is taken [Hz]."""

ALLOWED = 0.95
"""Contraction that the worst robot within tolerances may then have."""

PRICE = 2.0
"""By which factor errors may grow to bring back a signal that the last repeat had beyond its limit."""


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
    limits
        Limits of the motors' reference, its velocity and acceleration, and of motor torques, which the next repeats
        keep as the model has them; needs `linkside[learning]`. By default there are none.

    Raises
    ------
    EstimatorError
        Settings out of range, a motion of other joints or beyond a limit, a loop that is not stable, or one that would
        not converge.

    Attributes
    ----------
    curvature : (T, n)
        Second derivative of the correction [rad/s²].
    trials : tuple of Trial
        The repeats that were learnt from.
    belief : Belief
        What is known of the errors of the next repeat.
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
        limits: Limits | None = None,
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
        self.limits = limits
        self._signals = None if limits is None else Signals(robot, self._loop, motion, limits)
        if limits is not None:
            require_solver()
        self.curvature, self.belief = np.zeros_like(motion.q), Belief.none(motion)
        self.trials: tuple[Trial, ...] = ()

    @property
    def correction(self) -> FloatArray:
        """Correction that is added to the motors' reference in the next repeat, (T, n) [rad]."""
        return self._loop.correction(self.curvature)

    def answer(self, curvature: FloatArray) -> FloatArray:
        """How links are expected to deviate by a correction of this second derivative, (T, n) [rad]."""
        return self._loop.core.answer(np.ascontiguousarray(curvature))

    def learn(self, estimate: Estimate, log: Log | None = None) -> Trial:
        """Take the estimate of a repeat with the present `correction`, and improve that.

        Rows that are not good are left out. A link that is nearer to its path than its estimate can tell is left there.

        Parameters
        ----------
        estimate
            Of the repeat.
        log
            Its recording, whose torques are needed for their limits.

        Raises
        ------
        EstimatorError
            Of other joints, without a row for each time of the motion, or without a good row; or without torques where
            these have limits.
        """
        if estimate.names != self.robot.names:
            raise EstimatorError(
                f"the estimate is of {', '.join(estimate.names)}, expected {', '.join(self.robot.names)}"
            )
        seen, tau = Seen.of(self.motion, estimate), self._torque(log)
        belief = self.belief.told(seen)
        errors = seen.sizes(seen.error)
        weight = belief.weight(np.array(self.trials[0].rms if self.trials else errors))
        change, held = self._change(belief.error, weight, tau)
        moved = self.answer(change)
        trial = Trial(
            number=len(self.trials),
            rms=errors,
            tool_rms=self._tool(seen.error, seen.known[:, 0]),
            std=seen.sizes(seen.std),
            tool_std=seen.tool_std,
            step=_of_each(moved),
            tool_step=self._tool(moved),
            expected=_of_each(belief.error - moved),
            used=float(np.mean(seen.known)),
            held=held,
        )
        self.trials = (*self.trials, trial)
        if not trial.reached:
            self.curvature, belief = self.curvature + change, belief.after(moved)
        self.belief = belief
        return trial

    def resumed(self, curvature: FloatArray, trials: tuple[Trial, ...], belief: Belief | None = None) -> PathLearning:
        """Resume an iteration; by default nothing is known of errors yet."""
        if curvature.shape != self.motion.q.shape or not np.isfinite(curvature).all():
            raise EstimatorError(
                f"curvature has shape {curvature.shape}, expected finite numbers {self.motion.q.shape}"
            )
        self.curvature, self.trials, self.belief = curvature, trials, belief or Belief.none(self.motion)
        return self

    def _change(self, error: FloatArray, weight: FloatArray, tau: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
        """The step, and the limits that hold it back."""
        # The step that costs nothing but its own weights goes to an input without curvature, as far as the rate says.
        change = self._step(self.bandwidth, weight).solve(error, -self.rate * self.curvature)
        if self.limits is None or self._signals is None:
            return change, ()
        bounds = Bounds.of(self.limits, self._signals.of(self.curvature, tau))
        passed = np.argwhere(bounds.passed(self._signals.deviation(change)))
        if not len(passed):
            return change, ()
        blocks = BlockProgram(self._loop, weight, self._rough(self.bandwidth) / self.rate, self.bandwidth)
        held = tuple(f"{KINDS[kind]} of {self.robot.names[j]}" for kind, j in passed)

        def far(step: FloatArray) -> bool:
            after, before = (np.sum(weight * e**2) for e in (error - self.answer(step), error))
            return bool(after > PRICE**2 * before)

        return limited(change, blocks, self._signals, bounds, far), held

    def _torque(self, log: Log | None) -> FloatArray:
        """Motor torques during the motion, (T, n); zero where they have no limits."""
        limits = np.full(self.robot.n, np.inf) if self.limits is None else self.limits.torque
        if np.isinf(limits).all():
            return np.zeros_like(self.motion.q)
        if log is None or log.tau is None:
            raise EstimatorError("torques have limits: the recording of the repeat is needed, with motor torques")
        rows = counterparts(self.motion.t - self.motion.t[0], log.t - log.t[0], "the log")
        tau = log.tau[rows]
        if not np.isfinite(tau[:, np.isfinite(limits)]).all():
            raise EstimatorError("torques have limits: a motor torque of the recording is missing")
        return tau

    def _tool(self, off: FloatArray, known: npt.NDArray[np.bool_] | None = None) -> float | None:
        """How far the tool is where links are ``off``, (T, n), rms over the rows that are known [m]."""
        if self.robot.tool is None:
            return None
        wanted, found = (self.robot.tool_position(q) for q in (self.motion.q, self.motion.q - off))
        away = np.linalg.norm(wanted - found, axis=1)
        return rms(away if known is None else away[known])

    def _step(self, bandwidth: float, weight: FloatArray) -> _core.LearningStep:
        """The step for a bandwidth, at which by ρ curvature costs as much as the error; ρ/(ρ + λ) is the rate."""
        rough, n = self._rough(bandwidth), self.robot.n
        return _core.LearningStep(self._loop.core, weight, [rough] * n, [rough * (1 - self.rate) / self.rate] * n)

    @staticmethod
    def _rough(bandwidth: float) -> float:
        """The cost of curvature that is that of errors at the bandwidth, ρ."""
        return float((2 * np.pi * bandwidth) ** -4.0)

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
