"""Start values from the equations of motion: least squares, linear in what is sought, without a filter run.

All signals of an equation pass the same low-pass filter, which gives their derivatives as well, so that the filtered
equation holds as the equation does (P. C. Young, Automatica 17, 1981). Noise in the regressors biases the outcome
(equation error); that is good enough for a start.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.optimize
import scipy.signal

from linkside.arrays import FloatArray
from linkside.recording.log import Log
from linkside.robot import Robot
from linkside.robot.joints import JointConfig

from .problem import Problem
from .signals import derivative, filled, signals
from .starts import posterior

Drive = dict[str, float]
Equation = tuple[dict[str, FloatArray], FloatArray]

POLES = 6
CORNER = 10.0
"""Of the low-pass filter [Hz]: above the resonance of most arms."""

SETTLING = 8.0
"""Time constants of that filter until where it started from is forgotten."""

ROUNDS = 3
"""Equations with torsion in them that has to be guessed from stiffness are solved so often."""

PARTS = {"compliance": "stiffness", "cubic": "cubic_stiffness", "lag": "damping"}
"""Torsion by torque is compliance · torque − cubic · torque³ − lag · its rate, for small hardening and damping."""

PLAUSIBLE = 4.0
"""Further from robot.yaml, in tolerances, an outcome is that of noise or of the model's errors."""

KINDS = ("stiffness", "cubic_stiffness", "damping", "motor_inertia", "viscous", "coulomb")
"""Kinds that start values are found for."""


