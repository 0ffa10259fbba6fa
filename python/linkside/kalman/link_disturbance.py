"""Disturbance torques of links: how they may wander, and where a filter with them starts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.errors import EstimatorError
from linkside.robot import Robot

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


def widened(
    start: tuple[FloatArray, FloatArray], at: int, law: LinkDisturbance, compliance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """A start's mean and covariance with the disturbances put in at state ``at``.

    Links that the motors' readings put where they are stand elsewhere by ``compliance`` (n,) [rad/(N m)] times the
    disturbance.
    """
    (mean, covariance), n = start, len(law.std)
    states = len(mean)
    order = np.r_[:at, states : states + n, at:states]
    links, torques = np.arange(n), states + np.arange(n)
    wide = np.zeros((states + n, states + n))
    wide[:states, :states] = covariance
    wide[torques, torques] = law.std**2
    shared = compliance * law.std**2
    wide[links, links] += compliance * shared
    wide[links, torques] = wide[torques, links] = shared
    return np.concatenate([mean, np.zeros(n)])[order], wide[np.ix_(order, order)]
