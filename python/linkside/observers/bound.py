"""How far off an observer can get by what is bounded."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from linkside import _core
from linkside.arguments import per_joint
from linkside.arrays import FloatArray
from linkside.robot import Robot
from linkside.text import Titled


@dataclass(frozen=True, eq=False)
class ErrorBound:
    """What links can be off by at most, once the start has decayed.

    Attributes
    ----------
    names : tuple of str
        The n joints.
    torque, acceleration, theta : (n, 2)
        Link position and velocity by a unit of what disturbs them [rad/(N m), s², 1] and [rad/s/(N m), s, 1/s].
    q, dq : (n,)
        Link position and velocity by all that was asked for together [rad, rad/s].
    """

    names: tuple[str, ...]
    torque: FloatArray
    acceleration: FloatArray
    theta: FloatArray
    q: FloatArray
    dq: FloatArray

    def tables(self) -> Iterator[Titled]:
        """Say it joint by joint."""
        heads = ("by 1 N m of torque", "by 1 rad/s² of acceleration", "by 1 µrad of the encoder")
        table = Titled("the acceleration-driven observer: links are off by at most, in µrad", ("", *heads))
        for name, *sizes in zip(self.names, self.torque, self.acceleration, 1e-6 * self.theta, strict=True):
            table.add_row(name, *(f"{1e6 * position:.3g}" for position, _ in sizes))
        yield table


def error_bound(
    robot: Robot,
    poles: Mapping[str, list[complex]],
    period: float,
    disturbances: Mapping[str, npt.ArrayLike],
    *,
    predictor: bool,
) -> ErrorBound:
    """Give the bound of an observer; ``disturbances`` by the names of `ErrorBound`, each one number or (n,)."""
    each = [_core.observer_bound(robot.core, j, poles[name], period, predictor) for j, name in enumerate(robot.names)]
    torque, acceleration, theta = np.moveaxis(np.array(each), 1, 0)
    units = {"torque": torque, "acceleration": acceleration, "theta": theta}
    sizes = {name: np.abs(per_joint(name, size, robot.n)) for name, size in disturbances.items()}
    total = sum((units[name] * size[:, None] for name, size in sizes.items()), np.zeros((robot.n, 2)))
    return ErrorBound(robot.names, torque, acceleration, theta, q=total[:, 0], dq=total[:, 1])