class Filter:
    """Low-pass filter ω⁶/(s + ω)⁶ and its derivatives, by the bilinear transform.

    Parameters
    ----------
    period
        Sampling period [s].
    """

    def __init__(self, period: float) -> None:
        self.period = period
        self.rate = 2 * np.pi * min(CORNER, 0.1 / period)
        self.settled = round(SETTLING / self.rate / period)

    def __call__(self, values: FloatArray, order: int = 0) -> FloatArray:
        """Filter columns (T, …) and differentiate them ``order`` times; the first rows, not settled, are cut off."""
        numerator = np.append(self.rate**POLES, np.zeros(order))
        b, a = scipy.signal.bilinear(numerator, np.poly([-self.rate] * POLES), 1 / self.period)
        settled = min(self.settled, len(values) // 2)
        return np.asarray(scipy.signal.lfilter(b, a, values - values[0], axis=0))[settled:]


def better(problem: Problem, z: Mapping[str, float]) -> dict[str, float]:
    """Put a joint's start values in place of those in ``z``, by name, where recordings are more probable with them."""
    at = dict(z)
    most = posterior(problem, at)
    for values in start_values(problem):
        value = posterior(problem, at | values)
        if value > most:
            at, most = at | values, value
    return at


def start_values(problem: Problem) -> list[dict[str, float]]:
    """Find springs and motors that fit the equations of motion best: its free parameters' z by name, for each
    joint of which the outcome is plausible.

    With accelerometers the spring's equation K(θ − q) + K₃(θ − q)³ + D(θ̇ − q̇) = M(q)q̈ + … is solved, with q̈ from what
    they read, then the motor's, B θ̈ + friction + that torque = τ. Without, both as one.
    """
    robot = problem.robot
    sources = [_Source(robot, log, problem.torque) for log in problem.logs]
    free = [[p for p in problem.free if p.kind in KINDS and p.core[1] == joint] for joint in range(robot.n)]
    drives = [_nominal(drive) for drive in robot.drives]
    for _ in range(ROUNDS):
        for joint in np.flatnonzero(robot.elastic).tolist():
            drives[joint] |= _of_joint(sources, joint, {p.kind for p in free[joint]}, drives)
    found = [
        {p.name: p.z(float(np.clip(drive[p.kind], p.low, p.high))) for p in chosen}
        for chosen, drive in zip(free, drives, strict=True)
    ]
    return [values for values in found if values and max(map(abs, values.values())) < PLAUSIBLE]


class _Source:
    """Signals of one recording: motors as measured, links from accelerometers as far as there are any."""

    def __init__(self, robot: Robot, log: Log, torque: bool) -> None:
        self.robot, self.filter = robot, Filter(log.period)
        arrays = signals(robot, log, torque)
        self.theta = filled(arrays["theta"])
        self.dtheta = filled(arrays["dtheta"])
        self.ddtheta = derivative(self.theta, log.period, 2)
        self.tau = filled(arrays["tau"]) if torque else None
        self.mass = robot.mass_matrix(self.theta)
        self.ddq = self.ddtheta
        self.load = robot.inverse_dynamics(self.theta, self.dtheta, self.ddtheta)
        self.accelerated = log.acceleration is not None and bool(robot.acceleration_channels)
        if log.acceleration is not None and self.accelerated:
            self._links(filled(log.acceleration), log.period)

    def _links(self, readings: FloatArray, period: float) -> None:
        """Accelerations of elastic joints that explain the readings; these are linear in them.

        Links are where their loads twist the springs of robot.yaml; the loads come from the accelerations in turn.
        """
        robot = self.robot
        elastic = np.flatnonzero(robot.elastic)
        softness = np.array([1 / d.stiffness if d.elastic and d.stiffness else 0.0 for d in robot.drives])
        rest = self.ddtheta * ~robot.elastic
        q, dq = self.theta, self.dtheta
        for _ in range(ROUNDS):
            base = robot.specific_force(q, dq, rest)
            columns = [robot.specific_force(q, dq, rest + np.eye(robot.n)[joint]) - base for joint in elastic]
            self.ddq = rest.copy()
            inverse = np.linalg.pinv(np.stack(columns, axis=2))
            self.ddq[:, elastic] = (inverse @ (readings - base)[..., None])[..., 0]
            self.load = robot.inverse_dynamics(q, dq, self.ddq)
            q = self.theta - softness * self.load
            dq = self.dtheta - softness * derivative(self.load, period, 1)

    def spring(self, joint: int) -> Equation:
        """Regressors of a spring's torsion, by its torque, and the torsion, filtered and differentiated twice."""
        keep, load = self.filter, self.load[:, joint]
        columns = {"compliance": keep(load, 2), "cubic": -keep(load**3, 2), "lag": -keep(load, 3)}
        return columns, keep(self.theta[:, joint], 2) - keep(self.ddq[:, joint])

    def motor(self, joint: int) -> Equation:
        """Regressors of a motor's torque and the torque that is left for it, filtered and differentiated once."""
        assert self.tau is not None
        keep, theta = self.filter, self.theta[:, joint]
        return {
            "motor_inertia": keep(theta, 3),
            "viscous": keep(theta, 2),
            "coulomb": keep(np.sign(self.dtheta[:, joint]), 1),
        }, keep(self.tau[:, joint] - self.load[:, joint], 1)

    def compliance(self, joint: int, drives: Sequence[Drive]) -> Equation:
        """What its motor bears less for each unit of its spring's compliance, and because of the others' springs.

        Link i follows its motor less its torsion cᵢ τᵢ, which takes Σ Mⱼᵢ cᵢ τ̈ᵢ off the load of joint j.
        """
        assert self.tau is not None
        columns = []
        for i, drive in enumerate(drives):
            sliding = drive["viscous"] * self.dtheta[:, i] + drive["coulomb"] * np.sign(self.dtheta[:, i])
            torque = self.tau[:, i] - sliding - drive["motor_inertia"] * self.ddtheta[:, i]
            columns.append(self.filter(-self.mass[:, joint, i] * torque, 3))
        others = [i for i, drive in enumerate(drives) if i != joint and drive["stiffness"]]
        rest = sum((columns[i] / drives[i]["stiffness"] for i in others), np.zeros(len(columns[0])))
        return {"compliance": columns[joint]}, -rest


def _of_joint(sources: Sequence[_Source], joint: int, free: set[str], drives: Sequence[Drive]) -> Drive:
    """Values of one joint's free kinds, given those of all drives so far."""
    found = _of_spring(sources, joint, free, drives[joint]) if sources[0].accelerated else {}
    if sources[0].tau is not None:
        found |= _of_motor(sources, joint, free, drives)
    return found


def _of_spring(sources: Sequence[_Source], joint: int, free: set[str], known: Drive) -> Drive:
    """Solve for the torsion: what noise there is in accelerations matters less to a torque than to a torsion."""
    wanted = {part for part, kind in PARTS.items() if kind in free}
    c = 1 / known["stiffness"]
    parts = {"compliance": c, "cubic": c**4 * known["cubic_stiffness"], "lag": c**2 * known["damping"]}
    parts |= _solve([source.spring(joint) for source in sources], wanted, parts)
    c = parts["compliance"]
    if c <= 0:
        return {}
    found = {"stiffness": 1 / c, "cubic_stiffness": parts["cubic"] / c**4, "damping": parts["lag"] / c**2}
    return {kind: value for kind, value in found.items() if kind in free}


def _of_motor(sources: Sequence[_Source], joint: int, free: set[str], drives: Sequence[Drive]) -> Drive:
    equations = [source.motor(joint) for source in sources]
    if sources[0].accelerated:
        return _solve(equations, free, drives[joint])
    springs = [source.compliance(joint, drives) for source in sources]
    together = [(a | c, b + d) for (a, b), (c, d) in zip(equations, springs, strict=True)]
    wanted = free | {"compliance"} if "stiffness" in free else free
    found = _solve(together, wanted, drives[joint] | {"compliance": 1 / drives[joint]["stiffness"]})
    compliance = found.pop("compliance", 0.0)
    return found | {"stiffness": 1 / compliance} if compliance > 0 else found


def _nominal(drive: JointConfig) -> Drive:
    return {
        "stiffness": drive.stiffness or 0.0,
        "cubic_stiffness": drive.cubic_stiffness,
        "damping": drive.damping or 0.0,
        "motor_inertia": drive.motor_inertia or 0.0,
        "viscous": drive.motor_friction.viscous,
        "coulomb": drive.motor_friction.coulomb,
    }


def _solve(equations: Sequence[Equation], free: set[str], known: Drive) -> Drive:
    """Least squares over all recordings; nothing that is sought is negative."""
    names = [name for name in equations[0][0] if name in free]
    if not names:
        return {}
    rest = [target - sum(known[n] * c for n, c in columns.items() if n not in names) for columns, target in equations]
    matrix = np.vstack([np.stack([columns[name] for name in names], axis=1) for columns, _ in equations])
    scale = np.maximum(np.linalg.norm(matrix, axis=0), np.finfo(float).tiny)
    outcome = scipy.optimize.lsq_linear(matrix / scale, np.concatenate(rest), bounds=(0, np.inf))
    return dict(zip(names, (outcome.x / scale).tolist(), strict=True))
