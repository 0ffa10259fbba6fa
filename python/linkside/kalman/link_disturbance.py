"""What acts on links from outside: how disturbance torques may wander, and where a filter with them starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot, wrenches

Wanted = bool | Literal["auto"]
"""Whether links have disturbance torques; ``"auto"``: where a recording shows them."""

PUSH = 10.0
"""Acceleration of a link by a disturbance torque that nothing is known of [rad/s²]."""


@dataclass(frozen=True)
class LinkDisturbance:
    """Processes of Gauss and Markov: standard deviation of each link's torque (n,) [N m], and time to forget [s]."""

    std: FloatArray
    time: float

    @property
    def walk(self) -> FloatArray:
        """By how much each wanders in a second (n,) [N m/√s]."""
        return np.asarray(self.std * np.sqrt(2 / self.time))

    @property
    def arrays(self) -> dict[str, Any]:
        """As the core takes it."""
        return {"initial": self.std.tolist(), "walk": self.walk.tolist(), "time": self.time}

    def jerk(self, robot: Robot, q: FloatArray) -> FloatArray:
        """Density of the jerk that they give links at ``q``, whose motors hold still (n,) [rad/s³/√Hz]."""
        return np.asarray(np.sqrt(np.linalg.inv(robot.mass_matrix(q)) ** 2 @ self.walk**2))


def check(wanted: Any) -> Wanted:
    """Check the setting of an estimator."""
    if isinstance(wanted, bool) or wanted == "auto":
        return wanted  # type: ignore[no-any-return]
    raise EstimatorError(f"link_disturbance is {wanted!r}, expected True, False or 'auto'")


def given_law(noise: Any, robot: Robot) -> LinkDisturbance:
    """By ``noise``, and where that does not say it by what moves a resting robot's links."""
    if noise.link_disturbance is not None:
        std = per_joint("link_disturbance", noise.link_disturbance, robot.n)
    else:
        rest = np.zeros(robot.n)
        std = np.abs(robot.gravity_torque(rest)) + PUSH * np.diag(robot.mass_matrix(rest))
    return LinkDisturbance(np.asarray(std, float), noise.link_disturbance_time)


def stiffness(robot: Robot) -> FloatArray:
    """Stiffness of each joint (n,), infinite where it is rigid [N m/rad]."""
    return np.array([d.stiffness if d.elastic else np.inf for d in robot.drives], np.float64)


class Outside:
    """What acts on links from outside, as states: a torque on each, if ``law`` says so, and the wrenches that vary."""

    def __init__(self, law: LinkDisturbance | None, robot: Robot) -> None:
        self._robot, self._torques = robot, np.zeros(0) if law is None else law.std
        self._initial = wrenches.law(robot.varying_wrenches)["initial"]
        self.states = len(self._torques) + len(self._initial)

    def widened(
        self,
        start: tuple[FloatArray, FloatArray],
        at: int,
        first: FloatArray | None = None,
        noise: Sequence[float] | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """A start's mean and covariance with these states put in at state ``at``.

        Links that motors' readings put where they are, where ``noise`` of all readings is given, stand elsewhere by
        what acts on them; ``first`` are the first readings of force sensors (k, channels), the last channels.
        """
        (mean, covariance), n = start, self._robot.n
        if not self.states:
            return start
        states, more = len(mean), self.states
        size, std = np.zeros(more), np.concatenate([self._torques, self._initial])
        read = np.concatenate([np.zeros(len(self._torques), bool), wrenches.is_measured(self._robot.varying_wrenches)])
        if first is not None and noise is not None and np.isfinite(first[0]).all():
            size[read], std[read] = first[0], noise[len(noise) - first.shape[1] :]
        by = np.zeros((n, more)) if noise is None else self._compliance(mean[:n])
        wide = np.zeros((states + more, states + more))
        wide[:states, :states] = covariance
        wide[states:, states:] = np.diag(std**2)
        wide[:n, :n] += (by * std**2) @ by.T
        wide[:n, states:] = by * std**2
        wide[states:, :n] = wide[:n, states:].T
        mean = np.concatenate([mean, size])
        mean[:n] += by @ size
        order = np.r_[:at, states : states + more, at:states]
        return mean[order], wide[np.ix_(order, order)]

    def _compliance(self, q: FloatArray) -> FloatArray:
        """How far each of these states moves each link at ``q`` against its motor (n, states)."""
        torque = np.eye(self._robot.n) if len(self._torques) else np.zeros((self._robot.n, 0))
        joint = np.hstack([torque, self._robot.wrench_map(q)])
        return np.asarray(joint / stiffness(self._robot)[:, None])
